//! How probable it is that the finished model is right.

use crate::plausibility::FinishedModel;
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};
use crate::tracks::build_tracks;

/// Judges the model; changes nothing.
pub(super) fn run(model: SfmModel, context: &StepContext<'_>) -> StepResult {
    // Those of the verified pairs: what an adjustment has left out speaks, too.
    let tracks = build_tracks(&model.features, &model.geometries);
    let input = model.input_from(&tracks, &model.geometries, context);
    let finished = FinishedModel {
        state: &model.state,
        input: &input,
        tracks: &tracks,
        cameras: &model.setup.cameras,
        known: &model.setup.known,
        uncertainty: model.uncertainty.as_ref(),
        progress: context.progress,
    };
    let decision = finished.judge()?;
    Ok((model, vec![decision]))
}
