//! Colours of the points, where images may be read.

use crate::reconstruct::context::{FeatureOrigin, StepContext};
use crate::reconstruct::export::colour;
use crate::reconstruct::model::{SfmModel, StepResult};

/// Colours them.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    if let Some(reconstruction) = &mut model.reconstruction
        && context.source != FeatureOrigin::WithoutImages
    {
        colour(reconstruction, context.frames, context.progress)?;
    }
    Ok((model, Vec::new()))
}
