//! The one border to Ceres. Plain numbers cross it; everything is checked here first, because a
//! failed check inside Ceres would end the process.

use crate::error::SfmError;
use scene::Progress;

/// What Ceres asks between iterations.
pub(crate) struct Monitor<'a>(&'a Progress);

fn is_cancelled(monitor: &Monitor<'_>) -> bool {
    monitor.0.check().is_err()
}

#[cxx::bridge(namespace = "sat_recon")]
#[allow(unreachable_pub)] // the code that cxx makes of shared types
mod ffi {
    /// A bundle adjustment problem apart from the values that change. P poses, N points, M
    /// observations.
    #[derive(Clone, Debug, Default)]
    pub(crate) struct BundleInput {
        /// COLMAP model number of each camera.
        pub camera_models: Vec<i32>,
        /// Index of each camera's first parameter in the arrays over intrinsics.
        pub camera_offsets: Vec<usize>,
        /// 1 where an intrinsic parameter is solved for.
        pub intrinsics_free: Vec<u8>,
        /// Mean of the prior of each intrinsic parameter.
        pub prior_mean: Vec<f64>,
        /// Its standard deviation; 0: no prior.
        pub prior_sigma: Vec<f64>,
        /// [P] camera of each pose.
        pub pose_camera: Vec<u32>,
        /// [P] 0: free, 1 to 3: that coordinate of the translation is held, 7: constant.
        pub pose_held: Vec<u8>,
        /// How many poses are not constant.
        pub free_poses: usize,
        /// [P × 4] expected rotation of each pose, quaternion x y z w; empty: nothing is expected.
        pub expected_rotation: Vec<f64>,
        /// [P × 3] where the point `expected_centre` is expected in the camera frame.
        pub expected_place: Vec<f64>,
        /// [3] a point of the world whose places are expected.
        pub expected_centre: Vec<f64>,
        /// [2] standard deviations of a coordinate of the two: radians, scene units.
        pub expected_sigma: Vec<f64>,
        /// [N] 1: constant.
        pub point_held: Vec<u8>,
        /// [M] pose of each observation.
        pub observation_pose: Vec<u32>,
        /// [M] point of each observation.
        pub observation_point: Vec<u32>,
        /// [M × 2] measured pixels.
        pub pixels: Vec<f64>,
        /// [M] 1 / standard deviation of each observation, px⁻¹.
        pub weights: Vec<f64>,
        /// 0: squared, 1: soft L1, 2: Cauchy.
        pub loss: i32,
        /// Where the robust loss bends, in standard deviations.
        pub loss_scale: f64,
        /// Most iterations.
        pub max_iterations: i32,
        /// Relative decrease of the cost at which to stop.
        pub function_tolerance: f64,
        /// Relative change of the parameters at which to stop.
        pub parameter_tolerance: f64,
    }

    /// What became of it.
    #[derive(Clone, Debug, Default)]
    pub(crate) struct BundleOutcome {
        /// ½ Σ ρ before.
        pub initial_cost: f64,
        /// ½ Σ ρ after.
        pub final_cost: f64,
        /// Iterations taken.
        pub iterations: u32,
        /// Whether the result is better than nothing.
        pub usable: bool,
        /// Whether a tolerance was met.
        pub converged: bool,
        /// Whether the user asked to stop.
        pub cancelled: bool,
        /// Ceres' own words.
        pub message: String,
    }

    /// A motion about one axis: a bundle adjustment whose poses are `D_i (R Z(θ_i) X + t)`. P
    /// frames.
    #[derive(Clone, Debug, Default)]
    pub(crate) struct CircularInput {
        /// Cameras, points, observations and options; its `pose_held` is not used.
        pub bundle: BundleInput,
        /// Whether R and t are held.
        pub axis_held: bool,
        /// [3 × 3] column-major: R turns about the first two (unit, across the axis), t moves along
        /// the third.
        pub axis_basis: Vec<f64>,
        /// [P] 1: the angle is held.
        pub angle_held: Vec<u8>,
        /// [K × 3] frames of each relation `Σ c θ = target`; u32::MAX: only two.
        pub relation_angles: Vec<u32>,
        /// [K × 3] its coefficients.
        pub relation_coefficients: Vec<f64>,
        /// [K] what the sum should be.
        pub relation_targets: Vec<f64>,
        /// [K] 1 / standard deviation.
        pub relation_weights: Vec<f64>,
        /// [2] standard deviations of the offsets D: radians and scene units; 0: they are held.
        pub offset_sigma: Vec<f64>,
        /// [L × 3] unit vectors of the camera's frame: what is known of the axis along them.
        pub level_normals: Vec<f64>,
        /// [L] the scalar product of each with the axis.
        pub level_targets: Vec<f64>,
        /// [L] 1 / standard deviation.
        pub level_weights: Vec<f64>,
    }

    /// Bearings from P cameras to N points, M of them; rotations are known.
    #[derive(Clone, Debug, Default)]
    pub(crate) struct PositionInput {
        /// [M] camera of each bearing.
        pub observation_camera: Vec<u32>,
        /// [M] point of each bearing.
        pub observation_point: Vec<u32>,
        /// [M × 3] unit bearings, world frame.
        pub directions: Vec<f64>,
        /// Where Huber's loss bends (1: a bearing of unit length).
        pub loss_scale: f64,
        /// Most iterations.
        pub max_iterations: i32,
        /// Relative decrease of the cost at which to stop.
        pub function_tolerance: f64,
    }

    extern "Rust" {
        type Monitor<'a>;
        fn is_cancelled(monitor: &Monitor<'_>) -> bool;
    }

    unsafe extern "C++" {
        include!("bundle.h");
        include!("circular.h");
        include!("position.h");
        fn solve_positions(
            input: &PositionInput,
            centres: &mut [f64],
            points: &mut [f64],
            scales: &mut [f64],
            monitor: &Monitor<'_>,
        ) -> Result<BundleOutcome>;
        fn solve_bundle(
            input: &BundleInput,
            intrinsics: &mut [f64],
            poses: &mut [f64],
            points: &mut [f64],
            monitor: &Monitor<'_>,
        ) -> Result<BundleOutcome>;
        fn bundle_covariance(
            input: &BundleInput,
            intrinsics: &[f64],
            poses: &[f64],
            points: &[f64],
            pose_covariance: &mut [f64],
            camera_covariance: &mut [f64],
        ) -> Result<bool>;
        fn solve_circular(
            input: &CircularInput,
            intrinsics: &mut [f64],
            axis: &mut [f64],
            angles: &mut [f64],
            offsets: &mut [f64],
            points: &mut [f64],
            monitor: &Monitor<'_>,
        ) -> Result<BundleOutcome>;
        #[allow(clippy::too_many_arguments)]
        fn circular_covariance(
            input: &CircularInput,
            intrinsics: &[f64],
            axis: &[f64],
            angles: &[f64],
            offsets: &[f64],
            points: &[f64],
            circular_covariance: &mut [f64],
            camera_covariance: &mut [f64],
        ) -> Result<bool>;
        fn camera_information(
            input: &BundleInput,
            intrinsics: &[f64],
            poses: &[f64],
            points: &[f64],
            information: &mut [f64],
        ) -> Result<bool>;
        fn pose_information(
            input: &BundleInput,
            intrinsics: &[f64],
            poses: &[f64],
            points: &[f64],
            information: &mut [f64],
            slope: &mut [f64],
        ) -> Result<bool>;
    }
}

pub(crate) mod circular;

pub(crate) use ffi::{BundleInput, BundleOutcome, CircularInput, PositionInput};

/// Camera centres [P × 3] and points [N × 3] that agree with the bearings, from any start; both
/// hold the result. `false` where it is of no use.
pub(crate) fn positions(
    input: &PositionInput,
    centres: &mut [f64],
    points: &mut [f64],
    progress: &Progress,
) -> Result<bool, SfmError> {
    let count = input.observation_camera.len();
    let shapes = all_below(&input.observation_camera, centres.len() / 3)
        && all_below(&input.observation_point, points.len() / 3)
        && input.observation_point.len() == count
        && input.directions.len() == 3 * count;
    if count == 0 || !shapes || !all_finite(centres) || !all_finite(points) || !all_finite(&input.directions)
    {
        return Err(SfmError::Solver("the bearings are inconsistent".to_owned()));
    }
    let mut scales = vec![1.0; count];
    let outcome = ffi::solve_positions(input, centres, points, &mut scales, &Monitor(progress))
        .map_err(|e| SfmError::Solver(e.to_string()))?;
    if outcome.cancelled {
        progress.check()?;
    }
    Ok(outcome.usable && all_finite(centres) && all_finite(points))
}

/// The numbers that change: see [`BundleInput`] for P and N.
#[derive(Clone, Debug, Default)]
pub(crate) struct BundleState {
    /// The cameras' parameters, one camera after the other.
    pub intrinsics: Vec<f64>,
    /// [P × 7] quaternion x y z w, translation.
    pub poses: Vec<f64>,
    /// [N × 3].
    pub points: Vec<f64>,
}

/// Minimises; `state` holds the result. Not finite or inconsistent input is an error, not a crash.
pub(crate) fn solve(
    input: &BundleInput,
    state: &mut BundleState,
    progress: &Progress,
) -> Result<BundleOutcome, SfmError> {
    check(input, state)?;
    let BundleState { intrinsics, poses, points } = state;
    let outcome = ffi::solve_bundle(input, intrinsics, poses, points, &Monitor(progress))
        .map_err(|e| SfmError::Solver(e.to_string()))?;
    if outcome.cancelled {
        progress.check()?;
    }
    Ok(outcome)
}

/// Covariances of poses [P × 36] and of each camera's parameters, for observations of unit noise;
/// `None` where the problem does not determine them.
pub(crate) fn covariance(
    input: &BundleInput,
    state: &BundleState,
) -> Result<Option<(Vec<f64>, Vec<f64>)>, SfmError> {
    check(input, state)?;
    let mut of_poses = vec![0.0; input.pose_held.len() * 36];
    let sizes = input.camera_models.iter().map(|&m| num_params(m));
    let mut of_cameras = vec![0.0; sizes.map(|n| n * n).sum()];
    let BundleState { intrinsics, poses, points } = state;
    let done = ffi::bundle_covariance(input, intrinsics, poses, points, &mut of_poses, &mut of_cameras)
        .map_err(|e| SfmError::Solver(e.to_string()))?;
    Ok(done.then_some((of_poses, of_cameras)))
}

/// Joint information of all free intrinsics, [F × F] (without their priors); `None` where poses and
/// points cannot be eliminated.
pub(crate) fn camera_information(
    input: &BundleInput,
    state: &BundleState,
) -> Result<Option<Vec<f64>>, SfmError> {
    check(input, state)?;
    let free = input.intrinsics_free.iter().filter(|&&f| f != 0).count();
    let mut information = vec![0.0; free * free];
    let BundleState { intrinsics, poses, points } = state;
    let done = ffi::camera_information(input, intrinsics, poses, points, &mut information)
        .map_err(|e| SfmError::Solver(e.to_string()))?;
    Ok(done.then_some(information))
}

/// The quadratic that the cost is in all poses, [6P × 6P] and [6P], points and intrinsics
/// eliminated; `None` where they cannot be.
pub(crate) fn pose_information(
    input: &BundleInput,
    state: &BundleState,
) -> Result<Option<(Vec<f64>, Vec<f64>)>, SfmError> {
    check(input, state)?;
    let size = 6 * input.pose_held.len();
    let (mut information, mut slope) = (vec![0.0; size * size], vec![0.0; size]);
    let BundleState { intrinsics, poses, points } = state;
    let done = input.pose_held.iter().all(|h| *h == 0)
        && ffi::pose_information(input, intrinsics, poses, points, &mut information, &mut slope)
            .map_err(|e| SfmError::Solver(e.to_string()))?;
    Ok(done.then_some((information, slope)))
}

fn num_params(model: i32) -> usize {
    scene::CameraModel::from_colmap_id(model).map_or(0, scene::CameraModel::num_params)
}

fn all_below(indices: &[u32], n: usize) -> bool {
    indices.iter().all(|&i| (i as usize) < n)
}

fn all_finite(values: &[f64]) -> bool {
    values.iter().all(|v| v.is_finite())
}

fn check(input: &BundleInput, state: &BundleState) -> Result<(), SfmError> {
    let (poses, points, observations) = (input.pose_held.len(), input.point_held.len(), input.weights.len());
    let end = input.camera_offsets.iter().zip(&input.camera_models).map(|(o, &m)| o + num_params(m)).max();
    let intrinsics = end.unwrap_or(0);
    let shapes = state.poses.len() == poses * 7
        && state.points.len() == points * 3
        && state.intrinsics.len() == intrinsics
        && input.intrinsics_free.len() == intrinsics
        && input.prior_mean.len() == intrinsics
        && input.prior_sigma.len() == intrinsics
        && input.pose_camera.len() == poses
        && input.observation_pose.len() == observations
        && input.observation_point.len() == observations
        && input.pixels.len() == observations * 2
        && input.camera_models.iter().all(|&m| num_params(m) > 0);
    let expected = input.expected_rotation.len() / 4;
    let shapes = shapes
        && (expected == 0 || expected == poses && input.expected_sigma.iter().all(|s| *s > 0.0))
        && input.expected_rotation.len() == expected * 4
        && input.expected_place.len() == expected * 3
        && (expected == 0 || input.expected_centre.len() == 3 && input.expected_sigma.len() == 2);
    let indices = all_below(&input.observation_pose, poses)
        && all_below(&input.observation_point, points)
        && all_below(&input.pose_camera, input.camera_models.len());
    let finite =
        [&state.intrinsics, &state.poses, &state.points, &input.pixels, &input.weights, &input.prior_sigma]
            .iter()
            .chain(&[
                &input.expected_rotation,
                &input.expected_place,
                &input.expected_centre,
                &input.expected_sigma,
            ])
            .all(|values| all_finite(values));
    match (shapes && indices, finite, observations) {
        (false, _, _) => Err(SfmError::Solver("the problem is inconsistent".to_owned())),
        (_, false, _) => Err(SfmError::Solver("a number is not finite".to_owned())),
        (_, _, 0) => Err(SfmError::Solver("there are no observations".to_owned())),
        _ => Ok(()),
    }
}
