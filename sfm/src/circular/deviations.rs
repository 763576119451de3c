//! How well the poses of a turn are known: by their angles, and by the direction of the axis.

use super::motion::{distance_from_axis, pose_at};
use crate::result::{PoseDeviation, outer_square};
use glam::{DQuat, DVec3};
use scene::Pose;

/// Standard deviations of the axis' direction, radians: sideways and towards the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct AxisDeviation {
    pub sideways: f64,
    pub towards: f64,
}

impl AxisDeviation {
    /// Of both together, radians.
    pub(crate) fn length(self) -> f64 {
        self.sideways.hypot(self.towards)
    }

    /// Standard deviations of the pose at an angle, itself known to `sigma` (radians), against the
    /// pose at angle 0: with the turn Q about the axis, the rotation errs by `(I − Q) δ` where the
    /// axis is tilted by δ.
    pub(crate) fn of_pose(self, axis: &Pose, angle: f64, sigma: f64) -> PoseDeviation {
        let z = axis.rotation * DVec3::Z;
        let out = (axis.translation - z * z.dot(axis.translation)).normalize();
        let turn = DQuat::from_axis_angle(z, angle);
        let tilts = [out * self.sideways, z.cross(out) * self.towards].map(|tilt| tilt - turn * tilt);
        let parts = [z * sigma, tilts[0], tilts[1]];
        let rotation = parts.iter().map(|p| *p * *p).sum::<DVec3>();
        let centre = pose_at(axis, angle).centre();
        let height = distance_from_axis(axis)
            * (self.sideways * angle.sin()).hypot(self.towards * (1.0 - angle.cos()));
        let moved = [DVec3::new(-centre.y, centre.x, 0.0) * sigma, DVec3::Z * height];
        PoseDeviation {
            rotation: rotation.to_array().map(f64::sqrt),
            centre: moved.map(outer_square).into_iter().sum(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tilted_axis_makes_poses_wrong_by_as_much() {
        let axis = Pose::new(DQuat::from_rotation_x(1.8), DVec3::new(0.0, 0.1, 3.0));
        let z = axis.rotation * DVec3::Z;
        let out = (axis.translation - z * z.dot(axis.translation)).normalize();
        let tilt = 1e-4;
        for (about, deviation) in [
            (out, AxisDeviation { sideways: tilt, towards: 0.0 }),
            (z.cross(out), AxisDeviation { sideways: 0.0, towards: tilt }),
        ] {
            let turned = DQuat::from_axis_angle(about, tilt);
            let tilted = Pose { rotation: turned * axis.rotation, ..axis };
            for angle in [0.0, 0.4, 1.5, 3.1, 5.0] {
                let relative =
                    |axis: &Pose| pose_at(axis, angle).rotation * pose_at(axis, 0.0).rotation.conjugate();
                let off = (relative(&tilted) * relative(&axis).conjugate()).to_scaled_axis().abs();
                let said = DVec3::from_array(deviation.of_pose(&axis, angle, 0.0).rotation);
                assert!((off - said).length() < 0.02 * tilt, "{angle}: {off} {said}");
            }
        }
    }
}
