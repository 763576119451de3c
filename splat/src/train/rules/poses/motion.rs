//! Small motions ξ = (ω, v) of a camera in its own frame: `x ← exp(ω) x + v`.

use crate::view::PinholeView;
use glam::{DMat3, DQuat, DVec3};

/// Rotation ω (radians) and translation v (normalised units).
pub(super) type Motion = [f64; 6];

/// The view after a motion.
pub(super) fn moved(view: &PinholeView, motion: &Motion) -> PinholeView {
    let turn = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::from_slice(&motion[..3])));
    let translation = turn * view.translation.as_dvec3() + DVec3::from_slice(&motion[3..]);
    let rotation = (turn * view.rotation.as_dmat3()).as_mat3();
    PinholeView { rotation, translation: translation.as_vec3(), ..*view }
}

/// The motion that takes a view to another.
pub(super) fn motion_between(from: &PinholeView, to: &PinholeView) -> Motion {
    let turn = to.rotation.as_dmat3() * from.rotation.as_dmat3().transpose();
    let w = DQuat::from_mat3(&turn).to_scaled_axis();
    let v = to.translation.as_dvec3() - turn * from.translation.as_dvec3();
    [w.x, w.y, w.z, v.x, v.y, v.z]
}
