//! Points that two images see and that stand alone in depth are taken out.

use crate::incremental::depths::drop_lonely;
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};

/// Takes them out.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let mut state = std::mem::take(&mut model.state);
    drop_lonely(&mut state, &model.input(context));
    model.state = state;
    Ok((model, Vec::new()))
}
