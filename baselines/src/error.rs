//! What can go wrong, and what to do about it.

use scene::Cancelled;
use std::path::PathBuf;

/// Errors of training and showing fields.
#[derive(Debug, thiserror::Error)]
pub enum FieldError {
    /// Ctrl-C; a checkpoint was written where a folder for it was given.
    #[error("cancelled")]
    Cancelled(#[from] Cancelled),
    /// A value of the configuration makes no sense.
    #[error("{flag} is {value}: {expected}")]
    Config {
        /// The flag.
        flag: &'static str,
        /// What was given.
        value: String,
        /// What is allowed.
        expected: &'static str,
    },
    /// Training cannot go on.
    #[error("training stopped at iteration {iteration}: {reason}")]
    Diverged {
        /// Where.
        iteration: u32,
        /// Why.
        reason: &'static str,
    },
    /// A camera with distortion.
    #[error("camera {camera} is {model}; rendering needs PINHOLE: undistort the images first")]
    NotPinhole {
        /// Camera number.
        camera: u32,
        /// COLMAP's name of the model.
        model: &'static str,
    },
    /// The Gaussians of a field cannot be trained.
    #[error(transparent)]
    Splat(#[from] splat::SplatError),
    /// A file cannot be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file cannot be used.
    #[error("cannot use {path}: {reason}; delete it to start afresh")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
}
