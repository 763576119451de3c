//! Matches of the pairs of images that may show the same, where none were supplied.

use crate::pairs;
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};

/// Chooses pairs and matches them.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let StepContext { frames, config, progress, .. } = *context;
    let matches = match model.matches.take() {
        Some(matches) => matches,
        None => pairs::match_related(frames, &model.features, &config.pairs, &config.matching, progress)?,
    };
    model.stats.pairs_matched = matches.len();
    model.matches = Some(matches);
    Ok((model, Vec::new()))
}
