//! Similarity transforms and the robust alignment of two reconstructions.

mod align;
mod compare;
mod horn;

pub use align::{robust_alignment, umeyama};
pub use compare::{AUC_THRESHOLDS_DEG, ErrorStatistics, ImageError, PoseErrors, compare_poses};
pub(crate) use horn::least_eigenvector;
pub use horn::nearest_rotation;

use crate::{Pose, Reconstruction};
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// `x_target = s R x_source + t` with `s > 0`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sim3 {
    /// Scale s, target units a source unit.
    pub scale: f64,
    /// Rotation `target_from_source`, unit.
    pub rotation: DQuat,
    /// Translation, target frame and units.
    pub translation: DVec3,
}

impl Sim3 {
    /// The transform that changes nothing.
    pub const IDENTITY: Self = Self { scale: 1.0, rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// The point in the target frame.
    pub fn transform(&self, x: DVec3) -> DVec3 {
        self.scale * (self.rotation * x) + self.translation
    }

    /// `source_from_target`.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        let scale = 1.0 / self.scale;
        Self { scale, rotation, translation: -scale * (rotation * self.translation) }
    }

    /// `self ∘ other`: `c_from_a = c_from_b.compose(&b_from_a)`.
    pub fn compose(&self, other: &Self) -> Self {
        Self {
            scale: self.scale * other.scale,
            rotation: (self.rotation * other.rotation).normalize(),
            translation: self.transform(other.translation),
        }
    }

    /// The same camera when the world is moved: `cam_from_target` (in target units) of
    /// `cam_from_source`.
    pub fn transform_pose(&self, cam_from_source: &Pose) -> Pose {
        let rotation = cam_from_source.rotation * self.rotation.conjugate();
        Pose::from_centre(rotation, self.transform(cam_from_source.centre()))
    }

    /// The whole reconstruction moved: poses and points.
    pub fn transform_reconstruction(&self, model: &Reconstruction) -> Reconstruction {
        let mut moved = model.clone();
        moved.images.values_mut().for_each(|image| image.pose = self.transform_pose(&image.pose));
        moved.points.values_mut().for_each(|point| point.position = self.transform(point.position));
        moved
    }
}
