//! Essential matrices for the RANSAC loop.

use super::Estimator;
use super::fundamental::is_oriented;
use crate::solvers::{
    Pairs, essential_5pt, essential_from_pose, pose_from_essential, refine_relative, sampson_sq,
};
use glam::{DMat3, DVec2, DVec3};

/// An essential matrix and the same for pixels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EssentialModel {
    /// `bᵀ E a = 0` for rays.
    pub e: DMat3,
    /// `bᵀ F a = 0` for ideal pixels from the principal point.
    pub f: DMat3,
}

/// Finds the essential matrix of two cameras with known focal lengths. The threshold is in pixels,
/// the residual Sampson's.
pub(crate) struct EssentialEstimator {
    /// Ideal pixels from the principal point, image a.
    a: Vec<DVec2>,
    b: Vec<DVec2>,
    focal: [f64; 2],
    /// Width of the robust loss in refinement, pixels.
    loss_scale: f64,
}

impl EssentialEstimator {
    /// For ideal (undistorted) pixels from the principal point and focal lengths in pixels.
    pub(crate) fn new(a: Vec<DVec2>, b: Vec<DVec2>, focal: [f64; 2], loss_scale: f64) -> Self {
        Self { a, b, focal, loss_scale }
    }

    /// The model of an essential matrix.
    pub(crate) fn model(&self, e: DMat3) -> EssentialModel {
        let inverse = self.focal.map(|f| DMat3::from_diagonal(DVec3::new(1.0 / f, 1.0 / f, 1.0)));
        EssentialModel { e, f: inverse[1] * e * inverse[0] }
    }

    /// Ray of datum `i` in each camera frame, `z = 1`.
    pub(crate) fn rays(&self, i: usize) -> (DVec3, DVec3) {
        ((self.a[i] / self.focal[0]).extend(1.0), (self.b[i] / self.focal[1]).extend(1.0))
    }
}

impl Estimator for EssentialEstimator {
    type Model = EssentialModel;

    fn sample_size(&self) -> usize {
        5
    }

    fn num_data(&self) -> usize {
        self.a.len().min(self.b.len())
    }

    fn solve(&self, sample: &[usize], models: &mut Vec<EssentialModel>) {
        let Ok(sample) = <[usize; 5]>::try_from(sample) else { return };
        let (rays_a, rays_b) = (sample.map(|i| self.rays(i).0), sample.map(|i| self.rays(i).1));
        let (a, b) = (sample.map(|i| self.a[i]), sample.map(|i| self.b[i]));
        let found = essential_5pt(&rays_a, &rays_b).into_iter().map(|e| self.model(e));
        models.extend(found.filter(|m| is_oriented(&m.f, &a, &b)));
    }

    #[inline]
    fn residual_sq(&self, model: &EssentialModel, i: usize) -> f64 {
        sampson_sq(&model.f, self.a[i], self.b[i])
    }

    fn refine(&self, model: &EssentialModel, inliers: &[usize]) -> Option<EssentialModel> {
        if inliers.len() < 6 {
            return None;
        }
        let rays: Vec<(DVec3, DVec3)> = inliers.iter().map(|&i| self.rays(i)).collect();
        let (pose, _) = pose_from_essential(&model.e, &rays)?;
        let pairs = Pairs { a: &self.a, b: &self.b, indices: inliers };
        let refined = refine_relative(&pose, self.focal, pairs, self.loss_scale, 6);
        Some(self.model(essential_from_pose(&refined)))
    }
}
