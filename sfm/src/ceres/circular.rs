//! The border to Ceres for motions about one axis.

use super::{BundleOutcome, BundleState, CircularInput, Monitor, all_finite, ffi, num_params};
use crate::error::SfmError;
use scene::Progress;

/// The numbers that change: see [`CircularInput`] for P and the cameras.
#[derive(Clone, Debug, Default)]
pub(crate) struct CircularState {
    /// The cameras' parameters, one camera after the other.
    pub intrinsics: Vec<f64>,
    /// [7] camera from turntable: quaternion x y z w, translation.
    pub axis: Vec<f64>,
    /// [P] radians.
    pub angles: Vec<f64>,
    /// [P × 7] quaternion x y z w, translation.
    pub offsets: Vec<f64>,
    /// [N × 3].
    pub points: Vec<f64>,
}

/// Minimises; `state` holds the result. Not finite or inconsistent input is an error, not a crash.
pub(crate) fn solve(
    input: &CircularInput,
    state: &mut CircularState,
    progress: &Progress,
) -> Result<BundleOutcome, SfmError> {
    check(input, state)?;
    let CircularState { intrinsics, axis, angles, offsets, points } = state;
    let outcome = ffi::solve_circular(input, intrinsics, axis, angles, offsets, points, &Monitor(progress))
        .map_err(|e| SfmError::Solver(e.to_string()))?;
    if outcome.cancelled {
        progress.check()?;
    }
    Ok(outcome)
}

/// Covariances of the axis' freedoms and the angles [(3 + P)²] and of each camera's parameters, for
/// observations of unit noise; `None` where the problem does not determine them.
pub(crate) fn covariance(
    input: &CircularInput,
    state: &CircularState,
) -> Result<Option<(Vec<f64>, Vec<f64>)>, SfmError> {
    check(input, state)?;
    let size = 3 + state.angles.len();
    let mut of_turn = vec![0.0; size * size];
    let mut of_cameras = vec![0.0; input.bundle.camera_models.iter().map(|&m| num_params(m).pow(2)).sum()];
    let CircularState { intrinsics, axis, angles, offsets, points } = state;
    let done = ffi::circular_covariance(
        input,
        intrinsics,
        axis,
        angles,
        offsets,
        points,
        &mut of_turn,
        &mut of_cameras,
    )
    .map_err(|e| SfmError::Solver(e.to_string()))?;
    Ok(done.then_some((of_turn, of_cameras)))
}

fn check(input: &CircularInput, state: &CircularState) -> Result<(), SfmError> {
    let frames = state.angles.len();
    // The same checks as for free poses, with poses of the right number that nothing reads.
    let bundle = BundleState {
        intrinsics: state.intrinsics.clone(),
        poses: state.offsets.clone(),
        points: state.points.clone(),
    };
    super::check(&input.bundle, &bundle)?;
    let relations = input.relation_weights.len();
    let shapes = state.axis.len() == 7
        && input.axis_basis.len() == 9
        && input.angle_held.len() == frames
        && input.bundle.pose_held.len() == frames
        && input.offset_sigma.len() == 2
        && input.relation_angles.len() == 3 * relations
        && input.relation_coefficients.len() == 3 * relations
        && input.relation_targets.len() == relations
        && input.level_normals.len() == 3 * input.level_weights.len()
        && input.level_targets.len() == input.level_weights.len();
    let mut numbers = input.relation_angles.iter().enumerate();
    let indices = numbers.all(|(k, &i)| (i as usize) < frames || (k % 3 == 2 && i == u32::MAX));
    let all = [
        &state.axis,
        &state.angles,
        &input.axis_basis,
        &input.offset_sigma,
        &input.relation_coefficients,
        &input.relation_targets,
        &input.relation_weights,
        &input.level_normals,
        &input.level_targets,
        &input.level_weights,
    ];
    let finite = all.iter().all(|values| all_finite(values));
    match (shapes && indices, finite) {
        (false, _) => Err(SfmError::Solver("the circular motion is inconsistent".to_owned())),
        (_, false) => Err(SfmError::Solver("a number of the circular motion is not finite".to_owned())),
        _ => Ok(()),
    }
}
