//! Points moved alone to where the robust cost of their observations is least, poses and cameras as
//! they are.
//!
//! Far from its observations' middle a redescending loss bends the other way than the parabola that
//! reweighted least squares take for it, so that a single point creeps there for tens of steps,
//! which a joint adjustment would take for all. Alone it costs next to nothing, and Newton's step
//! with the loss's own curvature (Triggs et al. 1999, section 4.3) is there in two or three.

use super::{BundleProblem, RobustLoss};
use crate::solvers::levenberg::cauchy;
use crate::triangulation::{PointView, linearise};
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// A cost that falls by less, in variances of an observation, is at its least.
/// Source: derived: the point is then within √0.001 = 3 % of its standard deviation of that place.
const ENOUGH: f64 = 1e-3;

impl BundleProblem {
    /// For each point where its cost under Cauchy's loss (scale in standard deviations) is least
    /// nearby; where it is now under other losses, where it is held, and where nothing better is
    /// found.
    pub(crate) fn settle_points(&self, loss: RobustLoss) -> Vec<DVec3> {
        let RobustLoss::Cauchy(width) = loss else { return self.points.clone() };
        let mut of_point: Vec<Vec<(PointView<'_>, f64)>> = vec![Vec::new(); self.points.len()];
        for o in self.observations.iter().filter(|o| o.sigma_px > 0.0) {
            let (pose, camera) =
                (self.poses[o.pose as usize], &self.cameras[self.pose_camera[o.pose as usize] as usize]);
            let view = PointView { pose, camera, pixel: o.pixel, centre: DVec3::ZERO, ray: DVec3::ZERO };
            of_point[o.point as usize].push((view, 1.0 / (o.sigma_px * o.sigma_px)));
        }
        let points = self.points.par_iter().zip(&self.point_constant).zip(of_point);
        points.map(|((x, held), views)| if *held { *x } else { settle_point(*x, &views, width) }).collect()
    }
}

/// Newton's steps from `x`, each halved until it lowers the cost, as long as that is worth it.
fn settle_point(mut x: DVec3, views: &[(PointView<'_>, f64)], width: f64) -> DVec3 {
    let mut best = robust_cost(x, views, width);
    if !best.is_finite() {
        return x; // behind a camera
    }
    while let Some((mut step, mut promise)) = newton(x, views, width) {
        let mut after = robust_cost(x + step, views, width);
        while !(after < best) {
            (step, promise) = (step / 2.0, promise / 2.0);
            if !(promise > ENOUGH) {
                return x;
            }
            after = robust_cost(x + step, views, width);
        }
        let gain = best - after;
        (x, best) = (x + step, after);
        if gain < ENOUGH {
            break;
        }
    }
    x
}

fn robust_cost(x: DVec3, views: &[(PointView<'_>, f64)], width: f64) -> f64 {
    views.iter().map(|(v, weight)| cauchy(v.error_sq(x) * weight, width).0).sum()
}

/// The step to the least of the second-order expansion, or of the reweighted squares where that has
/// none, and how far the cost falls to first order.
fn newton(x: DVec3, views: &[(PointView<'_>, f64)], width: f64) -> Option<(DVec3, f64)> {
    let (mut slope, mut squares, mut bent) = (DVec3::ZERO, DMat3::ZERO, DMat3::ZERO);
    for (view, weight) in views {
        let Some((residual, rows)) = linearise(view, x) else { continue };
        let along = rows[0] * residual[0] + rows[1] * residual[1];
        let share = cauchy((residual[0].powi(2) + residual[1].powi(2)) * weight, width).1;
        slope += along * (share * weight);
        for row in rows {
            squares += outer(row) * (share * weight);
        }
        // ρ'' = −ρ'² / s²
        bent -= outer(along) * (2.0 * (share * weight / width).powi(2));
    }
    let whole = squares + bent;
    let convex = whole.x_axis.x > 0.0
        && whole.x_axis.x * whole.y_axis.y > whole.x_axis.y.powi(2)
        && whole.determinant() > 0.0;
    let hessians = [convex.then_some(whole), Some(squares)];
    let mut steps = hessians.into_iter().flatten().map(|m| -(m.inverse() * slope));
    let step = steps.find(|step| step.is_finite() && step.dot(slope) < 0.0)?;
    // The slope is that of half the cost.
    Some((step, -2.0 * step.dot(slope)))
}

fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}
