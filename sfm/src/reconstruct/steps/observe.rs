//! What is observed in the images: features, matches, and which pairs agree with one rigid motion.

use super::ties::{find_weakly_tied, strong_tie};
use crate::reconstruct::context::{FeatureOrigin, StepContext};
use crate::reconstruct::model::{SfmModel, StepResult};
use crate::{pairs, sift, two_view};

/// Detects and describes features of all images, where none were supplied.
pub(super) fn extract_features(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    if context.source == FeatureOrigin::Images {
        model.features = sift::extract_all(context.frames, &context.config.sift, context.progress)?;
    }
    Ok((model, Vec::new()))
}

/// Matches the pairs of images that may show the same, where no matches were supplied.
pub(super) fn match_features(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let StepContext { frames, config, progress, .. } = *context;
    let matches = match model.matches.take() {
        Some(matches) => matches,
        None => pairs::match_related(frames, &model.features, &config.pairs, &config.matching, progress)?,
    };
    model.stats.pairs_matched = matches.len();
    model.matches = Some(matches);
    Ok((model, Vec::new()))
}

/// Which pairs agree with one rigid motion, and which images they tie firmly.
pub(super) fn verify(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
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

/// More matches along the epipolar lines of verified pairs, where they tie an image that few
/// matches tie.
pub(super) fn match_along_lines(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
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
