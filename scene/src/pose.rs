//! Rigid transforms between frames.

use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// A rigid transform `x_target = R x_source + t`; a camera's pose is its `cam_from_world`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Rotation `target_from_source`, unit quaternion.
    pub rotation: DQuat,
    /// Translation, target frame, scene units.
    pub translation: DVec3,
}

impl Pose {
    /// The transform that changes nothing.
    pub const IDENTITY: Self = Self { rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// From a rotation (normalised here) and a translation.
    pub fn new(rotation: DQuat, translation: DVec3) -> Self {
        Self { rotation: rotation.normalize(), translation }
    }

    /// From a rotation matrix (orthonormal, determinant +1) and a translation.
    pub fn from_matrix(r: DMat3, t: DVec3) -> Self {
        Self::new(DQuat::from_mat3(&r), t)
    }

    /// From the camera's centre in the world: `t = -R c`.
    pub fn from_centre(rotation: DQuat, centre: DVec3) -> Self {
        let rotation = rotation.normalize();
        Self { rotation, translation: -(rotation * centre) }
    }

    /// `cam_from_world` of a camera at `eye` that looks at `target`; `up` is the world direction
    /// that appears upwards in the image (image y points down). `up` must not be parallel to the
    /// view direction.
    pub fn look_at(eye: DVec3, target: DVec3, up: DVec3) -> Self {
        let z = (target - eye).normalize();
        let x = z.cross(up).normalize();
        let y = z.cross(x);
        let r = DMat3::from_cols(x, y, z).transpose();
        Self::from_matrix(r, -(r * eye))
    }

    /// The rotation as a matrix.
    pub fn matrix(&self) -> DMat3 {
        DMat3::from_quat(self.rotation)
    }

    /// The point in the target frame.
    #[inline]
    pub fn transform(&self, x: DVec3) -> DVec3 {
        self.rotation * x + self.translation
    }

    /// `source_from_target`.
    #[inline]
    pub fn inverse(&self) -> Self {
        let inverse = self.rotation.conjugate();
        Self { rotation: inverse, translation: -(inverse * self.translation) }
    }

    /// `self ∘ other`: `c_from_a = c_from_b.compose(&b_from_a)`.
    #[inline]
    pub fn compose(&self, other: &Self) -> Self {
        Self {
            rotation: (self.rotation * other.rotation).normalize(),
            translation: self.rotation * other.translation + self.translation,
        }
    }

    /// Where the target frame's origin lies in the source frame: the camera centre `-Rᵀ t`.
    pub fn centre(&self) -> DVec3 {
        -(self.rotation.conjugate() * self.translation)
    }

    /// Direction in which the camera looks, source (world) frame, unit.
    pub fn view_direction(&self) -> DVec3 {
        self.rotation.conjugate() * DVec3::Z
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.rotation.is_finite() && self.translation.is_finite()
    }
}

/// Angle of the rotation that takes `a` to `b`, radians, in [0, π]; accurate for tiny angles.
pub fn rotation_angle(a: DQuat, b: DQuat) -> f64 {
    let d = a.conjugate() * b;
    2.0 * d.xyz().length().atan2(d.w.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn look_at_puts_the_target_on_the_optical_axis_and_up_above() {
        let pose = Pose::look_at(DVec3::new(3.0, -2.0, 1.0), DVec3::ZERO, DVec3::Z);
        let target = pose.transform(DVec3::ZERO);
        assert!(target.truncate().length() < 1e-12 && target.z > 0.0);
        assert!(pose.transform(DVec3::Z).y < target.y, "up in the world is a smaller image y");
        assert!((pose.matrix().determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn composing_with_the_inverse_changes_nothing() {
        let pose = Pose::new(DQuat::from_xyzw(0.1, -0.4, 0.2, 0.8), DVec3::new(1.0, 2.0, -3.0));
        let same = pose.compose(&pose.inverse());
        assert!(rotation_angle(same.rotation, DQuat::IDENTITY) < 1e-12);
        assert!(same.translation.length() < 1e-12);
    }
}
