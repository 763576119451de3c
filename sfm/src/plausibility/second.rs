//! A second solution from other evidence by another way: rotations of all images at once, from the
//! pairs of images that have most in common.

use crate::error::SfmError;
use crate::global;
use crate::incremental::state::{MapState, MappingInput};
use crate::statistics::median;
use glam::DQuat;
use scene::{Progress, TwoViewGeometry};
use std::cmp::Reverse;

/// Pairs of an image that the second solution rests on, those with the most matches: neighbours,
/// which show the same side. Likenesses of two sides fold what all pairs say.
/// Source: docs/decisions/20; with 2 it falls apart, with 10 it follows false pairs.
const STRONGEST: usize = 4;

/// How far the relative rotations of another solution are from a model's, median over all pairs of
/// the model's images, degrees. A pair that the other solution has no poses for counts as opposite.
pub(super) fn difference_deg(state: &MapState, other: &[Option<DQuat>]) -> f64 {
    let images = state.registered_count();
    let pairs = images * images.saturating_sub(1) / 2;
    let posed = state.poses.iter().zip(other);
    let turns: Vec<DQuat> = posed
        .filter_map(|(pose, other)| Some(other.as_ref()?.conjugate() * pose.as_ref()?.rotation))
        .collect();
    let mut angles = Vec::with_capacity(pairs);
    for (i, a) in turns.iter().enumerate() {
        angles.extend(turns[i + 1..].iter().map(|b| a.angle_between(*b).to_degrees()));
    }
    angles.resize(pairs, 180.0);
    median(angles)
}

/// Rotations of the second solution.
pub(super) fn rotations(
    state: &MapState,
    input: &MappingInput<'_>,
    progress: &Progress,
) -> Result<Vec<Option<DQuat>>, SfmError> {
    let strong = strongest(input.geometries, input.keypoints.len());
    global::rotations_of_pairs(&MappingInput { geometries: &strong, ..*input }, &state.cameras, progress)
}

/// The pairs that are among the strongest of one of their images.
fn strongest(pairs: &[TwoViewGeometry], images: usize) -> Vec<TwoViewGeometry> {
    let mut order: Vec<&TwoViewGeometry> = pairs.iter().collect();
    order.sort_by_key(|g| (Reverse(g.inliers.len()), g.a, g.b));
    let mut taken = vec![0; images];
    order.retain(|g| {
        let is_among = taken[g.a] < STRONGEST || taken[g.b] < STRONGEST;
        taken[g.a] += 1;
        taken[g.b] += 1;
        is_among
    });
    order.into_iter().cloned().collect()
}
