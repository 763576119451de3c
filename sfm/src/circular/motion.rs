//! A motion about one axis.

use glam::{DMat3, DQuat, DVec3};
use scene::Pose;

/// Frame `i` sees the turntable's point X at `R Z(θ_i) X + t`, where Z turns about the turntable's
/// z axis.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CircularMotion {
    /// Camera from turntable at angle 0.
    pub axis: Pose,
    /// By frame, radians; `None` where it is not known.
    pub angles: Vec<Option<f64>>,
}

impl CircularMotion {
    /// From the axis' direction in the camera frame and a place on it, angles counted from the
    /// first frame that has one.
    ///
    /// The turntable's origin is the axis' point nearest to the camera, and the camera stands at
    /// azimuth 0 at angle 0. `None` where the camera is on the axis.
    pub(crate) fn new(direction: DVec3, place: DVec3, angles: Vec<Option<f64>>) -> Option<Self> {
        let z = direction.try_normalize()?;
        let foot = place - z * z.dot(place);
        let x = -foot.try_normalize()?;
        let rotation = DMat3::from_cols(x, z.cross(x), z);
        let first = angles.iter().flatten().next().copied().unwrap_or(0.0);
        let angles = angles.into_iter().map(|a| a.map(|a| a - first)).collect();
        Some(Self { axis: Pose::from_matrix(rotation, foot), angles })
            .filter(|t| t.axis.is_finite() && t.angles.iter().flatten().all(|a| a.is_finite()))
    }

    /// The axis' direction, camera frame.
    pub(crate) fn direction(&self) -> DVec3 {
        self.axis.rotation * DVec3::Z
    }

    /// Distance of the camera from the axis.
    pub(crate) fn radius(&self) -> f64 {
        distance_from_axis(&self.axis)
    }

    /// 1 where the axis points upwards in the image (towards the camera where it is seen end on),
    /// else -1.
    pub(crate) fn upward(&self) -> f64 {
        let z = self.direction();
        let down = if z.y.abs() > 0.1 * z.z.abs() { z.y > 0.0 } else { z.z > 0.0 };
        if down { -1.0 } else { 1.0 }
    }

    /// `cam_from_world` of a frame.
    pub(crate) fn pose(&self, frame: usize) -> Option<Pose> {
        self.angles.get(frame).copied().flatten().map(|a| pose_at(&self.axis, a))
    }

    /// The same motion with the axis upwards ([`CircularMotion::upward`]), the origin at `height`
    /// along the present axis, the first frame's camera at azimuth 0, and the camera `radius` from
    /// the axis. The second value takes points along: new from old.
    pub(crate) fn canonical(&self, height: f64, radius: f64) -> (Self, impl Fn(DVec3) -> DVec3 + use<>) {
        let (z, sign) = (self.direction(), self.upward());
        let scale = radius / self.radius();
        let first = self.angles.iter().flatten().next().copied().unwrap_or(0.0);
        let up = z * sign;
        let t = self.axis.translation;
        let x = -(t - z * z.dot(t)).normalize();
        let rotation = DMat3::from_cols(x, up.cross(x), up);
        let angles = self.angles.iter().map(|a| a.map(|a| (a - first) * sign)).collect();
        let axis = Pose::from_matrix(rotation, (t + z * height) * scale);
        // x_cam = R Z(θ) X + t: at the first frame old and new agree.
        let (old, new) = (pose_at(&self.axis, first), axis);
        (Self { axis, angles }, move |p| {
            new.rotation.conjugate() * (old.transform(p) * scale - new.translation)
        })
    }
}

/// Distance of the camera from an axis.
pub(crate) fn distance_from_axis(axis: &Pose) -> f64 {
    let (z, t) = (axis.rotation * DVec3::Z, axis.translation);
    (t - z * z.dot(t)).length()
}

/// The pose at an angle.
pub(crate) fn pose_at(axis: &Pose, angle: f64) -> Pose {
    let rotation = (axis.rotation * DQuat::from_rotation_z(angle)).normalize();
    Pose { rotation, translation: axis.translation }
}

/// The same angle in (−π, π].
pub(crate) fn wrap_angle(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    let r = angle.rem_euclid(TAU);
    if r > PI { r - TAU } else { r }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_canonical_frame_has_the_axis_up_and_the_first_camera_at_azimuth_zero() {
        for flipped in [1.0, -1.0] {
            let angles = (0..6).map(|i| Some(0.3 * f64::from(i))).collect();
            let turn =
                CircularMotion::new(DVec3::new(0.1, -0.9, -0.4) * flipped, DVec3::new(0.3, 0.1, 5.0), angles);
            let turn = turn.unwrap();
            let (canonical, moved) = turn.canonical(0.7, 2.0);
            assert!(canonical.direction().y < 0.0 && (canonical.radius() - 2.0).abs() < 1e-12);
            let centre = canonical.pose(0).unwrap().centre();
            assert!(centre.y.abs() < 1e-12 && centre.x > 0.0);
            let p = DVec3::new(0.2, -0.1, 0.4);
            for i in 0..6 {
                let (old, new) =
                    (turn.pose(i).unwrap().transform(p), canonical.pose(i).unwrap().transform(moved(p)));
                assert!((old.truncate() / old.z - new.truncate() / new.z).length() < 1e-12, "frame {i}");
            }
        }
    }
}
