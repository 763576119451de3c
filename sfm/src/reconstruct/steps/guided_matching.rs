//! More matches along the epipolar lines of verified pairs, where they tie an image that few
//! matches tie.

use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};
use crate::two_view;

/// Matches along lines.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let config = context.config;
    let weak = &model.weakly_tied;
    model.geometries = two_view::match_along_lines(
        &model.features,
        &model.setup.of_frames(),
        std::mem::take(&mut model.geometries),
        (&config.matching, &config.two_view),
        |g| weak[g.a] || weak[g.b],
        config.seed,
        context.progress,
    )?;
    Ok((model, Vec::new()))
}
