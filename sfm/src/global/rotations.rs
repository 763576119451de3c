//! Rotation averaging: rotations of all images at once from those of their pairs.
//!
//! `ω_ij = log(R_jᵀ-frame residual)` of every pair is explained by small turns of its two images, a
//! sparse linear system solved again and again with weights that let wrong pairs go: first 1/|ω|
//! (least absolute deviations), then Geman and McClure's. Chatterjee & Govindu, "Efficient and
//! Robust Large-Scale Rotation Averaging", ICCV 2013.

use crate::disjoint_sets::DisjointSets;
use glam::{DQuat, DVec3};

/// A pair and the rotation between its images.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RotationEdge {
    pub a: usize,
    pub b: usize,
    pub b_from_a: DQuat,
    /// How much it is trusted, above 0.
    pub weight: f64,
}

/// Rounds with 1/|ω| and with Geman and McClure's weights, at most.
/// Source: judgement: reweighting settles in fewer.
const ROUNDS: usize = 30;
/// Width of Geman and McClure's loss, radians.
/// Source: Chatterjee & Govindu, ICCV 2013, who use 5°; here 3° by judgement.
const WIDTH: f64 = 0.05;

/// `image_from_world` of the images in the largest connected part of the graph (others: `None`);
/// its first image's is the identity. The same for the same edges in the same order.
pub(crate) fn average(images: usize, edges: &[RotationEdge]) -> Vec<Option<DQuat>> {
    let mut rotations = along_tree(images, edges);
    let known: Vec<&RotationEdge> = edges.iter().filter(|e| rotations[e.a].is_some()).collect();
    let Some(root) = rotations.iter().position(Option::is_some) else { return rotations };
    for loss in [least_absolute, geman_mcclure] {
        for _ in 0..ROUNDS {
            let system: Vec<(usize, usize, DVec3, f64)> = known
                .iter()
                .filter_map(|e| {
                    let omega = residual(&rotations, e)?;
                    Some((e.a, e.b, omega, e.weight * loss(omega.length())))
                })
                .collect();
            let turns = solve(images, root, &system);
            let largest = turns.iter().fold(0.0_f64, |m, t| m.max(t.length()));
            for (rotation, turn) in rotations.iter_mut().zip(&turns) {
                *rotation = rotation.map(|r| (r * DQuat::from_scaled_axis(*turn)).normalize());
            }
            // Far below what pairs are exact to.
            if largest < f64::EPSILON.sqrt() {
                break;
            }
        }
    }
    rotations
}

/// What an edge says beyond the present rotations, as a turn in the world frame: `R_bᵀ R_ba R_a =
/// exp(ω)`.
fn residual(rotations: &[Option<DQuat>], e: &RotationEdge) -> Option<DVec3> {
    let q = rotations[e.b]?.inverse() * e.b_from_a * rotations[e.a]?;
    Some(if q.w < 0.0 { (-q).to_scaled_axis() } else { q.to_scaled_axis() })
}

/// Weight of a residual for the least absolute deviation; all small ones weigh the same.
fn least_absolute(size: f64) -> f64 {
    1.0 / size.max(WIDTH / 10.0)
}

fn geman_mcclure(size: f64) -> f64 {
    (WIDTH * WIDTH / (WIDTH * WIDTH + size * size)).powi(2)
}

/// Whether an edge is within three widths of the rotations: farther off it weighs a hundredth.
pub(crate) fn agrees(rotations: &[Option<DQuat>], e: &RotationEdge) -> bool {
    residual(rotations, e).is_none_or(|r| r.length() < 3.0 * WIDTH)
}

/// Rotations along the tree of the heaviest edges, of the largest connected part alone.
fn along_tree(images: usize, edges: &[RotationEdge]) -> Vec<Option<DQuat>> {
    let mut order: Vec<usize> = (0..edges.len()).collect();
    order.sort_by(|&i, &k| edges[k].weight.total_cmp(&edges[i].weight).then(i.cmp(&k)));
    let mut parts = DisjointSets::new(images);
    let mut neighbours: Vec<Vec<(usize, DQuat)>> = vec![Vec::new(); images];
    for i in order {
        let e = &edges[i];
        if parts.join(e.a, e.b) {
            neighbours[e.a].push((e.b, e.b_from_a));
            neighbours[e.b].push((e.a, e.b_from_a.inverse()));
        }
    }
    let sizes = parts.sizes();
    let mut rotations = vec![None; images];
    let largest = (0..images).max_by_key(|&i| (sizes[i], std::cmp::Reverse(i)));
    let Some(root) = largest.filter(|&i| sizes[i] > 1) else { return rotations };
    rotations[root] = Some(DQuat::IDENTITY);
    let mut open = vec![(root, DQuat::IDENTITY)];
    while let Some((i, own)) = open.pop() {
        for &(k, k_from_i) in &neighbours[i] {
            if rotations[k].is_none() {
                let rotation = (k_from_i * own).normalize();
                rotations[k] = Some(rotation);
                open.push((k, rotation));
            }
        }
    }
    rotations
}

/// Turns with the least `Σ w |ω − (turn_b − turn_a)|²`, that of `root` being 0: conjugate gradients
/// on the graph's Laplacian, preconditioned by its diagonal.
fn solve(images: usize, root: usize, system: &[(usize, usize, DVec3, f64)]) -> Vec<DVec3> {
    let mut diagonal = vec![0.0; images];
    let mut r = vec![DVec3::ZERO; images];
    for &(a, b, omega, w) in system {
        diagonal[a] += w;
        diagonal[b] += w;
        r[a] -= omega * w;
        r[b] += omega * w;
    }
    r[root] = DVec3::ZERO;
    // What is not solved for stays where it is.
    diagonal[root] = 0.0;
    let mut x = vec![DVec3::ZERO; images];
    let mut z = precondition(&r, &diagonal);
    let mut p = z.clone();
    let mut rz = dot(&r, &z);
    let first = rz;
    // In exact arithmetic conjugate gradients end with as many steps as unknowns.
    for _ in 0..3 * images {
        // The residual is reduced by nine digits.
        if !(rz > 1e-18 * first) {
            break;
        }
        let mut q = vec![DVec3::ZERO; images];
        for &(a, b, _, w) in system {
            let difference = (p[b] - p[a]) * w;
            q[a] -= difference;
            q[b] += difference;
        }
        q[root] = DVec3::ZERO;
        let alpha = rz / dot(&p, &q);
        if !alpha.is_finite() {
            break;
        }
        x.iter_mut().zip(&p).for_each(|(x, p)| *x += *p * alpha);
        r.iter_mut().zip(&q).for_each(|(r, q)| *r -= *q * alpha);
        z = precondition(&r, &diagonal);
        let next = dot(&r, &z);
        let beta = next / rz;
        rz = next;
        p.iter_mut().zip(&z).for_each(|(p, z)| *p = *z + *p * beta);
    }
    x
}

/// Each entry over its diagonal one; zero where that is.
fn precondition(r: &[DVec3], diagonal: &[f64]) -> Vec<DVec3> {
    r.iter().zip(diagonal).map(|(v, d)| if *d > 0.0 { *v / *d } else { DVec3::ZERO }).collect()
}

fn dot(x: &[DVec3], y: &[DVec3]) -> f64 {
    x.iter().zip(y).map(|(x, y)| x.dot(*y)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;
    use scene::rng::rng;

    /// Rotations of `n` images and noisy edges between those up to `reach` apart on a ring; every
    /// `wrong`-th is wild.
    fn graph(n: usize, reach: usize, noise: f64, wrong: usize) -> (Vec<DQuat>, Vec<RotationEdge>) {
        let mut random = rng(3, "rotations", n as u64);
        let mut turn = |size: f64| {
            DQuat::from_scaled_axis(DVec3::from_array(std::array::from_fn(|_| {
                random.random_range(-size..size)
            })))
        };
        let truth: Vec<DQuat> = (0..n).map(|_| turn(3.0)).collect();
        let mut edges = Vec::new();
        for a in 0..n {
            for step in 1..=reach {
                let b = (a + step) % n;
                let exact = truth[b] * truth[a].inverse();
                let wild = wrong > 0 && edges.len() % wrong == 1;
                let b_from_a = (if wild { turn(3.0) } else { turn(noise) } * exact).normalize();
                edges.push(RotationEdge { a, b, b_from_a, weight: if wild { 0.5 } else { 1.0 } });
            }
        }
        (truth, edges)
    }

    fn worst(found: &[Option<DQuat>], truth: &[DQuat]) -> f64 {
        let gauge = found[0].unwrap().inverse() * truth[0];
        let error = |(f, t): (&Option<DQuat>, &DQuat)| (f.unwrap() * gauge).angle_between(*t);
        found.iter().zip(truth).map(error).fold(0.0, f64::max)
    }

    #[test]
    fn exact_pairs_give_exact_rotations_whatever_a_quarter_of_wild_pairs_says() {
        let (truth, edges) = graph(40, 4, 1e-9, 4);
        assert!(worst(&average(40, &edges), &truth) < 1e-5);
    }

    #[test]
    fn noise_is_averaged_round_the_ring_instead_of_adding_up() {
        let (truth, edges) = graph(200, 3, 0.01, 0);
        let error = worst(&average(200, &edges), &truth);
        assert!(error < 0.06, "{error}: a chain of 100 such steps would be off by about 0.1");
    }

    #[test]
    fn only_the_largest_part_has_rotations_and_nothing_gives_nothing() {
        let (_, mut edges) = graph(10, 2, 0.001, 0);
        edges.push(RotationEdge { a: 11, b: 12, b_from_a: DQuat::IDENTITY, weight: 9.0 });
        let found = average(14, &edges);
        assert!(found[..10].iter().all(Option::is_some) && found[10..].iter().all(Option::is_none));
        assert!(average(3, &[]).iter().all(Option::is_none));
        assert!(average(0, &[]).is_empty());
    }
}
