//! A second solution from other evidence by another way: all rotations at once from those of the
//! pairs, and all of the model from half of the tracks by the global mapper.

use crate::error::SfmError;
use crate::global;
use crate::incremental::state::{MapState, MappingInput};
use crate::knowledge::Knowledge;
use crate::statistics::median;
use crate::tracks::{NONE, Tracks};
use glam::DQuat;
use rand::Rng as _;
use scene::{Pose, Progress, rng};

/// How far the rotations of another solution are from a model's, degrees: (median over the pairs of
/// images that both have, share of the model's images that it has).
pub(super) fn disagreement(state: &MapState, other: &[Option<DQuat>]) -> (f64, f64) {
    let mut turns: Vec<DQuat> = Vec::new();
    for (pose, other) in state.poses.iter().zip(other) {
        if let (Some(pose), Some(other)) = (pose, other) {
            turns.push(other.conjugate() * pose.rotation);
        }
    }
    let mut angles = Vec::new();
    for (i, a) in turns.iter().enumerate() {
        angles.extend(turns[i + 1..].iter().map(|b| a.angle_between(*b).to_degrees()));
    }
    (median(angles), turns.len() as f64 / state.registered_count().max(1) as f64)
}

/// A random half of the tracks.
fn half_of(tracks: &Tracks, seed: u64) -> Tracks {
    let mut half = Tracks { of: tracks.of.iter().map(|of| vec![NONE; of.len()]).collect(), views: Vec::new() };
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

/// Rotations of the global mapper's model of half of the tracks.
pub(super) fn global_rotations(
    state: &MapState,
    input: &MappingInput<'_>,
    tracks: &Tracks,
    known: &[Knowledge],
    progress: &Progress,
) -> Result<Vec<Option<DQuat>>, SfmError> {
    let half = half_of(tracks, input.seed);
    let input = MappingInput { tracks: &half, ..*input };
    let model = global::map(&input, &state.cameras, known, progress)?;
    Ok(model.map_or_else(|| vec![None; state.poses.len()], |m| {
        m.poses.iter().map(|p| p.as_ref().map(|p: &Pose| p.rotation)).collect()
    }))
}
