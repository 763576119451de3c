//! A second solution from other evidence by another way: of a video from pairs of frames near in
//! time alone, of photos the global mapper's, from half of the tracks.

use crate::error::SfmError;
use crate::global;
use crate::incremental::state::{MapState, MappingInput};
use crate::incremental::structureless_resection::NEAR_IN_TIME;
use crate::knowledge::Knowledge;
use crate::statistics::median;
use crate::tracks::{NONE, Tracks};
use glam::DQuat;
use rand::Rng as _;
use scene::{Progress, TwoViewGeometry, rng};

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
    angles.resize(pairs, OPPOSITE_DEG);
    median(angles)
}

/// Rotations that differ by the most that rotations can, degrees.
/// Source: derived.
const OPPOSITE_DEG: f64 = 180.0;

/// A random half of the tracks.
fn half_of(tracks: &Tracks, seed: u64) -> Tracks {
    let mut half =
        Tracks { of: tracks.of.iter().map(|of| vec![NONE; of.len()]).collect(), views: Vec::new() };
    let mut random = rng::rng(seed, "second solution", 0);
    for views in &tracks.views {
        if random.random::<bool>() {
            for v in views {
                half.of[v[0] as usize][v[1] as usize] = half.views.len() as u32;
            }
            half.views.push(views.clone());
        }
    }
    half
}

/// Rotations of the second solution. Frames that follow each other show the same side: no likeness
/// of two sides folds what their pairs say.
pub(super) fn rotations(
    state: &MapState,
    input: &MappingInput<'_>,
    known: &[Knowledge],
    progress: &Progress,
) -> Result<Vec<Option<DQuat>>, SfmError> {
    if !input.is_video {
        return global_rotations(state, input, known, progress);
    }
    let near = input.geometries.iter().filter(|g| g.a.abs_diff(g.b) <= NEAR_IN_TIME);
    let near: Vec<TwoViewGeometry> = near.cloned().collect();
    global::rotations_of_pairs(&MappingInput { geometries: &near, ..*input }, &state.cameras, progress)
}

/// Rotations of the global mapper's model of half of the tracks.
fn global_rotations(
    state: &MapState,
    input: &MappingInput<'_>,
    known: &[Knowledge],
    progress: &Progress,
) -> Result<Vec<Option<DQuat>>, SfmError> {
    let half = half_of(input.tracks, input.seed);
    let input = MappingInput { tracks: &half, ..*input };
    let model = match global::map(&input, &state.cameras, known, progress) {
        Err(SfmError::Solver(_)) => None, // no solution is an answer, too
        other => other?,
    };
    let poses = model.map_or_else(|| vec![None; state.poses.len()], |model| model.poses);
    Ok(poses.into_iter().map(|pose| pose.map(|p| p.rotation)).collect())
}
