//! What changes as training goes on, but for the Gaussians and the rules' own states: the part of a
//! checkpoint that all rules may read.

use super::pace::Pace;
use super::schedule::Place;
use crate::backend::StepOutput;
use crate::dataset::JointPlace;
use scene::decision::Decision;
use serde::{Deserialize, Serialize};

/// A point of the training curve: means over the steps since the point before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Steps done.
    pub iteration: u32,
    /// Seconds spent.
    pub seconds: f64,
    /// Loss of the training views.
    pub loss: f32,
    /// PSNR of the training views at the resolution in use, dB.
    pub psnr: f32,
    /// Gaussians.
    pub gaussians: usize,
}

/// How training sees its views otherwise than the data set gives them; by training view, empty
/// where nothing was changed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct ViewCorrections {
    /// Gains by channel: the photo shows the scene times this. Written by the exposure rule.
    pub(crate) gains: Vec<[f32; 3]>,
    /// Quaternion (x, y, z, w) and translation of `cam_from_world`, normalised. Written by the pose
    /// rule.
    pub(crate) poses: Vec<[f32; 7]>,
    /// Angles of each joint and their standard deviations, radians, by view of the data set; those
    /// of the data set where there are none. Written by the joint rule.
    #[serde(default)]
    pub(crate) joints: Vec<[Vec<f64>; 2]>,
    /// Where each joint is, normalised. Written by the joint rule with the angles.
    #[serde(default)]
    pub(crate) hinges: Vec<JointPlace>,
}

/// Sums over steps, for the next point of the curve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct StepSums {
    loss: f64,
    squared_error: f64,
    steps: f64,
}

/// The state of a training.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct TrainingState {
    /// What the run was told, as JSON: another configuration starts afresh.
    pub(crate) fingerprint: String,
    /// The place in the schedule.
    pub(crate) place: Place,
    /// What steps cost and how far each one goes.
    pub(crate) pace: Pace,
    /// Gaussians at the start.
    pub(crate) first: usize,
    /// The curve so far.
    pub(crate) curve: Vec<CurvePoint>,
    /// What steps saw since its last point.
    pub(crate) sums: StepSums,
    /// Gradients that were not finite: their Gaussians took no step.
    pub(crate) non_finite: usize,
    /// Gains and poses of the training views.
    pub(crate) corrections: ViewCorrections,
    /// The decisions so far.
    pub(crate) decisions: Vec<Decision>,
}

impl TrainingState {
    /// Adds up what a step saw; `false` where its loss is not finite.
    pub(crate) fn note_step(&mut self, output: &StepOutput) -> bool {
        if !(output.loss.is_finite() && output.mse.is_finite()) {
            return false;
        }
        self.non_finite += output.non_finite;
        self.sums.loss += f64::from(output.loss);
        self.sums.squared_error += f64::from(output.mse);
        self.sums.steps += 1.0;
        true
    }

    /// Ends a stretch of the curve.
    pub(crate) fn add_curve_point(&mut self, gaussians: usize) {
        let StepSums { loss, squared_error, steps } = std::mem::take(&mut self.sums);
        if steps > 0.0 {
            self.curve.push(CurvePoint {
                iteration: self.place.iteration,
                seconds: self.place.seconds,
                loss: (loss / steps) as f32,
                psnr: psnr(squared_error / steps) as f32,
                gaussians,
            });
        }
    }
}

/// PSNR of a mean squared error of values in [0, 1], dB.
pub(crate) fn psnr(mean_squared_error: f64) -> f64 {
    -10.0 * mean_squared_error.max(f64::EPSILON).log10()
}
