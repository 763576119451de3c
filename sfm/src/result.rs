//! What structure from motion hands back.

use glam::{DMat3, DVec3};
use scene::motion_report::MotionReport;
use scene::{Camera, Decision, Features, Pose, Reconstruction, TwoViewGeometry};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Cost of one step.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StepTime {
    /// Name of the step.
    pub step: String,
    /// Wall-clock time, seconds.
    pub wall_s: f64,
    /// User and system time of the process, seconds (0 where the platform does not tell).
    pub cpu_s: f64,
}

/// Counts and costs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SfmStats {
    /// Images given.
    pub images: usize,
    /// Images with a pose.
    pub registered: usize,
    /// Features over all images.
    pub features: usize,
    /// Image pairs that were matched.
    pub pairs_matched: usize,
    /// Image pairs that passed verification.
    pub pairs_verified: usize,
    /// Points of the model.
    pub points: usize,
    /// Observations of the model's points.
    pub observations: usize,
    /// Mean observations a point.
    pub mean_track_length: f64,
    /// Root mean square of the reprojection error over observations, pixels.
    pub reprojection_rms_px: f64,
    /// Median reprojection error over observations, pixels.
    pub reprojection_median_px: f64,
    /// Cost of each step, in order.
    pub steps: Vec<StepTime>,
}

/// How uncertain a pose is after the final adjustment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseDeviation {
    /// Standard deviations of the rotation about the camera's x, y and z axes, radians.
    pub rotation: [f64; 3],
    /// Covariance of the camera centre, world frame, scene units squared.
    pub centre: DMat3,
}

impl PoseDeviation {
    /// Standard deviation of the camera centre in space, scene units.
    pub(crate) fn centre_length(&self) -> f64 {
        (self.centre.x_axis.x + self.centre.y_axis.y + self.centre.z_axis.z).sqrt()
    }
}

/// `v vᵀ`: the covariance of a step of one standard deviation along `v`.
pub(crate) fn outer_square(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}

/// The pose of a frame of a video, chosen for the model or not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FramePose {
    /// When it was taken, seconds.
    pub time_s: f64,
    /// `cam_from_world`.
    pub pose: Pose,
    /// Standard deviations.
    pub deviation: PoseDeviation,
}

/// Standard deviations from the final adjustment (gauge: first camera and the scale fixed).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Uncertainty {
    /// By camera number: one per parameter, 0 for those held constant.
    pub cameras: BTreeMap<u32, Vec<f64>>,
    /// By image number.
    pub images: BTreeMap<u32, PoseDeviation>,
    /// Robust standard deviation of one residual coordinate, pixels.
    pub sigma_px: f64,
}

/// What [`crate::reconstruct::reconstruct`] found.
#[derive(Clone, Debug, Default)]
pub struct SfmResult {
    /// The model; `None` where the images carry none. Image number = 1 + index of the frame.
    pub reconstruction: Option<Reconstruction>,
    /// Why there is no model (empty where there is one).
    pub reason: String,
    /// Frames without a pose: name, and why.
    pub missing: Vec<(String, String)>,
    /// Registered images that are weakly constrained: name, and why.
    pub weak_images: Vec<(String, String)>,
    /// What the evidence decided.
    pub decisions: Vec<Decision>,
    /// Standard deviations of poses and intrinsics.
    pub uncertainty: Option<Uncertainty>,
    /// How the object moves, where it turns or tumbles.
    pub motion: Option<MotionReport>,
    /// Of a video: poses of all its frames, by the motion; between registered frames alone where
    /// that is free.
    pub frames: Vec<FramePose>,
    /// Counts and costs.
    pub stats: SfmStats,
    /// One per frame: intrinsics as they were before the model was solved (for the database).
    pub initial_cameras: Vec<Camera>,
    /// One per frame.
    pub features: Vec<Features>,
    /// Matches before verification, where [`crate::config::SfmConfig::keep_matches`] asks for them.
    pub matches: Vec<crate::matching::PairMatches>,
    /// Verified pairs.
    pub geometries: Vec<TwoViewGeometry>,
}
