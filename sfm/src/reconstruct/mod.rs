//! From frames to a model: what is asked for, and the steps that lead there.

mod along_poses;
mod block;
mod context;
mod contradiction;
mod export;
mod given;
mod model;
mod posed;
mod setup;
mod steps;
#[cfg(test)]
mod tests;

pub use block::{MatchedBlock, PairBlock, match_block};
pub use contradiction::{GivenCheck, check_given};
pub use posed::triangulate_given;

use crate::config::SfmConfig;
use crate::error::SfmError;
use crate::matching::PairMatches;
use crate::result::SfmResult;
use context::{FeatureOrigin, StepContext};
use model::SfmModel;
use scene::{Features, FrameSet, Progress};

/// What is known before the images are looked at.
#[derive(Clone, Debug, Default)]
pub struct Supplied {
    /// One per frame, each with a descriptor (zeros where there is none: it matches nothing) a
    /// keypoint.
    pub features: Option<Vec<Features>>,
    /// Matches before verification; without them the features are matched.
    pub matches: Option<Vec<PairMatches>>,
}

/// Camera poses, intrinsics and a sparse cloud from images alone, by the steps of `steps`.
///
/// "No model" is a value: `reconstruction` is `None` and `reason` says why. Same seed, same result,
/// for any number of threads.
pub fn reconstruct(
    frames: &FrameSet,
    config: &SfmConfig,
    progress: &Progress,
) -> Result<SfmResult, SfmError> {
    reconstruct_from(None, frames, config, progress)
}

/// [`reconstruct`] from features (and matches) that were found before, by whatever tool.
pub fn reconstruct_from(
    supplied: Option<Supplied>,
    frames: &FrameSet,
    config: &SfmConfig,
    progress: &Progress,
) -> Result<SfmResult, SfmError> {
    let supplied = supplied.unwrap_or_default();
    let source = if supplied.features.is_some() { FeatureOrigin::Supplied } else { FeatureOrigin::Images };
    solve(supplied, &StepContext { frames, config, source, progress })
}

/// [`reconstruct`] of features that are known already, one set a frame: no image is read, points
/// stay grey.
pub fn reconstruct_features(
    frames: &FrameSet,
    features: Vec<Features>,
    config: &SfmConfig,
    progress: &Progress,
) -> Result<SfmResult, SfmError> {
    let supplied = Supplied { features: Some(features), matches: None };
    solve(supplied, &StepContext { frames, config, source: FeatureOrigin::WithoutImages, progress })
}

fn solve(supplied: Supplied, context: &StepContext<'_>) -> Result<SfmResult, SfmError> {
    let StepContext { frames, config, progress, .. } = *context;
    let mut model = SfmModel::new(frames, config)?;
    config.motion.validate()?;
    progress.check()?;
    if frames.len() < 2 {
        return Err(SfmError::TooFewImages { found: frames.len(), needed: 2 });
    }
    if let Some(features) = supplied.features {
        if features.len() != frames.len() {
            return Err(SfmError::FeaturesMismatch { features: features.len(), frames: frames.len() });
        }
        model.features = features;
    }
    model.matches = supplied.matches;
    steps::run(model, context)
}
