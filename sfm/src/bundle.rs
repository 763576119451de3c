//! Bundle adjustment: poses, intrinsics and points that fit all observations best.
//!
//! The scene is moved to its median and scaled to unit size before it is solved, so that units and
//! the place of the origin do not matter (Triggs et al., "Bundle adjustment: a modern synthesis",
//! 1999, on scaling and gauge).

mod adjustable;
mod information;
mod points;

pub(crate) use adjustable::Adjustable;
pub(crate) use information::PoseInformation;

use crate::ceres::{self, BundleInput, BundleState};
use crate::error::SfmError;
use crate::statistics::median;
use glam::{DMat3, DQuat, DVec2, DVec3};
use scene::{Camera, Pose, Progress};

/// How residuals are weighed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum RobustLoss {
    /// `r²`
    #[default]
    Squared,
    /// `2 s² (√(1 + r²/s²) − 1)`
    SoftL1(f64),
    /// `s² log(1 + r²/s²)`
    Cauchy(f64),
}

/// When to stop, and how to weigh residuals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SolveOptions {
    /// Loss; its scale in standard deviations of the observations.
    pub loss: RobustLoss,
    /// Most iterations.
    pub max_iterations: u32,
    /// Relative decrease of the cost at which to stop.
    pub function_tolerance: f64,
    /// Relative change of the parameters at which to stop.
    pub parameter_tolerance: f64,
    /// Whether points first settle alone (turns under Cauchy's loss only). Near the end that saves
    /// steps; far from it, observations across a joint that is still wrong might be taken for
    /// outliers.
    pub points_first: bool,
}

impl Default for SolveOptions {
    fn default() -> Self {
        Self {
            loss: RobustLoss::Squared,
            max_iterations: 50,
            function_tolerance: 1e-8,
            parameter_tolerance: 1e-10,
            points_first: false,
        }
    }
}

/// One observation of a point by a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BundleObservation {
    /// Index of the pose.
    pub pose: u32,
    /// Index of the point.
    pub point: u32,
    /// Measured pixel.
    pub pixel: DVec2,
    /// Standard deviation of each coordinate, pixels.
    pub sigma_px: f64,
}

/// What is known of an intrinsic parameter beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct IntrinsicsPrior {
    /// Index of the camera.
    pub camera: usize,
    /// Index of the parameter, in the model's order.
    pub parameter: usize,
    /// Expected value.
    pub mean: f64,
    /// Standard deviation.
    pub sigma: f64,
}

/// What is expected of the poses beside the observations.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct ExpectedPoses {
    /// By pose: `cam_from_world`.
    pub poses: Vec<Pose>,
    /// A point of the world: a pose is compared with the expected one by its rotation and by where
    /// it puts this point.
    pub centre: DVec3,
    /// Standard deviations of a coordinate of the two: radians, scene units.
    pub sigma: [f64; 2],
}

impl ExpectedPoses {
    /// The same of some poses alone.
    pub(crate) fn of_images(&self, images: &[usize]) -> Self {
        Self { poses: images.iter().map(|&i| self.poses[i]).collect(), ..self.clone() }
    }
}

/// An adjustment in plain arrays.
#[derive(Clone, Debug, Default)]
pub(crate) struct BundleProblem {
    /// Cameras.
    pub cameras: Vec<Camera>,
    /// For each camera, which of its parameters are solved for.
    pub camera_free: Vec<Vec<bool>>,
    /// Priors on intrinsics.
    pub priors: Vec<IntrinsicsPrior>,
    /// `cam_from_world`.
    pub poses: Vec<Pose>,
    /// Camera of each pose.
    pub pose_camera: Vec<u32>,
    /// Which poses are held.
    pub pose_constant: Vec<bool>,
    /// What is expected of them.
    pub expected: Option<ExpectedPoses>,
    /// Points, world frame.
    pub points: Vec<DVec3>,
    /// Which points are held.
    pub point_constant: Vec<bool>,
    /// Observations.
    pub observations: Vec<BundleObservation>,
}

/// What an adjustment did.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct BundleSummary {
    /// Root mean square of the weighted residual length before (robust cost).
    pub initial_rms: f64,
    /// The same after.
    pub final_rms: f64,
    /// Iterations taken.
    pub iterations: u32,
    /// Observations used (those behind their camera are left out).
    pub observations: usize,
    /// Whether a tolerance was met.
    pub converged: bool,
    /// Whether the result was taken over.
    pub usable: bool,
}

/// Covariances from the normal equations, for observations with the given standard deviations.
#[derive(Clone, Debug, Default)]
pub(crate) struct BundleCovariance {
    /// For each camera: row-major over its parameters, 0 where held.
    pub cameras: Vec<Vec<f64>>,
    /// For each pose: standard deviations of the rotation about the camera's axes (radians) and of
    /// the camera centre along the world's axes; 0 where held.
    pub poses: Vec<[f64; 6]>,
    /// For each pose: covariance of the camera centre, world frame, scene units squared.
    pub centres: Vec<DMat3>,
}

impl BundleProblem {
    /// Minimises in place. An unusable result leaves everything as it was (`usable` is false then).
    pub(crate) fn solve(
        &mut self,
        options: &SolveOptions,
        progress: &Progress,
    ) -> Result<BundleSummary, SfmError> {
        let frame = SceneNormalisation::of(self);
        let input = self.input(options, &frame);
        if input.weights.is_empty() {
            return Ok(BundleSummary::default());
        }
        let mut state = self.state(&frame);
        let outcome = ceres::solve(&input, &mut state, progress)?;
        let m = input.weights.len();
        let costs = [outcome.initial_cost, outcome.final_cost];
        let [initial_rms, final_rms] = costs.map(|cost| (2.0 * cost / m as f64).max(0.0).sqrt());
        let numbers = [&state.intrinsics, &state.poses, &state.points];
        let finite = numbers.iter().all(|values| values.iter().all(|v| v.is_finite()));
        let usable = outcome.usable && finite && outcome.final_cost <= outcome.initial_cost;
        if usable {
            self.take(&state, &frame);
        }
        Ok(BundleSummary {
            initial_rms,
            final_rms,
            iterations: outcome.iterations,
            observations: m,
            converged: outcome.converged,
            usable,
        })
    }

    /// Standard deviations of poses and intrinsics; `None` where the observations do not determine
    /// them.
    pub(crate) fn covariance(&self, options: &SolveOptions) -> Result<Option<BundleCovariance>, SfmError> {
        let frame = SceneNormalisation::of(self);
        let input = self.input(options, &frame);
        if input.weights.is_empty() {
            return Ok(None);
        }
        let Some((of_poses, of_cameras)) = ceres::covariance(&input, &self.state(&frame))? else {
            return Ok(None);
        };
        let mut cameras = Vec::new();
        let mut rest = of_cameras.as_slice();
        for camera in &self.cameras {
            let (own, others) = rest.split_at(camera.params.len().pow(2));
            cameras.push(own.to_vec());
            rest = others;
        }
        let mut result = BundleCovariance { cameras, ..BundleCovariance::default() };
        for (pose, c) in self.poses.iter().zip(of_poses.chunks_exact(36)) {
            let centre = centre_covariance(&frame.pose_in(pose), c, frame.scale);
            let variances = [c[0], c[7], c[14], centre.x_axis.x, centre.y_axis.y, centre.z_axis.z];
            result.poses.push(variances.map(|v| v.max(0.0).sqrt()));
            result.centres.push(centre);
        }
        Ok(Some(result))
    }

    /// Information (inverse covariance) of all free intrinsics jointly after poses and points are
    /// eliminated, row-major over the free parameters of all cameras in their order, without the
    /// priors; `None` where that cannot be done.
    pub(crate) fn intrinsics_information(
        &self,
        options: &SolveOptions,
    ) -> Result<Option<Vec<f64>>, SfmError> {
        let frame = SceneNormalisation::of(self);
        let input = self.input(options, &frame);
        if input.weights.is_empty() {
            return Ok(None);
        }
        ceres::camera_information(&input, &self.state(&frame))
    }

    fn state(&self, frame: &SceneNormalisation) -> BundleState {
        BundleState {
            intrinsics: self.cameras.iter().flat_map(|c| c.params.iter().copied()).collect(),
            poses: self.poses.iter().flat_map(|p| numbers_of(&frame.pose_in(p))).collect(),
            points: self.points.iter().flat_map(|&x| frame.point_in(x).to_array()).collect(),
        }
    }

    fn take(&mut self, state: &BundleState, frame: &SceneNormalisation) {
        let mut values = state.intrinsics.iter();
        for camera in &mut self.cameras {
            camera.params.iter_mut().zip(&mut values).for_each(|(p, v)| *p = *v);
        }
        for ((pose, p), constant) in
            self.poses.iter_mut().zip(state.poses.chunks_exact(7)).zip(&self.pose_constant)
        {
            if !constant {
                let moved = Pose::new(DQuat::from_slice(p), DVec3::from_slice(&p[4..]));
                *pose = frame.pose_out(&moved);
            }
        }
        for ((x, p), constant) in
            self.points.iter_mut().zip(state.points.chunks_exact(3)).zip(&self.point_constant)
        {
            if !constant {
                *x = frame.point_out(DVec3::from_slice(p));
            }
        }
    }

    pub(crate) fn input(&self, options: &SolveOptions, frame: &SceneNormalisation) -> BundleInput {
        let mut offset = 0;
        let mut input = BundleInput {
            pose_camera: self.pose_camera.clone(),
            pose_held: self.held_poses(frame),
            point_held: self.point_constant.iter().map(|&c| u8::from(c)).collect(),
            max_iterations: options.max_iterations as i32,
            function_tolerance: options.function_tolerance,
            parameter_tolerance: options.parameter_tolerance,
            ..BundleInput::default()
        };
        (input.loss, input.loss_scale) = match options.loss {
            RobustLoss::Squared => (0, 1.0),
            RobustLoss::SoftL1(s) => (1, s),
            RobustLoss::Cauchy(s) => (2, s),
        };
        input.free_poses = input.pose_held.iter().filter(|&&h| h != 7).count();
        for (camera, free) in self.cameras.iter().zip(&self.camera_free) {
            input.camera_models.push(camera.model.colmap_id());
            input.camera_offsets.push(offset);
            offset += camera.params.len();
            input.intrinsics_free.extend(free.iter().map(|&f| u8::from(f)));
        }
        input.prior_mean = vec![0.0; offset];
        input.prior_sigma = vec![0.0; offset];
        for prior in &self.priors {
            let i = input.camera_offsets[prior.camera] + prior.parameter;
            (input.prior_mean[i], input.prior_sigma[i]) = (prior.mean, prior.sigma);
        }
        if let Some(ExpectedPoses { poses, centre, sigma }) = &self.expected {
            for pose in poses {
                let q = pose.rotation;
                input.expected_rotation.extend([q.x, q.y, q.z, q.w]);
                input.expected_place.extend((pose.transform(*centre) / frame.scale).to_array());
            }
            input.expected_centre = frame.point_in(*centre).to_array().to_vec();
            input.expected_sigma = vec![sigma[0], sigma[1] / frame.scale];
        }
        for o in &self.observations {
            let x = self.poses[o.pose as usize].transform(self.points[o.point as usize]);
            if x.z > 1e-9 * frame.scale && o.sigma_px > 0.0 {
                input.observation_pose.push(o.pose);
                input.observation_point.push(o.point);
                input.pixels.extend(o.pixel.to_array());
                input.weights.push(1.0 / o.sigma_px);
            }
        }
        input
    }

    /// Gauge: where fewer than two poses and no points are constant, and nothing is expected of the
    /// poses, the first pose is held, and that coordinate of the farthest pose's translation that
    /// changes most with the scale.
    fn held_poses(&self, frame: &SceneNormalisation) -> Vec<u8> {
        let mut held: Vec<u8> = self.pose_constant.iter().map(|&c| if c { 7 } else { 0 }).collect();
        let constant = held.iter().filter(|&&h| h == 7).count();
        if self.expected.is_some()
            || constant >= 2
            || held.len() < 2
            || self.point_constant.iter().filter(|&&c| c).count() >= 3
        {
            return held;
        }
        let first = held.iter().position(|&h| h == 7).unwrap_or(0);
        held[first] = 7;
        let centre = frame.pose_in(&self.poses[first]).centre();
        let baselines = self.poses.iter().map(|p| {
            let p = frame.pose_in(p);
            p.rotation * (p.centre() - centre)
        });
        let farthest = baselines.enumerate().filter(|(i, _)| *i != first);
        if let Some((i, baseline)) = farthest.max_by(|a, b| a.1.length().total_cmp(&b.1.length())) {
            held[i] = 1 + baseline.abs().max_position() as u8;
        }
        held
    }
}

fn numbers_of(Pose { rotation: q, translation: t }: &Pose) -> [f64; 7] {
    [q.x, q.y, q.z, q.w, t.x, t.y, t.z]
}

/// Covariance of the camera centre from one over (ω, t) in the normalised scene: `c = −Rᵀ t`, so
/// `δc = −Rᵀ (δt + t × δω)`.
fn centre_covariance(pose: &Pose, covariance: &[f64], scale: f64) -> DMat3 {
    let back = -pose.matrix().transpose();
    let t = pose.translation;
    let columns: [DVec3; 6] = std::array::from_fn(|k| {
        let axis = DVec3::from_array(std::array::from_fn(|i| f64::from(i == k % 3)));
        back * if k < 3 { t.cross(axis) } else { axis }
    });
    let mut of_centre = DMat3::ZERO;
    for (n, c) in covariance.iter().enumerate() {
        let (a, b) = (columns[n / 6], columns[n % 6] * *c);
        of_centre += DMat3::from_cols(a * b.x, a * b.y, a * b.z);
    }
    of_centre * (scale * scale)
}

/// Moves the scene's median to the origin and scales the median distance from it to 1.
#[derive(Clone, Debug)]
pub(crate) struct SceneNormalisation {
    /// What becomes the origin.
    pub centre: DVec3,
    /// What becomes 1.
    pub scale: f64,
}

impl SceneNormalisation {
    fn of(problem: &BundleProblem) -> Self {
        let finite: Vec<DVec3> = problem.points.iter().copied().filter(|x| x.is_finite()).collect();
        let centre = DVec3::from_array([0, 1, 2].map(|i| median(finite.iter().map(|x| x[i]).collect())));
        let of_points = median(finite.iter().map(|x| (*x - centre).length()).collect());
        let of_poses = median(problem.poses.iter().map(|p| (p.centre() - centre).length()).collect());
        let scale = of_points.max(of_poses * 1e-3);
        Self { centre, scale: if scale > 0.0 && scale.is_finite() { scale } else { 1.0 } }
    }

    fn point_in(&self, x: DVec3) -> DVec3 {
        (x - self.centre) / self.scale
    }

    fn point_out(&self, x: DVec3) -> DVec3 {
        x * self.scale + self.centre
    }

    fn pose_in(&self, pose: &Pose) -> Pose {
        Pose { rotation: pose.rotation, translation: pose.transform(self.centre) / self.scale }
    }

    fn pose_out(&self, pose: &Pose) -> Pose {
        Pose {
            rotation: pose.rotation,
            translation: pose.translation * self.scale - pose.rotation * self.centre,
        }
    }
}

/// Which parameters of a camera are solved for.
pub(crate) fn free_parameters(
    camera: &Camera,
    focal: bool,
    principal_point: bool,
    distortion: bool,
) -> Vec<bool> {
    let n = camera.model.num_focals();
    (0..camera.params.len())
        .map(|i| {
            if i < n {
                focal
            } else if i < n + 2 {
                principal_point
            } else {
                distortion
            }
        })
        .collect()
}

#[cfg(test)]
mod tests;
