//! Keypoints moved to where their windows fit together (see [`crate::refinement`]), where the model
//! fits them more closely than it fitted those that were detected.

use crate::config::KeypointPlaces;
use crate::incremental::state::MappingInput;
use crate::model_selection::accept::{Change, accept};
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};
use crate::refinement::{fit, refine};
use scene::decision::{Decision, Measurement, Quantity, Rule, Subject};

/// Moves keypoints and adjusts the model to them. There is no decision where no image may be read.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let wanted = context.config.keypoints == KeypointPlaces::Windows;
    let Some(frames) = context.images().filter(|_| wanted) else { return Ok((model, Vec::new())) };
    let input = model.input(context);
    let refined = refine(&model.state, &input, frames, &model.rotated, context.progress)?;
    let moved_input = MappingInput { keypoints: &refined.keypoints, sigmas: &refined.sigmas, ..input };
    let mut sharper = model.state.clone();
    refined.unsure.iter().for_each(|v| sharper.drop_view(*v));
    sharper.refine_points(&moved_input, |_| false);
    let sharper = model.settle(sharper, &moved_input, model.intrinsics, context)?;
    let before = fit(&model.state, &input, &refined.moved);
    let after = fit(&sharper, &moved_input, &refined.moved);
    let taken = accept(Change::MovedKeypoints, &before, &after);
    let observations = model.state.live().map(|(_, p)| p.views.len()).sum::<usize>();
    let decision = Decision::new(Subject::KeypointRefinement, taken, Rule::Evidence).with_all([
        Measurement::count(Quantity::Observations, observations),
        Measurement::count(Quantity::MovedObservations, refined.moved.len()),
        Measurement::new(Quantity::MedianErrorBefore, before.error_px.unwrap_or_default()),
        Measurement::new(Quantity::MedianErrorAfter, after.error_px.unwrap_or_default()),
    ]);
    if taken {
        (model.keypoints, model.sigmas, model.state) = (refined.keypoints, refined.sigmas, sharper);
    }
    Ok((model, vec![decision]))
}
