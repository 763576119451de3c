//! Points that only two images see and that stand alone in depth: where texture repeats, false
//! matches that happen to lie on the epipolar line become points in the air, often near the
//! cameras.

use super::state::{MapState, MappingInput};
use crate::tracks::NONE;
use glam::DVec2;

/// Well-seen neighbours in the image that a point's depth is compared with.
/// Source: chosen by hand, never measured.
const NEIGHBOURS: usize = 8;
/// How far outside its neighbours' depths a point may lie, as a factor.
/// Source: chosen by hand, never measured.
const FACTOR: f64 = 1.5;

/// Drops points seen by two images whose depth in either of them lies outside the range of the
/// depths of the nearest points there that three images or more see. Returns how many went.
pub(crate) fn drop_lonely(state: &mut MapState, input: &MappingInput<'_>) -> usize {
    let mut doubtful = vec![false; state.points.len()];
    for &image in &state.order {
        let Some(pose) = state.poses[image] else { continue };
        let (mut seen_well, mut seen_twice): (Vec<(DVec2, f64)>, Vec<(u32, DVec2, f64)>) = Default::default();
        for (feature, &id) in state.point_of[image].iter().enumerate().filter(|(_, id)| **id != NONE) {
            let Some(point) = &state.points[id as usize] else { continue };
            let (pixel, depth) = (input.keypoints[image][feature], pose.transform(point.position).z);
            if point.views.len() > 2 {
                seen_well.push((pixel, depth));
            } else {
                seen_twice.push((id, pixel, depth));
            }
        }
        // Fewer cannot judge.
        if seen_well.len() < 3 * NEIGHBOURS {
            continue;
        }
        for (id, pixel, depth) in seen_twice {
            let (low, high) = range_near(&seen_well, pixel);
            doubtful[id as usize] |= !(depth * FACTOR >= low && depth <= high * FACTOR);
        }
    }
    let gone: Vec<u32> = (0..).zip(&doubtful).filter(|(_, d)| **d).map(|(id, _)| id).collect();
    gone.iter().for_each(|&id| state.drop_point(id));
    gone.len()
}

/// Least and largest depth of the nearest points.
fn range_near(points: &[(DVec2, f64)], pixel: DVec2) -> (f64, f64) {
    let mut near: Vec<(f64, f64)> = points.iter().map(|(p, z)| (p.distance_squared(pixel), *z)).collect();
    let count = NEIGHBOURS.min(near.len());
    near.select_nth_unstable_by(count - 1, |a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let depths = near[..count].iter().map(|n| n.1);
    (depths.clone().fold(f64::INFINITY, f64::min), depths.fold(f64::NEG_INFINITY, f64::max))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_range_is_that_of_the_nearest_points_alone() {
        let mut points: Vec<(DVec2, f64)> =
            (0..8).map(|i| (DVec2::new(f64::from(i), 0.0), 4.0 + f64::from(i))).collect();
        points.extend((0..30).map(|i| (DVec2::new(500.0 + f64::from(i), 0.0), 100.0)));
        assert_eq!(range_near(&points, DVec2::ZERO), (4.0, 11.0));
        assert_eq!(range_near(&points, DVec2::new(520.0, 0.0)), (100.0, 100.0));
    }
}
