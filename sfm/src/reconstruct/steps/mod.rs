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
//! 6. `motion`: whether poses are on a circle, or about one axis; `covariance`; `plausibility`, how
//!    probable it is that the model is right.
//! 7. What is handed back: `points`, `all-frames`, `colours`.
//!
//! Most of them can be left out by `--skip NAME` ([`StepName`]); what a step does is said in its
//! file.

mod aliasing;
mod all_frames;
mod blurred_features;
mod camera_model;
mod constant_step;
mod densify;
mod finish;
mod mapper;
mod mapping;
mod motion;
mod observe;
mod plane_tracks;
mod plausibility;
mod second_attempt;
mod shared_cameras;
mod subpixel;
#[cfg(test)]
mod tests;
mod ties;

use super::context::StepContext;
use super::export::why_no_model;
use super::model::{ModelStage, SfmModel, StepResult};
use crate::error::SfmError;
use crate::result::{SfmResult, StepTime};
use crate::skip::StepName;
use std::time::Instant;

/// A step of the sequence.
struct ReconstructionStep {
    name: &'static str,
    /// Stages of the model in which it is taken.
    stages: &'static [ModelStage],
    /// Its name where it can be left out.
    skip: Option<StepName>,
    run: fn(SfmModel, &StepContext<'_>) -> StepResult,
}

/// A step that is always taken.
const fn always(
    name: &'static str,
    stages: &'static [ModelStage],
    run: fn(SfmModel, &StepContext<'_>) -> StepResult,
) -> ReconstructionStep {
    ReconstructionStep { name, stages, skip: None, run }
}

/// A step that can be left out.
const fn unless(
    skip: StepName,
    name: &'static str,
    stages: &'static [ModelStage],
    run: fn(SfmModel, &StepContext<'_>) -> StepResult,
) -> ReconstructionStep {
    ReconstructionStep { name, stages, skip: Some(skip), run }
}

const UNPOSED: &[ModelStage] = &[ModelStage::Unposed];
const POSED: &[ModelStage] = &[ModelStage::Posed];
const FREE: &[ModelStage] = &[ModelStage::Unposed, ModelStage::Posed];
const SOLVED: &[ModelStage] = &[ModelStage::Posed, ModelStage::OneAxis];

/// All steps in their order.
const STEPS: [ReconstructionStep; 24] = [
    always("video-turn", UNPOSED, motion::solve_video_turn),
    always("features", UNPOSED, observe::extract_features),
    always("matching", UNPOSED, observe::match_features),
    always("verification", UNPOSED, observe::verify),
    unless(StepName::BlurredFeatures, "blurred-features", UNPOSED, blurred_features::run),
    unless(StepName::ConstantStep, "constant-step", UNPOSED, constant_step::run),
    unless(StepName::GuidedMatching, "guided-matching", UNPOSED, observe::match_along_lines),
    always("mapping", UNPOSED, mapping::run),
    unless(StepName::Aliasing, "aliasing", POSED, aliasing::run),
    unless(StepName::SecondAttempt, "second-attempt", POSED, second_attempt::run),
    unless(StepName::CircleCompletion, "circle-completion", POSED, motion::complete_ring),
    unless(StepName::SharedCameras, "shared-cameras", POSED, shared_cameras::run),
    always("camera-model", POSED, camera_model::choose_camera_model),
    always("final-adjustment", POSED, finish::adjust),
    unless(StepName::Densify, "densify", POSED, densify::run),
    unless(StepName::Subpixel, "subpixel", POSED, subpixel::run),
    unless(StepName::PlaneTracks, "plane-tracks", POSED, plane_tracks::run),
    unless(StepName::IsolatedPoints, "isolated-points", POSED, finish::remove_isolated_points),
    always("motion", FREE, motion::choose_motion),
    always("covariance", POSED, finish::compute_covariance),
    always("plausibility", SOLVED, plausibility::run),
    always("points", SOLVED, finish::convert_model),
    always("all-frames", SOLVED, all_frames::run),
    always("colours", SOLVED, finish::colour_points),
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
        if model.stage != ModelStage::Unposed && context.progress.wants_preview() {
            context.progress.preview(model.state.preview(&model.setup.camera_of));
        }
        clock.lap(step.name, &mut model.stats.steps);
    }
    let unposed = model.stage == ModelStage::Unposed;
    let reason = if unposed { why_no_model(&model.features, &model.geometries) } else { String::new() };
    Ok(model.into_result(initial_cameras, reason, decisions))
}

/// Measures laps of wall-clock and processor time.
struct Clock {
    wall: Instant,
    cpu: f64,
}

impl Clock {
    fn start() -> Self {
        Self { wall: Instant::now(), cpu: scene::clock::cpu_seconds() }
    }

    /// Notes what has passed since the last lap.
    fn lap(&mut self, step: &str, steps: &mut Vec<StepTime>) {
        let (wall, cpu) = (Instant::now(), scene::clock::cpu_seconds());
        let wall_s = (wall - self.wall).as_secs_f64();
        steps.push(StepTime { step: step.to_owned(), wall_s, cpu_s: cpu - self.cpu });
        (self.wall, self.cpu) = (wall, cpu);
    }
}
