//! What training yields.

use super::state::CurvePoint;
use crate::backend::KernelTimes;
use crate::view::RenderOptions;
use scene::{Decision, Gaussians, Pose};

/// Gaussians that move, as they were trained.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MovingResult {
    /// How many Gaussians the body has, and each part after it, in the order of the Gaussians.
    pub gaussians: Vec<usize>,
    /// Angles of each joint, radians, by view of the data set.
    pub angles: Vec<Vec<f64>>,
    /// Their standard deviations.
    pub sigmas: Vec<Vec<f64>>,
}

/// What training yields.
#[derive(Clone, Debug, Default)]
pub struct TrainResult {
    /// World frame.
    pub gaussians: Gaussians,
    /// Loss and PSNR over time.
    pub curve: Vec<CurvePoint>,
    /// What was decided and why.
    pub decisions: Vec<Decision>,
    /// Wall seconds by kernel.
    pub timings: KernelTimes,
    /// Steps done.
    pub iterations: u32,
    /// Names and refined poses (`cam_from_world`, world frame) of the training views; empty where
    /// they stayed as given.
    pub poses: Vec<(String, Pose)>,
    /// Which Gaussians move, and how; `None` where nothing does.
    pub moving: Option<MovingResult>,
    /// How to render the result as training saw it.
    pub render: RenderOptions,
}
