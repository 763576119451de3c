//! One Gaussian between a file and the cloud: what the readers and writers of all formats share.

use crate::Gaussians;
use crate::io::error::IoError;
use crate::sim3::Sim3;
use glam::{DQuat, Quat, Vec3};
use std::path::Path;

/// Opacity logits of 8-bit alpha stay within ±8 (0.0003 to 0.9997).
/// Source: derived, beyond the steps of 8-bit alpha.
const LOGIT_LIMIT: f32 = 8.0;

/// What is known of one Gaussian while a file is read.
pub(super) struct Item<'a> {
    pub(super) mean: Vec3,
    pub(super) log_scale: Vec3,
    pub(super) rotation: Quat,
    /// In [0, 1].
    pub(super) opacity: f32,
    /// `K × 3`.
    pub(super) sh: &'a [f32],
}

/// Adds a Gaussian, or says which one is not finite.
pub(super) fn push(path: &Path, g: &mut Gaussians, item: &Item) -> Result<(), IoError> {
    let finite = item.mean.is_finite()
        && !item.log_scale.is_nan()
        && item.rotation.is_finite()
        && item.opacity.is_finite()
        && item.sh.iter().all(|v| v.is_finite());
    if !finite {
        return Err(IoError::not_finite(path, format!("a number of gaussian {}", g.len())));
    }
    g.means.push(item.mean);
    g.log_scales.push(item.log_scale.clamp(Vec3::splat(-40.0), Vec3::splat(40.0)));
    g.rotations.push(item.rotation);
    g.opacity_logits.push((item.opacity / (1.0 - item.opacity)).ln().clamp(-LOGIT_LIMIT, LOGIT_LIMIT));
    g.sh.extend_from_slice(item.sh);
    Ok(())
}

/// A value in [0, 1] as a byte.
pub(super) fn unit_byte(v: f32) -> u8 {
    (v.clamp(0.0, 1.0) * 255.0).round() as u8
}

/// Unit quaternion; identity for zero length.
pub(super) fn unit(q: Quat) -> Quat {
    if q.length_squared() > 0.0 && q.is_finite() { q.normalize() } else { Quat::IDENTITY }
}

/// A rotation by 180° about x: y and z change sign. Its own inverse.
pub(super) fn turn_upright(g: &mut Gaussians) {
    g.transform(&Sim3 { rotation: DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0), ..Sim3::IDENTITY });
}
