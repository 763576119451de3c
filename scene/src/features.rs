//! Local features and the verified geometry of image pairs.

use crate::Pose;
use glam::{DMat3, DVec2};
use serde::{Deserialize, Serialize};

/// A local feature; pixel convention as everywhere (first pixel's centre at 0.5, 0.5).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Keypoint {
    /// Column, pixels.
    pub x: f32,
    /// Row, pixels.
    pub y: f32,
    /// Gaussian scale σ at which it was found, pixels of the input image.
    pub scale: f32,
    /// Orientation, radians, from image x towards image y.
    pub angle: f32,
}

impl Keypoint {
    /// Position in pixels.
    pub fn position(&self) -> DVec2 {
        DVec2::new(f64::from(self.x), f64::from(self.y))
    }
}

/// The features of one image.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Features {
    /// N keypoints.
    pub keypoints: Vec<Keypoint>,
    /// N × 128 bytes, row-major: RootSIFT, `round(512 sqrt(h / Σh))` clamped to 255 (COLMAP's
    /// scale).
    pub descriptors: Vec<u8>,
}

impl Features {
    /// Length of a descriptor, bytes. Source: Lowe, IJCV 2004, section 6.1 (4 × 4 × 8).
    pub const DIM: usize = 128;

    /// Number of features.
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }

    /// Descriptor of feature `i`.
    pub fn descriptor(&self, i: usize) -> &[u8] {
        &self.descriptors[i * Self::DIM..(i + 1) * Self::DIM]
    }
}

/// Which model explains the matches of a pair (the numbers are COLMAP's `ConfigurationType`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TwoViewKind {
    /// Too few inliers of any model.
    Degenerate = 1,
    /// Essential matrix: cameras with focal lengths that are trusted.
    Calibrated = 2,
    /// Fundamental matrix only.
    Uncalibrated = 3,
    /// Homography of a plane, with a baseline.
    Planar = 4,
    /// Homography without a baseline: pure rotation.
    Panoramic = 5,
    /// The matches do not move between the images (watermark, seam of a screen).
    Watermark = 7,
}

/// A verified pair: the inlier matches and what relates the two images.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TwoViewGeometry {
    /// Index of the first image in the frame set (`a < b`).
    pub a: usize,
    /// Index of the second image.
    pub b: usize,
    /// Which model explains them.
    pub kind: TwoViewKind,
    /// Inlier matches: (feature of a, feature of b).
    pub inliers: Vec<[u32; 2]>,
    /// Fundamental matrix `x_bᵀ F x_a = 0`, pixels.
    pub f: Option<DMat3>,
    /// Essential matrix `u_bᵀ E u_a = 0`, normalised coordinates.
    pub e: Option<DMat3>,
    /// Homography `x_b ~ H x_a`, pixels.
    pub h: Option<DMat3>,
    /// Relative pose with unit (or zero: panoramic) translation.
    pub b_from_a: Option<Pose>,
    /// Median triangulation angle of the inliers, radians.
    pub median_angle: f64,
}
