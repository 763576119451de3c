//! What can go wrong, and what to do about it.

use scene::Cancelled;
use std::path::PathBuf;

/// Errors of training and rendering.
#[derive(Debug, thiserror::Error)]
pub enum SplatError {
    /// Ctrl-C; a checkpoint was written where a folder for it was given.
    #[error("cancelled")]
    Cancelled(#[from] Cancelled),
    /// The depths could not be fused.
    #[error("{0}")]
    Fusion(scene::geometry::FusionError),
    /// An image or mask of the model is missing or cannot be decoded.
    #[error("{0}; the model refers to it, so put it back or leave it out of the model")]
    Image(#[from] scene::io::IoError),
    /// A name in the model leads outside the image folder.
    #[error("the model names an image outside its folder: {0}")]
    ImageName(#[from] scene::io::UnsafeName),
    /// An image and its camera disagree about the size.
    #[error(
        "{name} is {found:?} pixels but its camera says {expected:?}; undistort or scale the images to the model"
    )]
    ImageSize {
        /// The image.
        name: String,
        /// Width and height of the file.
        found: (u32, u32),
        /// Width and height of the camera.
        expected: (u32, u32),
    },
    /// A camera with distortion.
    #[error(
        "camera {camera} of {name} is {model}; training and rendering need PINHOLE: undistort the images first"
    )]
    NotPinhole {
        /// The image, or "the view".
        name: String,
        /// Camera number.
        camera: u32,
        /// COLMAP's name of the model.
        model: &'static str,
    },
    /// Mask folder without a mask for any image.
    #[error("none of the {images} images has a mask in {folder} (a.png, a.jpg.png or a.mask.png for a.jpg)")]
    NoMasks {
        /// How many images were looked up.
        images: usize,
        /// The folder.
        folder: PathBuf,
    },
    /// Nothing to train on.
    #[error("the model has {0} images to train on; at least 1 is needed (see --test-every)")]
    TooFewViews(usize),
    /// No Gaussian could be placed.
    #[error("no Gaussian could be placed: {0}")]
    NoGaussians(String),
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
    /// Arrays of a set of Gaussians disagree.
    #[error("invalid Gaussians: {0}")]
    InvalidGaussians(String),
    /// Training cannot go on.
    #[error("training stopped at iteration {iteration}: {reason}")]
    Diverged {
        /// Where.
        iteration: u32,
        /// Why.
        reason: String,
    },
    /// No graphics adapter of the wanted name, or none at all.
    #[error(
        "no graphics adapter matches {wanted:?} (present: {present}); use --backend cpu, or see 'sat-recon doctor'"
    )]
    NoAdapter {
        /// What was asked for.
        wanted: String,
        /// What there is.
        present: String,
    },
    /// The graphics adapter failed.
    #[error("graphics adapter {adapter}: {reason}; try again, lower --max-gaussians, or use --backend cpu")]
    Gpu {
        /// Its name.
        adapter: String,
        /// What the driver said.
        reason: String,
    },
    /// A checkpoint cannot be written.
    #[error("cannot write the checkpoint {path}: {source}")]
    CheckpointWrite {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A checkpoint cannot be used.
    #[error("cannot use the checkpoint {path}: {reason}; delete it to start afresh")]
    CheckpointRead {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
}

impl From<scene::geometry::FusionError> for SplatError {
    fn from(error: scene::geometry::FusionError) -> Self {
        match error {
            scene::geometry::FusionError::Cancelled(cancelled) => Self::Cancelled(cancelled),
            other => Self::Fusion(other),
        }
    }
}
