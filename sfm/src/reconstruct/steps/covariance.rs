//! Standard deviations of poses and intrinsics.

use crate::incremental::finish::uncertainty;
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};

/// Computes them at the last adjustment.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let (known, starts) = (&model.setup.known, &model.starts);
    model.uncertainty = uncertainty(&model.state, &model.input(context), known, starts, model.intrinsics)?;
    Ok((model, Vec::new()))
}
