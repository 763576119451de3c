//! Fundamental matrices for the RANSAC loop.

use super::Estimator;
use crate::solvers::{Pairs, fundamental_7pt, fundamental_8pt, refine_fundamental, sampson_sq};
use glam::{DMat3, DVec2};

/// Finds `F` with `bᵀ F a = 0`. Points and threshold have the same unit and should be of the order
/// of 1 (divide pixels of both images by one number); the residual is Sampson's.
pub(crate) struct FundamentalEstimator {
    /// Points of image a.
    pub a: Vec<DVec2>,
    /// Points of image b.
    pub b: Vec<DVec2>,
    /// Width of the robust loss in refinement.
    pub loss_scale: f64,
}

impl Estimator for FundamentalEstimator {
    type Model = DMat3;

    fn sample_size(&self) -> usize {
        7
    }

    fn num_data(&self) -> usize {
        self.a.len().min(self.b.len())
    }

    fn solve(&self, sample: &[usize], models: &mut Vec<DMat3>) {
        let Ok(sample) = <[usize; 7]>::try_from(sample) else { return };
        let (a, b) = (sample.map(|i| self.a[i]), sample.map(|i| self.b[i]));
        models.extend(fundamental_7pt(&a, &b).into_iter().filter(|f| is_oriented(f, &a, &b)));
    }

    #[inline]
    fn residual_sq(&self, f: &DMat3, i: usize) -> f64 {
        sampson_sq(f, self.a[i], self.b[i])
    }

    fn refine(&self, f: &DMat3, inliers: &[usize]) -> Option<DMat3> {
        if inliers.len() < 8 {
            return None;
        }
        let pairs = Pairs { a: &self.a, b: &self.b, indices: inliers };
        let a: Vec<DVec2> = inliers.iter().map(|&i| self.a[i]).collect();
        let b: Vec<DVec2> = inliers.iter().map(|&i| self.b[i]).collect();
        let linear = fundamental_8pt(&a, &b);
        let start = linear.filter(|l| total_error(l, &a, &b) < total_error(f, &a, &b)).unwrap_or(*f);
        refine_fundamental(&start, pairs, self.loss_scale, 6)
    }
}

fn total_error(f: &DMat3, a: &[DVec2], b: &[DVec2]) -> f64 {
    a.iter().zip(b).map(|(a, b)| sampson_sq(f, *a, *b)).sum()
}

/// Whether all pairs lie on matching sides of the epipoles, as points in front of both cameras do:
/// the oriented epipolar constraint `e_b × b ~⁺ F a`. Chum, Werner & Matas, ICPR 2004.
pub(super) fn is_oriented(f: &DMat3, a: &[DVec2], b: &[DVec2]) -> bool {
    // Columns of F span the plane normal to the epipole of b.
    let crosses = [f.x_axis.cross(f.y_axis), f.y_axis.cross(f.z_axis), f.z_axis.cross(f.x_axis)];
    let [p, q, r] = crosses;
    let mut epipole = if p.length_squared() > q.length_squared() { p } else { q };
    if r.length_squared() > epipole.length_squared() {
        epipole = r;
    }
    let mut positive = None;
    for (a, b) in a.iter().zip(b) {
        let side = epipole.cross(b.extend(1.0)).dot(*f * a.extend(1.0)) > 0.0;
        if *positive.get_or_insert(side) != side {
            return false;
        }
    }
    true
}
