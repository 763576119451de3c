//! What the observations say of all poses together.

use super::{BundleProblem, SceneNormalisation, SolveOptions};
use crate::ceres;
use crate::error::SfmError;
use glam::DQuat;
use scene::Pose;

/// The quadratic `½ dᵀ H d + gᵀ d` that the cost of an adjustment is in small changes d of its
/// poses, points and intrinsics eliminated. A change of the world's frame or scale costs nothing.
#[derive(Clone, Debug)]
pub(crate) struct PoseInformation {
    /// Poses where it holds, normalised scene.
    poses: Vec<Pose>,
    frame: SceneNormalisation,
    /// [6P × 6P] over rotation vector (camera frame) and translation (normalised scene) of each
    /// pose.
    hessian: Vec<f64>,
    /// [6P].
    slope: Vec<f64>,
}

impl BundleProblem {
    /// The quadratic at the present state, for observations with the given standard deviations;
    /// `None` where intrinsics are not determined.
    pub(crate) fn pose_information(
        &self,
        options: &SolveOptions,
    ) -> Result<Option<PoseInformation>, SfmError> {
        let frame = SceneNormalisation::of(self);
        let mut input = self.input(options, &frame);
        input.pose_held.fill(0);
        if input.weights.is_empty() {
            return Ok(None);
        }
        let found = ceres::pose_information(&input, &self.state(&frame))?;
        let poses = self.poses.iter().map(|p| frame.pose_in(p)).collect();
        Ok(found.map(|(hessian, slope)| PoseInformation { poses, frame, hessian, slope }))
    }
}

impl PoseInformation {
    /// Independent rotations and translations, each known to a standard deviation: radians, scene
    /// units.
    #[cfg(test)]
    pub(crate) fn independent(poses: &[Pose], sigma: [f64; 2]) -> Self {
        let size = 6 * poses.len();
        let mut hessian = vec![0.0; size * size];
        for i in 0..size {
            hessian[i * size + i] = sigma[i % 6 / 3].powi(-2);
        }
        let frame = SceneNormalisation { centre: glam::DVec3::ZERO, scale: 1.0 };
        Self { poses: poses.to_vec(), frame, hessian, slope: vec![0.0; size] }
    }

    /// From the poses where it holds to others.
    pub(crate) fn change_to(&self, poses: &[Pose]) -> Vec<f64> {
        let mut change = Vec::with_capacity(self.slope.len());
        for (from, to) in self.poses.iter().zip(poses) {
            let to = self.frame.pose_in(to);
            let turn: DQuat = to.rotation * from.rotation.conjugate();
            change.extend((if turn.w < 0.0 { -turn } else { turn }).to_scaled_axis().to_array());
            change.extend((to.translation - from.translation).to_array());
        }
        change
    }

    /// `H d`.
    pub(crate) fn times(&self, change: &[f64]) -> Vec<f64> {
        let rows = self.hessian.chunks_exact(self.slope.len());
        rows.map(|row| row.iter().zip(change).map(|(h, d)| h * d).sum()).collect()
    }

    /// `½ dᵀ H d + gᵀ d`.
    pub(crate) fn cost(&self, change: &[f64]) -> f64 {
        let product = self.times(change);
        change.iter().zip(&product).zip(&self.slope).map(|((d, h), g)| d * (0.5 * h + g)).sum()
    }

    /// `H d + g`.
    pub(crate) fn slope_at(&self, change: &[f64]) -> Vec<f64> {
        self.times(change).iter().zip(&self.slope).map(|(h, g)| h + g).collect()
    }
}
