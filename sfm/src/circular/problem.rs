//! Adjustment under the constraint of one axis: axis, angles, intrinsics and points that fit all
//! observations best.

use super::motion::{distance_from_axis, pose_at};
use crate::bundle::{Adjustable, BundleProblem, BundleSummary, SceneNormalisation, SolveOptions};
use crate::ceres::CircularInput;
use crate::ceres::circular::{CircularState, covariance, solve};
use crate::error::SfmError;
use glam::{DQuat, DVec3};
use scene::{Pose, Progress};

/// `Σ c θ = target` within a standard deviation, over two or three frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Relation {
    /// Indices of the frames; the last one may be missing.
    pub frames: [Option<u32>; 3],
    /// Coefficients.
    pub coefficients: [f64; 3],
    /// Expected value, radians.
    pub target: f64,
    /// Standard deviation, radians.
    pub sigma: f64,
}

impl Relation {
    /// `θ_to − θ_from = target` within `sigma`, radians.
    pub(crate) fn difference(from: usize, to: usize, target: f64, sigma: f64) -> Self {
        let frames = [Some(from as u32), Some(to as u32), None];
        Self { frames, coefficients: [-1.0, 1.0, 0.0], target, sigma }
    }
}

/// `n · z = target` within a standard deviation, z the unit direction of the axis in the camera's
/// frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ElevationPrior {
    /// Unit vector of the camera's frame.
    pub normal: DVec3,
    /// Sine of the angle between the axis and the plane across `normal`.
    pub target: f64,
    /// Standard deviation of that, about radians.
    pub sigma: f64,
}

/// An adjustment whose poses are `D_i (R Z(θ_i) X + t)`.
#[derive(Clone, Debug)]
pub(crate) struct CircularProblem {
    /// Cameras, points, observations; its poses follow from the rest.
    pub bundle: BundleProblem,
    /// Camera from turntable at angle 0; the turntable's origin is near the axis' point nearest to
    /// the camera.
    pub axis: Pose,
    /// By pose, radians; the first is held.
    pub angles: Vec<f64>,
    /// What is known of the angles.
    pub relations: Vec<Relation>,
    /// What is known of the axis' direction.
    pub levels: Vec<ElevationPrior>,
    /// By pose: the small motion D beside the axis (the identity for a pure turn).
    pub offsets: Vec<Pose>,
    /// Standard deviations of the offsets, radians and radii; `None`: they are held.
    pub offset_sigma: Option<[f64; 2]>,
}

/// Standard deviations from the normal equations, for observations with the given ones.
#[derive(Clone, Debug, Default)]
pub(crate) struct CircularCovariance {
    /// For each camera: row-major over its parameters, 0 where held.
    pub cameras: Vec<Vec<f64>>,
    /// Of the axis' direction: across it, in the plane of the axis and the camera, and out of it,
    /// radians.
    pub axis: [f64; 2],
    /// Of the angles, radians; 0 where held.
    pub angles: Vec<f64>,
    /// [P × P] joint covariance of the angles, radians².
    pub joint: Vec<f64>,
}

impl CircularProblem {
    /// A pure turn with the cameras, points and observations of `bundle`.
    pub(crate) fn new(bundle: BundleProblem, axis: Pose, angles: Vec<f64>) -> Self {
        let offsets = vec![Pose::IDENTITY; angles.len()];
        let (relations, levels) = (Vec::new(), Vec::new());
        let mut problem = Self { bundle, axis, angles, relations, levels, offsets, offset_sigma: None };
        problem.refresh();
        problem
    }

    /// The poses of `bundle` as a turn with offsets.
    pub(crate) fn with_offsets(bundle: BundleProblem, axis: Pose, angles: Vec<f64>) -> Self {
        let pairs = bundle.poses.iter().zip(&angles);
        let offsets = pairs.map(|(pose, angle)| pose.compose(&pose_at(&axis, *angle).inverse())).collect();
        let mut problem = Self::new(bundle, axis, angles);
        problem.offsets = offsets;
        problem.refresh();
        problem
    }

    /// Distance of the camera from the axis.
    pub(crate) fn radius(&self) -> f64 {
        distance_from_axis(&self.axis)
    }

    /// Computes the poses from axis, angles and offsets.
    fn refresh(&mut self) {
        let pairs = self.angles.iter().zip(&self.offsets);
        self.bundle.poses =
            pairs.map(|(angle, offset)| offset.compose(&pose_at(&self.axis, *angle))).collect();
    }

    /// Minimises in place. An unusable result leaves everything as it was (`usable` is false then).
    pub(crate) fn solve(
        &mut self,
        options: &SolveOptions,
        progress: &Progress,
    ) -> Result<BundleSummary, SfmError> {
        let scale = self.radius();
        let input = self.input(options, scale);
        if input.bundle.weights.is_empty() {
            return Ok(BundleSummary::default());
        }
        let mut state = self.state(scale);
        if options.points_first {
            let points = self.bundle.settle_points(options.loss);
            state.points = points.iter().flat_map(|x| (*x / scale).to_array()).collect();
        }
        let outcome = solve(&input, &mut state, progress)?;
        let m = input.bundle.weights.len();
        let numbers = [&state.intrinsics, &state.axis, &state.angles, &state.offsets, &state.points];
        let finite = numbers.iter().all(|values| values.iter().all(|v| v.is_finite()));
        let usable = outcome.usable && finite && outcome.final_cost <= outcome.initial_cost;
        if usable {
            self.take(&state, scale);
        }
        Ok(BundleSummary {
            initial_rms: root_mean_square(outcome.initial_cost, m),
            final_rms: root_mean_square(outcome.final_cost, m),
            iterations: outcome.iterations,
            observations: m,
            converged: outcome.converged,
            usable,
        })
    }

    /// Standard deviations of axis, angles and intrinsics; `None` where the observations do not
    /// determine them. Offsets are taken as they are. `excess`: factor on the variances of the
    /// observations, not on those of priors.
    pub(crate) fn covariance(
        &self,
        options: &SolveOptions,
        excess: f64,
    ) -> Result<Option<CircularCovariance>, SfmError> {
        let scale = self.radius();
        let mut input = self.input(options, scale);
        if input.bundle.weights.is_empty() {
            return Ok(None);
        }
        // Priors that are tighter by the factor, and the factor on the result: the robust loss sees
        // the observations as they are.
        let factor = excess.sqrt();
        input.relation_weights.iter_mut().for_each(|w| *w *= factor);
        input.level_weights.iter_mut().for_each(|w| *w *= factor);
        input.bundle.prior_sigma.iter_mut().for_each(|sigma| *sigma /= factor);
        let Some(found) = covariance(&input, &self.state(scale))? else { return Ok(None) };
        let [of_turn, of_cameras] =
            <[Vec<f64>; 2]>::from(found).map(|all| all.iter().map(|c| excess * c).collect::<Vec<f64>>());
        let size = 3 + self.angles.len();
        let deviations: Vec<f64> = (0..size).map(|i| of_turn[i * size + i].max(0.0).sqrt()).collect();
        let mut rest = of_cameras.as_slice();
        let mut cameras = Vec::new();
        for camera in &self.bundle.cameras {
            let (own, others) = rest.split_at(camera.params.len().pow(2));
            cameras.push(own.to_vec());
            rest = others;
        }
        let angles = deviations[3..].to_vec();
        let n = self.angles.len();
        let joint = (0..n * n).map(|k| of_turn[(3 + k / n) * size + 3 + k % n]).collect();
        Ok(Some(CircularCovariance { cameras, axis: [deviations[0], deviations[1]], angles, joint }))
    }

    fn state(&self, scale: f64) -> CircularState {
        CircularState {
            intrinsics: self.bundle.cameras.iter().flat_map(|c| c.params.iter().copied()).collect(),
            axis: numbers_of(&self.axis, scale).to_vec(),
            angles: self.angles.clone(),
            offsets: self.offsets.iter().flat_map(|p| numbers_of(p, scale)).collect(),
            points: self.bundle.points.iter().flat_map(|x| (*x / scale).to_array()).collect(),
        }
    }

    fn take(&mut self, state: &CircularState, scale: f64) {
        let mut values = state.intrinsics.iter();
        for camera in &mut self.bundle.cameras {
            camera.params.iter_mut().zip(&mut values).for_each(|(p, v)| *p = *v);
        }
        self.axis = scaled_pose(&state.axis, scale);
        self.angles.clone_from(&state.angles);
        if self.offset_sigma.is_some() {
            self.offsets = state.offsets.chunks_exact(7).map(|p| scaled_pose(p, scale)).collect();
        }
        for (x, p) in self.bundle.points.iter_mut().zip(state.points.chunks_exact(3)) {
            *x = DVec3::from_slice(p) * scale;
        }
        self.refresh();
    }

    fn input(&self, options: &SolveOptions, scale: f64) -> CircularInput {
        let bundle = self.bundle.input(options, &SceneNormalisation { centre: DVec3::ZERO, scale });
        let z = self.axis.rotation * DVec3::Z;
        let out = (self.axis.translation - z * z.dot(self.axis.translation)).normalize();
        // Turning about `out × z` tips the axis towards the camera; along `z × out` it moves
        // sideways.
        let basis = [out, z.cross(out), z.cross(out)];
        let mut input = CircularInput {
            bundle,
            axis_basis: basis.iter().flat_map(|v| v.to_array()).collect(),
            angle_held: (0..self.angles.len()).map(|i| u8::from(i == 0)).collect(),
            offset_sigma: self.offset_sigma.unwrap_or_default().to_vec(),
            ..CircularInput::default()
        };
        for r in &self.relations {
            input.relation_angles.extend(r.frames.map(|f| f.unwrap_or(u32::MAX)));
            input.relation_coefficients.extend(r.coefficients);
            input.relation_targets.push(r.target);
            input.relation_weights.push(1.0 / r.sigma);
        }
        for l in &self.levels {
            input.level_normals.extend(l.normal.to_array());
            input.level_targets.push(l.target);
            input.level_weights.push(1.0 / l.sigma);
        }
        input
    }
}

/// Root mean square residual of `m` observations from ½ Σ ρ.
fn root_mean_square(cost: f64, m: usize) -> f64 {
    (2.0 * cost / m as f64).max(0.0).sqrt()
}

/// Quaternion and translation of a pose, its translation divided by `scale`.
fn numbers_of(pose: &Pose, scale: f64) -> [f64; 7] {
    let (q, t) = (pose.rotation, pose.translation / scale);
    [q.x, q.y, q.z, q.w, t.x, t.y, t.z]
}

/// A pose from quaternion and translation, its translation multiplied by `scale`.
fn scaled_pose(numbers: &[f64], scale: f64) -> Pose {
    Pose::new(DQuat::from_slice(numbers), DVec3::from_slice(&numbers[4..]) * scale)
}

impl Adjustable for CircularProblem {
    fn bundle(&self) -> &BundleProblem {
        &self.bundle
    }
    fn bundle_mut(&mut self) -> &mut BundleProblem {
        &mut self.bundle
    }
    fn minimise(&mut self, options: &SolveOptions, progress: &Progress) -> Result<BundleSummary, SfmError> {
        self.solve(options, progress)
    }
}
