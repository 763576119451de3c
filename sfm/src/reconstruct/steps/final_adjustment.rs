//! All poses, points and intrinsics with the camera model that was decided on.

use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};

/// Adjusts until little changes.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let state = std::mem::take(&mut model.state);
    model.state = model.settle(state, &model.input(context), model.intrinsics, context)?;
    Ok((model, Vec::new()))
}
