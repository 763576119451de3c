//! Circular motion: the turn of a video, images that a ring of cameras misses, and whether the
//! images show a turn about one axis or an orbit.

use crate::circular::{FreeModel, Motion, MotionInput, VideoJob, consider, ring, solve_video};
use crate::error::SfmError;
use crate::incremental::growth::starts_of;
use crate::incremental::state::{MapState, MappingInput};
use crate::reconstruct::context::{FeatureOrigin, StepContext};
use crate::reconstruct::model::{ModelStage, SfmModel, StepResult};
use crate::skip::StepName;
use crate::torque_free;
use crate::tracks::build_tracks;
use scene::Decision;

/// The model of a video in which something turns about one axis before a camera that stands still:
/// from followed points, without any of the other steps. Not where features were supplied.
pub(super) fn solve_video_turn(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let StepContext { frames, config, source, progress } = *context;
    let wanted = matches!(config.motion.motion, Motion::Auto | Motion::SingleAxis);
    if !frames.is_video || !wanted || source != FeatureOrigin::Images || model.matches.is_some() {
        return Ok((model, Vec::new()));
    }
    let (cameras, camera_of, known) = (&model.setup.cameras, &model.setup.camera_of, &model.setup.known);
    let found = solve_video(&VideoJob { frames, config, cameras, camera_of, known, progress })?;
    let (video, motion) = match found {
        Ok(found) => found,
        Err(why) => {
            model.no_video_motion = Some(why);
            return Ok((model, Vec::new()));
        }
    };
    model.stats.pairs_matched = video.matched;
    model.stats.pairs_verified = video.geometries.len();
    model.stats.features = video.keypoints.iter().map(Vec::len).sum();
    model.features = video.features;
    model.geometries = video.geometries;
    model.keypoints = video.keypoints;
    let mut decisions = vec![motion];
    decisions.extend(model.adopt_turn(video.solution));
    Ok((model, decisions))
}

/// Images that a ring of cameras misses, put in their places on it, where one camera took them all.
pub(super) fn complete_ring(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let completed = complete_circle(&model, &model.state, &model.input(context), context)?;
    let Some((state, decision)) = completed else { return Ok((model, Vec::new())) };
    model.state = state;
    Ok((model, vec![decision]))
}

/// The poses and points of `state` with the images that its ring misses; `None` where it is no ring
/// or misses none.
pub(super) fn complete_circle(
    model: &SfmModel,
    state: &MapState,
    input: &MappingInput<'_>,
    context: &StepContext<'_>,
) -> Result<Option<(MapState, Decision)>, SfmError> {
    let asked = context.config.motion.motion != Motion::Free && !context.skips(StepName::CircleCompletion);
    if !asked || model.setup.cameras.len() != 1 {
        return Ok(None);
    }
    let starts = starts_of(&model.setup.cameras, &model.setup.known, state);
    let motion = MotionInput { starts: &starts, ..model.motion_input(input, context) };
    ring::complete(state, &motion.context(&[]), model.intrinsics)
}

/// Holds free poses of a video near the motion of a torque-free body, where that is what they show.
fn hold_to_tumble(
    model: &mut SfmModel,
    context: &StepContext<'_>,
    times: &[f64],
    decisions: &mut Vec<Decision>,
) -> Result<(), SfmError> {
    let input = model.input(context);
    let job = model.motion_input(&input, context);
    let free = FreeModel { state: &model.state, intrinsics: model.intrinsics };
    let film = context.frames.film.as_ref().map_or(&[][..], |film| &film.times_s);
    let (held, decision) = torque_free::consider(&job, &free, times, film)?;
    if let Some(decision) = decision {
        match decisions.pop() {
            Some(before) => decisions.push(decision.absorbing(before)),
            None => decisions.push(decision),
        }
    }
    if let Some(held) = held {
        (model.state, model.expected, model.motion) = (held.state, Some(held.expected), Some(held.report));
        (model.intrinsics, model.deviations) = (held.intrinsics, Some(held.deviations));
        model.frames = held.frames;
        decisions.extend(held.decisions);
    }
    Ok(())
}

/// Whether the images show a turn about one axis or an orbit; of images without poses too, for a
/// turn needs but three.
pub(super) fn choose_motion(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let posed = model.stage == ModelStage::Posed;
    if !posed {
        model.tracks = build_tracks(&model.features, &model.geometries);
    }
    let input = model.input(context);
    let free = posed.then_some(FreeModel { state: &model.state, intrinsics: model.intrinsics });
    // Images that were rotated on their way get cameras of their own in the end: no turn before one
    // camera.
    let unrotated = !model.rotated.contains(&true);
    let outcome = consider(&model.motion_input(&input, context), free.as_ref(), unrotated)?;
    let decision = outcome.decision.filter(|_| posed || outcome.taken.is_some());
    let mut decisions: Vec<_> = decision.into_iter().collect();
    if let Some(turn) = outcome.taken {
        decisions.extend(model.adopt_turn(turn));
        decisions.extend(model.no_video_motion.take());
        return Ok((model, decisions));
    }
    if let Some(circled) = outcome.circled {
        model.state = circled;
    } else if let Some(times) = context.frames.times().filter(|_| posed) {
        hold_to_tumble(&mut model, context, &times, &mut decisions)?;
    }
    decisions.append(&mut model.camera_decisions);
    decisions.extend(model.no_video_motion.take());
    Ok((model, decisions))
}
