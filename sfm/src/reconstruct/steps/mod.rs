//! The sequence of steps. Each takes the model and hands it on, better or as it was, with what it
//! decided.
//!
//! 1. `video-turn`: the model of a video in which something turns about one axis; where that
//!    stands, it is the model.
//! 2. Observations: `features`, `matching`, `verification`; where most images share few matches
//!    `blurred-features` and `constant-step`; `guided-matching`.
//! 3. Poses: `mapping`; then, where it lacks images or contradicts its pairs, `aliasing`,
//!    `second-attempt`, `circle-completion`.
//! 4. Cameras: `shared-cameras`, `camera-model`, and the `final-adjustment` with what was decided.
//! 5. Better observations, each with an adjustment of its own: `densify`, `subpixel`,
//!    `plane-tracks`; `isolated-points`.
//! 6. `motion`: whether poses are on a circle, or about one axis; `covariance`.
//! 7. What is handed back: `points`, `colours`.
//!
//! Most of them can be left out by `--skip NAME` ([`StepName`]); what a step does is said in its
//! file.

mod aliasing;
mod blurred_features;
mod camera_model;
mod circle_completion;
mod colours;
mod constant_step;
mod covariance;
pub(super) mod densify;
mod features;
mod final_adjustment;
mod guided_matching;
mod isolated_points;
mod mapper;
mod mapping;
mod matching;
mod motion;
mod plane_tracks;
mod points;
mod rotation;
mod second_attempt;
mod shared_cameras;
mod subpixel;
#[cfg(test)]
mod tests;
mod ties;
mod verification;
mod video_turn;

use super::clock::Clock;
use super::context::StepContext;
use super::export::why_no_model;
use super::model::{ModelStage, SfmModel, StepResult};
use crate::skip::StepName;
use crate::{SfmError, SfmResult};

/// A step of the sequence.
struct ReconstructionStep {
    name: &'static str,
    /// Stages of the model in which it is taken.
    stages: &'static [ModelStage],
    /// Its name where it can be left out.
    skip: Option<StepName>,
    run: fn(SfmModel, &StepContext<'_>) -> StepResult,
}

impl ReconstructionStep {
    const fn always(
        name: &'static str,
        stages: &'static [ModelStage],
        run: fn(SfmModel, &StepContext<'_>) -> StepResult,
    ) -> Self {
        Self { name, stages, skip: None, run }
    }

    const fn unless(
        skip: StepName,
        name: &'static str,
        stages: &'static [ModelStage],
        run: fn(SfmModel, &StepContext<'_>) -> StepResult,
    ) -> Self {
        Self { name, stages, skip: Some(skip), run }
    }
}

const UNPOSED: &[ModelStage] = &[ModelStage::Unposed];
const POSED: &[ModelStage] = &[ModelStage::Posed];

/// All steps in their order.
const STEPS: [ReconstructionStep; 22] = [
    ReconstructionStep::always("video-turn", UNPOSED, video_turn::run),
    ReconstructionStep::always("features", UNPOSED, features::run),
    ReconstructionStep::always("matching", UNPOSED, matching::run),
    ReconstructionStep::always("verification", UNPOSED, verification::run),
    ReconstructionStep::unless(StepName::BlurredFeatures, "blurred-features", UNPOSED, blurred_features::run),
    ReconstructionStep::unless(StepName::ConstantStep, "constant-step", UNPOSED, constant_step::run),
    ReconstructionStep::unless(StepName::GuidedMatching, "guided-matching", UNPOSED, guided_matching::run),
    ReconstructionStep::always("mapping", UNPOSED, mapping::run),
    ReconstructionStep::unless(StepName::Aliasing, "aliasing", POSED, aliasing::run),
    ReconstructionStep::unless(StepName::SecondAttempt, "second-attempt", POSED, second_attempt::run),
    ReconstructionStep::unless(
        StepName::CircleCompletion,
        "circle-completion",
        POSED,
        circle_completion::run,
    ),
    ReconstructionStep::unless(StepName::SharedCameras, "shared-cameras", POSED, shared_cameras::run),
    ReconstructionStep::always("camera-model", POSED, camera_model::run),
    ReconstructionStep::always("final-adjustment", POSED, final_adjustment::run),
    ReconstructionStep::unless(StepName::Densify, "densify", POSED, densify::run),
    ReconstructionStep::unless(StepName::Subpixel, "subpixel", POSED, subpixel::run),
    ReconstructionStep::unless(StepName::PlaneTracks, "plane-tracks", POSED, plane_tracks::run),
    ReconstructionStep::unless(StepName::IsolatedPoints, "isolated-points", POSED, isolated_points::run),
    ReconstructionStep::always("motion", &[ModelStage::Unposed, ModelStage::Posed], motion::run),
    ReconstructionStep::always("covariance", POSED, covariance::run),
    ReconstructionStep::always("points", &[ModelStage::Posed, ModelStage::OneAxis], points::run),
    ReconstructionStep::always("colours", &[ModelStage::Posed, ModelStage::OneAxis], colours::run),
];

/// Takes the model through all steps of its stage that are not to be skipped, and notes what each
/// costs.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> Result<SfmResult, SfmError> {
    let initial_cameras = model.setup.of_frames();
    let mut decisions = Vec::new();
    let mut clock = Clock::start();
    for step in &STEPS {
        if !step.stages.contains(&model.stage) || step.skip.is_some_and(|name| context.skips(name)) {
            continue;
        }
        context.progress.check()?;
        let decided;
        (model, decided) = (step.run)(model, context)?;
        decisions.extend(decided);
        clock.lap(step.name, &mut model.stats.steps);
    }
    let unposed = model.stage == ModelStage::Unposed;
    let reason = if unposed { why_no_model(&model.features, &model.geometries) } else { String::new() };
    Ok(model.into_result(initial_cameras, reason, decisions))
}
