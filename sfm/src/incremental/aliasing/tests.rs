use super::*;
use rand::Rng;
use scene::rng::rng;

/// `image_from_world` of a camera that has gone `degrees` round an object.
fn on_ring(degrees: f64) -> DQuat {
    DQuat::from_rotation_x(0.3) * DQuat::from_rotation_y(degrees.to_radians())
}

fn edge(geometry: usize, a: usize, b: usize, turned_deg: f64) -> PairRotation {
    let mut random = rng(7, "folds", geometry as u64);
    let noise =
        DQuat::from_scaled_axis(DVec3::from_array(std::array::from_fn(|_| random.random_range(-0.01..0.01))));
    let step = 10.0 * (b as f64 - a as f64) + turned_deg;
    let b_from_a = noise * on_ring(step) * on_ring(0.0).inverse();
    PairRotation { geometry, a, b, b_from_a, weight: 10.0 }
}

/// 36 images 10° apart: true edges between neighbours up to three steps, round the ring, and
/// `false_` ones that take one side for the other.
fn ring(false_edges: bool) -> (Vec<PairRotation>, Vec<PairRotation>) {
    let mut edges = Vec::new();
    for a in 0..36 {
        for step in 1..4 {
            if a + step < 36 {
                edges.push(edge(edges.len(), a, a + step, 0.0));
            } else {
                edges.push(edge(edges.len(), a + step - 36, a, 0.0));
            }
        }
    }
    let tree = edges.iter().filter(|e| e.b == e.a + 1).cloned().collect();
    if false_edges {
        for a in 0..18 {
            for b in [a + 17, a + 18, (a + 19).min(35)] {
                edges.push(edge(edges.len(), a, b, 180.0));
            }
        }
    }
    (tree, edges)
}

#[test]
fn all_edges_of_a_true_ring_are_kept_across_the_loop_too() {
    let (tree, edges) = ring(false);
    assert_eq!(keep_consistent(&tree, &edges, 36).len(), edges.len());
}

#[test]
fn edges_that_take_the_front_for_the_back_are_found_and_no_others() {
    let (tree, edges) = ring(true);
    let kept = keep_consistent(&tree, &edges, 36);
    assert_eq!(kept, (0..108).collect::<Vec<_>>());
}

#[test]
fn the_drift_of_a_chain_is_taken_up_by_the_edges_that_close_it() {
    // A focal length that is 5 % off makes every step 5 % too long: 18° over the ring.
    let (mut tree, mut edges) = ring(true);
    for e in tree.iter_mut().chain(&mut edges) {
        if e.b - e.a <= 3 {
            e.b_from_a = on_ring(10.5 * (e.b - e.a) as f64) * on_ring(0.0).inverse();
        }
    }
    let kept = keep_consistent(&tree, &edges, 36);
    assert!(kept.len() >= 100 && kept.iter().all(|&i| i < 108), "{} kept", kept.len());
}

#[test]
fn an_image_without_pairs_and_no_edges_at_all_do_no_harm() {
    let (tree, edges) = ring(false);
    assert_eq!(keep_consistent(&tree, &edges, 40).len(), edges.len());
    assert!(keep_consistent(&[], &edges, 36).is_empty());
    assert!(keep_consistent(&[], &[], 0).is_empty());
}
