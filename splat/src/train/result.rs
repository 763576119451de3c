//! What training yields.

use super::state::CurvePoint;
use crate::backend::KernelTimes;
use crate::dataset::MovingParts;
use crate::view::RenderOptions;
use scene::{Decision, Gaussians, Pose};

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
    /// What moves, with the angles that were found; `None` where nothing does. The Gaussians are in
    /// the order of the parts.
    pub moving: Option<MovingParts>,
    /// How to render the result as training saw it.
    pub render: RenderOptions,
}
