//! Whether the images show a turn about one axis or an orbit; of images without poses too, for a
//! turn needs but three.

use crate::circular::{FreeModel, consider};
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{ModelStage, SfmModel, StepResult};
use crate::tracks::build_tracks;

/// Decides on the motion.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
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
    }
    decisions.append(&mut model.camera_decisions);
    decisions.extend(model.no_video_motion.take());
    Ok((model, decisions))
}
