//! Features of all images, where none were supplied.

use crate::reconstruct::context::{FeatureOrigin, StepContext};
use crate::reconstruct::model::{SfmModel, StepResult};
use crate::sift;

/// Detects and describes them.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    if context.source == FeatureOrigin::Images {
        model.features = sift::extract_all(context.frames, &context.config.sift, context.progress)?;
    }
    Ok((model, Vec::new()))
}
