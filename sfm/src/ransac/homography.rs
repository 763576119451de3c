//! Homographies for the RANSAC loop.

use super::Estimator;
use crate::solvers::{homography_4pt, homography_dlt, transfer_sq};
use glam::{DMat3, DVec2};

/// A homography and its inverse.
pub(super) type HomographyModel = (DMat3, DMat3);

/// Finds `H` with `b ~ H a`. Points and threshold have the same unit; the residual is the larger of
/// the two transfer errors.
pub(crate) struct HomographyEstimator {
    /// Points of image a.
    pub a: Vec<DVec2>,
    /// Points of image b.
    pub b: Vec<DVec2>,
}

impl Estimator for HomographyEstimator {
    type Model = HomographyModel;

    fn sample_size(&self) -> usize {
        4
    }

    fn num_data(&self) -> usize {
        self.a.len().min(self.b.len())
    }

    fn solve(&self, sample: &[usize], models: &mut Vec<HomographyModel>) {
        let Ok(sample) = <[usize; 4]>::try_from(sample) else { return };
        let h = homography_4pt(&sample.map(|i| self.a[i]), &sample.map(|i| self.b[i]));
        models.extend(h.and_then(with_inverse));
    }

    #[inline]
    fn residual_sq(&self, (h, inverse): &HomographyModel, i: usize) -> f64 {
        let forward = transfer_sq(h, self.a[i], self.b[i]);
        let backward = transfer_sq(inverse, self.b[i], self.a[i]);
        if forward > backward { forward } else { backward }
    }

    fn refine(&self, _: &HomographyModel, inliers: &[usize]) -> Option<HomographyModel> {
        let a: Vec<DVec2> = inliers.iter().map(|&i| self.a[i]).collect();
        let b: Vec<DVec2> = inliers.iter().map(|&i| self.b[i]).collect();
        homography_dlt(&a, &b).and_then(with_inverse)
    }
}

fn with_inverse(h: DMat3) -> Option<HomographyModel> {
    let inverse = h.inverse();
    inverse.is_finite().then_some((h, inverse))
}
