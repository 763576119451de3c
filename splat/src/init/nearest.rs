//! Three nearest neighbours by a k-d tree.

use glam::Vec3;
use rayon::prelude::*;

/// Points that a leaf is searched through, a count. Source: chosen by hand, never measured.
const LEAF: usize = 8;
/// Mean square distance of a point that is alone. Source: chosen by hand: a hundredth of a
/// normalised unit.
const ALONE: f32 = 1e-4;

/// Mean square distance of every point to its three nearest neighbours (fewer if there are fewer
/// points; 1e-4 for a single point).
pub(super) fn mean_square_distance(points: &[Vec3]) -> Vec<f32> {
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    arrange(points, &mut order, 0);
    let mean = |&p: &Vec3| {
        let mut best = [f32::INFINITY; 4]; // the point itself is among them
        search(points, &order, 0, p, &mut best);
        let near: Vec<f32> = best[1..].iter().copied().filter(|d| d.is_finite()).collect();
        if near.is_empty() { ALONE } else { near.iter().sum::<f32>() / near.len() as f32 }
    };
    points.par_iter().map(mean).collect()
}

/// Puts the median along the level's axis into the middle, recursively.
fn arrange(points: &[Vec3], order: &mut [u32], level: usize) {
    if order.len() <= LEAF {
        return;
    }
    let (middle, axis) = (order.len() / 2, level % 3);
    order.select_nth_unstable_by(middle, |&a, &b| {
        points[a as usize][axis].total_cmp(&points[b as usize][axis])
    });
    let (low, high) = order.split_at_mut(middle);
    arrange(points, low, level + 1);
    arrange(points, &mut high[1..], level + 1);
}

/// Puts a value among the least, in order.
fn insert(best: &mut [f32; 4], mut value: f32) {
    for b in best.iter_mut() {
        if value < *b {
            std::mem::swap(b, &mut value);
        }
    }
}

fn search(points: &[Vec3], order: &[u32], level: usize, p: Vec3, best: &mut [f32; 4]) {
    if order.len() <= LEAF {
        order.iter().for_each(|&i| insert(best, points[i as usize].distance_squared(p)));
        return;
    }
    let (middle, axis) = (order.len() / 2, level % 3);
    insert(best, points[order[middle] as usize].distance_squared(p));
    let gap = p[axis] - points[order[middle] as usize][axis];
    let (low, high) = (&order[..middle], &order[middle + 1..]);
    let (near, far) = if gap < 0.0 { (low, high) } else { (high, low) };
    search(points, near, level + 1, p, best);
    if gap * gap < best[3] {
        search(points, far, level + 1, p, best);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_brute_force() {
        let points: Vec<Vec3> = (0..500)
            .map(|i| Vec3::new((i as f32 * 1.3).sin(), (i as f32 * 0.7).cos(), (i as f32 * 2.9).sin()))
            .collect();
        for (p, &found) in points.iter().zip(&mean_square_distance(&points)) {
            let mut all: Vec<f32> = points.iter().map(|q| q.distance_squared(*p)).collect();
            all.sort_by(f32::total_cmp);
            let expected = all[1..4].iter().sum::<f32>() / 3.0;
            assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        }
    }

    #[test]
    fn one_point_or_many_at_one_place_have_a_finite_scale() {
        assert_eq!(mean_square_distance(&[Vec3::ONE]), [1e-4]);
        assert!(mean_square_distance(&[Vec3::ONE; 1000]).iter().all(|d| *d == 0.0));
    }
}
