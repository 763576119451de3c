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
use super::model::{Model, Stage, StepResult};
use crate::skip::StepName;
use crate::{SfmError, SfmResult};

/// A step of the sequence.
struct Step {
    name: &'static str,
    /// Stages of the model in which it is taken.
    stages: &'static [Stage],
    /// Its name where it can be left out.
    skip: Option<StepName>,
    run: fn(Model, &StepContext<'_>) -> StepResult,
}

impl Step {
    const fn always(
        name: &'static str,
        stages: &'static [Stage],
        run: fn(Model, &StepContext<'_>) -> StepResult,
    ) -> Self {
        Self { name, stages, skip: None, run }
    }

    const fn unless(
        skip: StepName,
        name: &'static str,
        stages: &'static [Stage],
        run: fn(Model, &StepContext<'_>) -> StepResult,
    ) -> Self {
        Self { name, stages, skip: Some(skip), run }
    }
}

const UNPOSED: &[Stage] = &[Stage::Unposed];
const POSED: &[Stage] = &[Stage::Posed];

/// All steps in their order.
const STEPS: [Step; 22] = [
    Step::always("video-turn", UNPOSED, video_turn::run),
    Step::always("features", UNPOSED, features::run),
    Step::always("matching", UNPOSED, matching::run),
    Step::always("verification", UNPOSED, verification::run),
    Step::unless(StepName::BlurredFeatures, "blurred-features", UNPOSED, blurred_features::run),
    Step::unless(StepName::ConstantStep, "constant-step", UNPOSED, constant_step::run),
    Step::unless(StepName::GuidedMatching, "guided-matching", UNPOSED, guided_matching::run),
    Step::always("mapping", UNPOSED, mapping::run),
    Step::unless(StepName::Aliasing, "aliasing", POSED, aliasing::run),
    Step::unless(StepName::SecondAttempt, "second-attempt", POSED, second_attempt::run),
    Step::unless(StepName::CircleCompletion, "circle-completion", POSED, circle_completion::run),
    Step::unless(StepName::SharedCameras, "shared-cameras", POSED, shared_cameras::run),
    Step::always("camera-model", POSED, camera_model::run),
    Step::always("final-adjustment", POSED, final_adjustment::run),
    Step::unless(StepName::Densify, "densify", POSED, densify::run),
    Step::unless(StepName::Subpixel, "subpixel", POSED, subpixel::run),
    Step::unless(StepName::PlaneTracks, "plane-tracks", POSED, plane_tracks::run),
    Step::unless(StepName::IsolatedPoints, "isolated-points", POSED, isolated_points::run),
    Step::always("motion", &[Stage::Unposed, Stage::Posed], motion::run),
    Step::always("covariance", POSED, covariance::run),
    Step::always("points", &[Stage::Posed, Stage::OneAxis], points::run),
    Step::always("colours", &[Stage::Posed, Stage::OneAxis], colours::run),
];

/// Takes the model through all steps of its stage that are not to be skipped, and notes what each
/// costs.
pub(super) fn run(mut model: Model, context: &StepContext<'_>) -> Result<SfmResult, SfmError> {
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
    let unposed = model.stage == Stage::Unposed;
    let reason = if unposed { why_no_model(&model.features, &model.geometries) } else { String::new() };
    Ok(model.into_result(initial_cameras, reason, decisions))
}
