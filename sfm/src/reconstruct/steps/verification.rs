//! Which pairs agree with one rigid motion, and which images they tie firmly.

use super::ties::{find_weakly_tied, strong_tie};
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};
use crate::two_view;

/// Verifies all pairs.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let config = context.config;
    model.geometries = two_view::verify_pairs(
        &model.features,
        &model.setup.of_frames(),
        model.matches.clone().unwrap_or_default(),
        &config.two_view,
        config.seed,
        context.progress,
    )?;
    model.weakly_tied = find_weakly_tied(model.features.len(), &model.geometries, strong_tie(&config.sift));
    Ok((model, Vec::new()))
}
