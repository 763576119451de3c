//! A camera, and what is rendered through it: the leaf types that data sets, backends and training
//! share.

use crate::parts::PartPlaces;
use glam::{Mat3, Vec3};
use scene::FloatImage;
use serde::{Deserialize, Serialize};

/// Points nearer to a camera than this say nothing, normalised units. Source: chosen by hand, never
/// measured.
pub(crate) const NEAREST: f64 = 0.05;

/// A pinhole camera and its pose in the frame of the Gaussians, f32.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PinholeView {
    /// Rotation `cam_from_world`.
    pub rotation: Mat3,
    /// Translation of `cam_from_world`.
    pub translation: Vec3,
    /// Focal lengths, pixels.
    pub focal: [f32; 2],
    /// Principal point, pixels (pixel centres at + 0.5).
    pub centre: [f32; 2],
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Where parts stand that move against the body.
    pub(crate) parts: PartPlaces,
}

impl PinholeView {
    /// Camera centre, frame of the Gaussians.
    pub fn position(&self) -> Vec3 {
        -(self.rotation.transpose() * self.translation)
    }

    /// The camera as a part sees it that is at rest: of the body the view itself.
    pub(crate) fn of_part(&self, part: u8) -> Self {
        let place = self.parts.of(part);
        let translation = self.rotation * place.translation + self.translation;
        Self { rotation: self.rotation * place.rotation, translation, parts: PartPlaces::NONE, ..*self }
    }

    /// `x` in the frame of the camera: `R x + t`.
    pub(crate) fn camera_point(&self, x: Vec3) -> Vec3 {
        self.rotation * x + self.translation
    }

    /// The pixel of a point in the frame of the camera; `z` must not be zero.
    pub(crate) fn pixel(&self, c: Vec3) -> [f32; 2] {
        [0, 1].map(|k| self.focal[k] * c[k] / c.z + self.centre[k])
    }

    /// Whether a pixel lies in the picture.
    pub(crate) fn contains(&self, [px, py]: [f32; 2]) -> bool {
        px >= 0.0 && py >= 0.0 && px < self.width as f32 && py < self.height as f32
    }

    /// Whether a point in the frame of the camera lies before it and in its picture. Without a
    /// division.
    pub(crate) fn sees(&self, c: Vec3) -> bool {
        let [px, py] = [0, 1].map(|k| self.focal[k] * c[k] + self.centre[k] * c.z);
        let inside = px >= 0.0 && py >= 0.0 && px < self.width as f32 * c.z && py < self.height as f32 * c.z;
        c.z > 0.0 && inside
    }

    /// The view at a resolution of `1 / 2^level`, sizes rounded down (at least 1), scaled about the
    /// image corner.
    pub fn at_level(&self, level: u32) -> Self {
        let (width, height) = (level_size(self.width, level), level_size(self.height, level));
        let (sx, sy) = (width as f32 / self.width as f32, height as f32 / self.height as f32);
        Self {
            focal: [self.focal[0] * sx, self.focal[1] * sy],
            centre: [self.centre[0] * sx, self.centre[1] * sy],
            width,
            height,
            ..*self
        }
    }
}

/// Length of a side at `1 / 2^level` of the resolution, at least 1 pixel.
pub(crate) fn level_size(full: usize, level: u32) -> usize {
    (full >> level).max(1)
}

/// How to render.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RenderOptions {
    /// Colour behind everything, sRGB values in [0, 1].
    pub background: [f32; 3],
    /// Gaussians nearer than this are not drawn, scene units (default: a hundredth of the
    /// Gaussians' spread).
    pub near: Option<f32>,
    /// Scale opacity with the 2D low-pass (Mip-Splatting); as in training.
    pub antialias: bool,
    /// Use spherical harmonics up to this degree only.
    pub sh_degree: Option<u32>,
}

/// A rendered view.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RenderOutput {
    /// Three channels, over the background; not limited to 1.
    pub rgb: FloatImage,
    /// One channel, coverage in [0, 1].
    pub alpha: FloatImage,
    /// One channel, expected depth (camera z, scene units), 0 where nothing was drawn.
    pub depth: FloatImage,
}
