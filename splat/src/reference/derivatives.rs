//! What only the derivatives and the tests need of the specification's types.

use super::parameters::{Parameters, ReferenceView};
use glam::{DMat3, DQuat, DVec3};

impl Parameters {
    /// All zero, in the shape of `other`.
    pub(crate) fn zeros_like(other: &Self) -> Self {
        Self {
            means: vec![DVec3::ZERO; other.len()],
            log_scales: vec![DVec3::ZERO; other.len()],
            rotations: vec![DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0); other.len()],
            opacity_logits: vec![0.0; other.len()],
            sh: vec![0.0; other.sh.len()],
            sh_degree: other.sh_degree,
        }
    }

    /// Length of one Gaussian's part of `sh`: 3 (degree + 1)².
    pub(crate) fn sh_stride(&self) -> usize {
        3 * (self.sh_degree as usize + 1).pow(2)
    }

    /// Spherical-harmonic coefficients of Gaussian `i`, [K × 3].
    pub(crate) fn sh_of(&self, i: usize) -> &[f64] {
        let k = self.sh_stride();
        &self.sh[i * k..(i + 1) * k]
    }
}

impl ReferenceView {
    /// Where the camera stands in the world: −Rᵀ t.
    pub(crate) fn position(&self) -> DVec3 {
        -(self.rotation.transpose() * self.translation)
    }

    /// The view with a small motion in the camera frame after its pose: x_cam ← exp(\[ω\]×) x_cam +
    /// v.
    pub(crate) fn moved(&self, omega: DVec3, v: DVec3) -> Self {
        let rotation = DMat3::from_quat(DQuat::from_scaled_axis(omega));
        Self { rotation: rotation * self.rotation, translation: rotation * self.translation + v, ..*self }
    }
}

/// Derivative of L with respect to a small motion of the camera, see [`ReferenceView::moved`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct PoseGradient {
    /// With respect to ω, camera frame, a radian.
    pub(crate) omega: DVec3,
    /// With respect to v, camera frame, a scene unit.
    pub(crate) translation: DVec3,
}

impl std::ops::AddAssign for PoseGradient {
    fn add_assign(&mut self, other: Self) {
        self.omega += other.omega;
        self.translation += other.translation;
    }
}
