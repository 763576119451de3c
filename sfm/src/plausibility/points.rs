//! What the points of a model are worth: how many images see them, from how far apart, and whether
//! those of half their images are where the other half sees them.

use super::matches::limit_px;
use crate::incremental::state::{MapState, MappingInput};
use crate::limits::FEWEST_VIEWS;
use crate::statistics::median;
use crate::triangulation::{Gates, PointView, triangulate, widest_angle};
use rayon::prelude::*;

/// Tracks that are looked at.
/// Source: derived; a share of them is known to 2 %.
const TRACKS: usize = 1500;
/// Images of a track by which it can be split: two that triangulate, two that test.
/// Source: derived.
const SPLIT_VIEWS: usize = 4;

/// Median of the widest angles under which points are seen, degrees.
pub(super) fn median_angle_deg(state: &MapState) -> f64 {
    let angles = state.live().map(|(_, p)| {
        let centres = p.views.iter().filter_map(|v| Some(state.poses[v[0] as usize].as_ref()?.centre()));
        widest_angle(p.position, centres).to_degrees()
    });
    median(angles.collect())
}

/// For each image with a pose, how many points it sees that three and more images see.
pub(super) fn firm_points(state: &MapState) -> Vec<usize> {
    let mut seen = vec![0usize; state.poses.len()];
    for (_, p) in state.live().filter(|(_, p)| p.views.len() >= FEWEST_VIEWS) {
        p.views.iter().for_each(|v| seen[v[0] as usize] += 1);
    }
    let mut images = state.order.clone();
    images.sort_unstable();
    images.iter().map(|&i| seen[i]).collect()
}

/// Tracks of four and more images are triangulated from every other one of these; the share of the
/// remaining observations that agree with that within the limit. No number of no such track.
pub(super) fn held_out_share(state: &MapState, input: &MappingInput<'_>) -> f64 {
    let long: Vec<Vec<PointView<'_>>> = input
        .tracks
        .views
        .iter()
        .filter_map(|views| {
            let seen: Vec<PointView<'_>> = views.iter().filter_map(|v| state.view(input, *v)).collect();
            (seen.len() >= SPLIT_VIEWS).then_some(seen)
        })
        .collect();
    let step = long.len().div_ceil(TRACKS).max(1);
    let chosen: Vec<&Vec<PointView<'_>>> = long.iter().step_by(step).collect();
    let counts: Vec<(usize, usize)> = chosen.par_iter().map(|views| agreeing(views)).collect();
    let (agree, all) = counts.iter().fold((0, 0), |s, c| (s.0 + c.0, s.1 + c.1));
    agree as f64 / all as f64
}

/// Observations that took no part: (within the limit of the others' point, all).
fn agreeing(views: &[PointView<'_>]) -> (usize, usize) {
    let [used, held]: [Vec<PointView<'_>>; 2] =
        [0, 1].map(|k| views.iter().skip(k).step_by(2).copied().collect());
    let limit = limit_px(views[0].camera);
    let gates = Gates { max_error_px: limit, min_angle: 0.0 };
    let Some(found) = triangulate(&used, &gates) else { return (0, held.len()) };
    let agree = held.iter().filter(|v| v.error_sq(found.position) < limit * limit).count();
    (agree, held.len())
}
