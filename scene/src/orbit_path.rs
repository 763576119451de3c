//! Paths of a virtual camera around what the input cameras look at.

use crate::Pose;
use glam::{DMat3, DVec3};
use std::f64::consts::TAU;

/// The circle that the input cameras suggest for a virtual camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrbitPath {
    focus: DVec3,
    up: DVec3,
    start: DVec3,
    radius: f64,
    height: f64,
}

impl OrbitPath {
    /// The focus is the point nearest to all viewing rays (least squares); `up` is unit.
    /// `Err` says why there is no such circle.
    pub fn fit(poses: &[Pose], up: DVec3) -> Result<Self, &'static str> {
        // The diagonal keeps the normal equations regular where all rays are parallel.
        let mut normal = DMat3::from_diagonal(DVec3::splat(1e-9));
        let mut right = DVec3::ZERO;
        for pose in poses {
            let d = pose.view_direction();
            let project = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
            normal += project;
            right += project * pose.centre();
        }
        let focus = normal.inverse() * right;
        let count = poses.len() as f64;
        let height = poses.iter().map(|p| (p.centre() - focus).dot(up)).sum::<f64>() / count;
        let offsets: Vec<DVec3> = poses.iter().map(|p| (p.centre() - focus).reject_from(up)).collect();
        let radius = offsets.iter().map(|o| o.length()).sum::<f64>() / count;
        let start = offsets.first().and_then(|o| o.try_normalize());
        let start = start.unwrap_or_else(|| up.any_orthonormal_vector());
        if !(radius.is_finite() && radius > 0.0) {
            return Err("the cameras do not surround anything");
        }
        Ok(Self { focus, up, start, radius, height })
    }

    /// So many poses once around; each rises and falls twice, by up to `rise` radii.
    pub fn poses(&self, count: usize, rise: f64) -> Vec<Pose> {
        let angles = (0..count).map(|i| i as f64 / count as f64 * TAU);
        angles.map(|angle| self.pose(angle, rise * (2.0 * angle).sin())).collect()
    }

    /// `cam_from_world` after an angle (radians) from the first camera, raised by `rise` radii.
    pub fn pose(&self, angle: f64, rise: f64) -> Pose {
        let side = self.up.cross(self.start);
        let out = self.start * angle.cos() + side * angle.sin();
        let eye = self.focus + out * self.radius + self.up * (self.height + rise * self.radius);
        Pose::look_at(eye, self.focus, self.up)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_orbit_through_a_ring_of_cameras_is_that_ring() {
        let focus = DVec3::new(1.0, 2.0, 3.0);
        let angle = |i: u32| f64::from(i) / 12.0 * TAU;
        let eye = |a: f64| focus + DVec3::new(2.0 * a.cos(), 2.0 * a.sin(), 0.5);
        let poses: Vec<Pose> = (0..12).map(|i| Pose::look_at(eye(angle(i)), focus, DVec3::Z)).collect();
        let path = OrbitPath::fit(&poses, DVec3::Z).unwrap();
        for (i, pose) in (0..).zip(&poses) {
            assert!((path.pose(angle(i), 0.0).centre() - pose.centre()).length() < 1e-6);
        }
        let raised = path.poses(8, 0.5)[1].centre() - path.poses(8, 0.0)[1].centre();
        assert!((raised.length() - 1.0).abs() < 1e-6, "half a radius of 2: {raised}");
    }

    #[test]
    fn cameras_at_one_place_have_no_orbit() {
        let pose = Pose::look_at(DVec3::ZERO, DVec3::X, DVec3::Z);
        assert!(OrbitPath::fit(&[pose; 3], DVec3::Z).is_err());
    }
}
