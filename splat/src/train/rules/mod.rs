//! The rules of training: each decides one thing by what training sees, and owns its part of the
//! checkpoint.
//!
//! A rule has up to four hooks, called in the order of the lists here: `before_step` says what a
//! step needs; `after_step` changes the Gaussians by what steps saw, at the position at which the
//! step was taken; `review`, once the position has moved, looks for evidence and decides;
//! `conclude` reports what is only known at the end. To add a rule: a file with a state and its
//! hooks, a field in [`Rules`], a line in the lists.

pub(crate) mod exposure;
mod growth;
mod joints;
mod poses;
mod prune;
mod sh_degree;
mod silhouette;
pub(crate) mod smoothing;

use crate::backend::StepOutput;
use crate::dataset::MovingParts;
use crate::error::SplatError;
use crate::model::Model;
use crate::train::context::RuleContext;
use scene::{Gaussians, Pose};
use serde::{Deserialize, Serialize};

/// Steps of a schedule with a time limit from which on it pays to look for evidence.
/// Source: chosen by hand, never measured.
const LEAST_STEPS: f64 = 300.0;

/// All rules with their states.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Rules {
    pub(crate) silhouette: silhouette::SilhouetteRule,
    pub(crate) smoothing: smoothing::SmoothingRule,
    pub(crate) sh_degree: sh_degree::ShDegreeRule,
    pub(crate) growth: growth::GrowthRule,
    pub(crate) exposure: exposure::ExposureRule,
    pub(crate) poses: poses::PoseRule,
    #[serde(default)]
    pub(crate) joints: joints::JointRule,
    pub(crate) prune: prune::PruneRule,
}

impl Rules {
    /// What a step needs.
    pub(crate) fn before_step(&mut self, step: &mut RuleContext) -> Result<(), SplatError> {
        self.sh_degree.before_step(step)
    }

    /// What follows from what a step saw of a view. A device that begins steps tells of no parts.
    pub(crate) fn after_view(&mut self, step: &mut RuleContext, view: usize, output: &StepOutput) {
        self.joints.after_view(step, view, output);
    }

    /// What follows from what steps saw.
    pub(crate) fn after_step(&mut self, step: &mut RuleContext) -> Result<(), SplatError> {
        self.growth.after_step(step)
    }

    /// Looks whether something is to be decided at this place of the schedule. What costs
    /// renderings is not where the steps that a time limit leaves are too few to pay for it, nor at
    /// the schedule's end.
    pub(crate) fn review(&mut self, step: &mut RuleContext) -> Result<(), SplatError> {
        let short = step.setup.config.time_limit.is_some() && step.expected_steps() < LEAST_STEPS;
        self.silhouette.review(step)?;
        self.smoothing.review(step)?;
        if step.position() >= 1.0 || short {
            return Ok(());
        }
        self.sh_degree.review(step)?;
        self.growth.review(step)?;
        self.exposure.review(step)?;
        self.poses.review(step)?;
        self.joints.review(step)?;
        self.prune.review(step)
    }

    /// What the Gaussians need once the last step is taken.
    pub(crate) fn after_training(&mut self, step: &RuleContext, model: &mut Model) {
        self.silhouette.after_training(step, model);
    }

    /// The Gaussians in the order of the parts, and what moves these.
    pub(crate) fn moving(&self, step: &RuleContext, model: &mut Model) -> Option<MovingParts> {
        self.joints.conclude(step, model)
    }

    /// Takes Gaussians that were trained on refined poses to the frame of the poses as given, and
    /// reports what is only known at the end. Returns names and refined poses of the training
    /// views, none where they stayed as given.
    pub(crate) fn conclude(&self, step: &mut RuleContext, gaussians: &mut Gaussians) -> Vec<(String, Pose)> {
        let refined = self.poses.align(step, gaussians);
        self.growth.conclude(step.state, gaussians.len());
        self.silhouette.conclude(step.state);
        refined.map_or(Vec::new(), |(error_px, poses)| {
            self.poses.conclude(step.state, error_px);
            poses
        })
    }
}
