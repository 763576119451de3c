//! The camera model by evidence, and which photos were rotated by 180° on their way here. From this
//! step on the solver sees every image the way up that its sensor was.

use super::rotation::rotate_inputs;
use crate::incremental::finish::{decide, take_decided};
use crate::incremental::growth::starts_of;
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};

/// Decides, and takes over the part of the model that was adjusted for it.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    model.starts = starts_of(&model.setup.cameras, &model.setup.known, &model.state);
    let named = context.config.camera_model.model();
    let (known, starts) = (&model.setup.known, &model.starts);
    let verdict = decide(&model.state, &model.input(context), known, starts, named, context.progress)?;
    model.intrinsics = verdict.intrinsics;
    model.camera_decisions = verdict.decisions;
    if let Some(rotated) = verdict.rotated {
        // Poses of which some are rotated by 180° are on no circle.
        model.on_ring = false;
        model.rotated = rotated;
        rotate_inputs(&mut model);
    }
    let mut state = std::mem::take(&mut model.state);
    if model.on_ring {
        state.cameras.clone_from(&verdict.adjusted.problem.cameras);
    } else {
        take_decided(&mut state, &model.input(context), &verdict.adjusted);
    }
    model.state = state;
    Ok((model, Vec::new()))
}
