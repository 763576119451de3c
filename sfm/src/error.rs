//! What can go wrong, and what the user can do about it.

use scene::Cancelled;
use std::path::PathBuf;

/// An error of structure from motion. "No model found" is not one: it is a value of the result.
#[derive(Debug, thiserror::Error)]
pub enum SfmError {
    /// The user asked to stop.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// An image or mask could not be read.
    #[error("cannot read {path}: {reason}; remove it from the input or export it again as PNG or JPEG")]
    UnreadableImage {
        /// The file.
        path: PathBuf,
        /// What the decoder said.
        reason: String,
    },
    /// An image or mask has another size than its frame says.
    #[error(
        "{path} is {found_width}×{found_height}, expected {width}×{height}; masks and images must agree in size"
    )]
    SizeMismatch {
        /// The file.
        path: PathBuf,
        /// Width found.
        found_width: u32,
        /// Height found.
        found_height: u32,
        /// Width expected.
        width: u32,
        /// Height expected.
        height: u32,
    },
    /// Too few images to begin with.
    #[error("{found} image(s) given, at least {needed} are needed; film from more sides")]
    TooFewImages {
        /// How many there are.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// Features were handed in for another number of frames.
    #[error("{features} sets of features for {frames} frames; there must be one a frame")]
    FeaturesMismatch {
        /// Sets of features.
        features: usize,
        /// Frames.
        frames: usize,
    },
    /// `--intrinsics` fits no camera model.
    #[error(
        "--intrinsics has {given} numbers, which do not fit {model}; give f,cx,cy or fx,fy,cx,cy, or name the model with --camera-model"
    )]
    BadIntrinsics {
        /// How many numbers were given.
        given: usize,
        /// The model they were meant for.
        model: String,
    },
    /// Standard deviations that cannot be those of the intrinsics.
    #[error(
        "--intrinsics-sigma has {given} numbers; give {wanted}, one for each of --intrinsics, none negative"
    )]
    BadSigmas {
        /// How many numbers were given.
        given: usize,
        /// How many intrinsics there are.
        wanted: usize,
    },
    /// A calibration of images of another shape.
    #[error(
        "the camera of --camera-from took images of {of_width}x{of_height} pixels, these have {width}x{height}: film both in the same format"
    )]
    OtherShape {
        /// Size of these images.
        width: u32,
        /// Size of these images.
        height: u32,
        /// Size of the images of the calibration.
        of_width: u32,
        /// Size of the images of the calibration.
        of_height: u32,
    },
    /// A flag's number cannot be meant.
    #[error("{flag} {value} is not a positive number")]
    BadNumber {
        /// The flag.
        flag: &'static str,
        /// What was given.
        value: f64,
    },
    /// A known length or tags do not tell the scale.
    #[error("{0}")]
    NoScale(String),
    /// A file could not be written.
    #[error("cannot write {path}: {reason}; check that the disk has room and the folder can be written")]
    CannotWrite {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: String,
    },
    /// The native solver reported a failure that is not "no convergence".
    #[error("bundle adjustment failed: {0}; please report this with run.json")]
    Solver(String),
}
