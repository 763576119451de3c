//! How probable it is that the finished model is right.

use crate::plausibility::FinishedModel;
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{ModelStage, SfmModel, StepResult};
use crate::tracks::build_tracks;

/// Judges the model; changes nothing.
pub(super) fn run(model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let tracks = build_tracks(&model.features, &model.geometries);
    let input = model.input_from(&tracks, &model.geometries, context);
    let finished = FinishedModel {
        state: &model.state,
        input: &input,
        cameras: &model.setup.cameras,
        known: &model.setup.known,
        follows_law: model.motion.is_some() || model.stage == ModelStage::OneAxis,
        progress: context.progress,
    };
    let decision = finished.judge()?;
    Ok((model, vec![decision]))
}
