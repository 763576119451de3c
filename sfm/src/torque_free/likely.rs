//! The torque-free motion under which the observations are most likely.

use super::dynamics::RESPONSE;
use super::fit::{DIFFERENCE, SHAPE_SIGMA};
use super::motion::TorqueFreeMotion;
use crate::bundle::PoseInformation;
use crate::solvers::linalg::solve_spd;
use glam::DVec3;

/// What of a motion the observations can tell: direction of the momentum (2), logarithm of the
/// response (6), place across the line of sight (2), velocity (3). The rest is the choice of the
/// world's frame and scale.
/// Source: derived.
pub(super) const DETERMINED: usize = 13;
/// Of which so many, the first, say how the body turns.
/// Source: derived.
const OF_TURN: usize = 8;
/// Most steps.
/// Source: derived: Newton's steps double the digits.
const STEPS: usize = 12;

/// A motion, and the covariance of what the observations tell of it.
#[derive(Clone, Debug)]
pub(super) struct LikelyMotion {
    pub motion: TorqueFreeMotion,
    /// In the order of [`DETERMINED`], for observations with the given standard deviations.
    pub covariance: [[f64; DETERMINED]; DETERMINED],
}

impl TorqueFreeMotion {
    /// The same after a step of what is determined.
    pub(super) fn stepped(&self, step: &[f64; DETERMINED]) -> Self {
        let mut of_body = [0.0; RESPONSE.end];
        of_body[RESPONSE.end - OF_TURN..].copy_from_slice(&step[..OF_TURN]);
        let mut moved = self.clone();
        moved.turn.body = self.turn.body.stepped(&of_body);
        let distance = self.distance();
        let sight = self.mass.place / distance;
        let first = sight.any_orthonormal_vector();
        let aside = first * step[OF_TURN] + sight.cross(first) * step[OF_TURN + 1];
        moved.mass.place += aside * distance;
        moved.mass.velocity += DVec3::from_slice(&step[OF_TURN + 2..]) * distance;
        moved
    }

    /// The most likely motion near this one; `None` where the observations do not determine it.
    /// `times`: of the poses that the information is of, seconds.
    pub(super) fn most_likely(self, information: &PoseInformation, times: &[f64]) -> Option<LikelyMotion> {
        let mut motion = self;
        let mut cost = motion.cost(information, times);
        let mut damping = 1e-6;
        for _ in 0..STEPS {
            let (normal, slope) = motion.normal(information, times);
            let mut damped = normal;
            (0..DETERMINED).for_each(|i| damped[i][i] *= 1.0 + damping);
            let step = solve_spd(&damped, &slope.map(|v| -v))?;
            let next = motion.stepped(&step);
            let found = next.cost(information, times);
            if found < cost {
                let gained = cost - found;
                (motion, cost) = (next, found);
                damping = (0.1 * damping).max(1e-9);
                if gained < 1e-3 {
                    break;
                }
            } else {
                damping *= 100.0;
                if damping > 1e6 {
                    break;
                }
            }
        }
        let (normal, _) = motion.normal(information, times);
        let mut covariance = [[0.0; DETERMINED]; DETERMINED];
        for (k, row) in covariance.iter_mut().enumerate() {
            *row = solve_spd(&normal, &std::array::from_fn(|i| if i == k { 1.0 } else { 0.0 }))?;
        }
        Some(LikelyMotion { motion, covariance })
    }

    fn cost(&self, information: &PoseInformation, times: &[f64]) -> f64 {
        let shape = self.turn.body.shape();
        let prior = shape.iter().map(|v| v * v).sum::<f64>() / (2.0 * SHAPE_SIGMA * SHAPE_SIGMA);
        information.cost(&information.change_to(&self.poses(times))) + prior
    }

    /// Normal equations and slope of the cost.
    fn normal(
        &self,
        information: &PoseInformation,
        times: &[f64],
    ) -> ([[f64; DETERMINED]; DETERMINED], [f64; DETERMINED]) {
        let moved = |k: usize, by: f64| {
            let next = self.stepped(&std::array::from_fn(|i| if i == k { by } else { 0.0 }));
            (information.change_to(&next.poses(times)), next.turn.body.shape())
        };
        let difference = |high: f64, low: f64| (high - low) / (2.0 * DIFFERENCE);
        let (mut columns, mut shapes) = (Vec::new(), Vec::new());
        for k in 0..DETERMINED {
            let ((high, shape), (low, of_low)) = (moved(k, DIFFERENCE), moved(k, -DIFFERENCE));
            columns.push(high.iter().zip(&low).map(|(h, l)| difference(*h, *l)).collect::<Vec<f64>>());
            shapes.push(std::array::from_fn::<f64, 6, _>(|i| difference(shape[i], of_low[i]) / SHAPE_SIGMA));
        }
        let slope = information.slope_at(&information.change_to(&self.poses(times)));
        let now = self.turn.body.shape().map(|v| v / SHAPE_SIGMA);
        let products: Vec<Vec<f64>> = columns.iter().map(|c| information.times(c)).collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let normal = std::array::from_fn(|i| {
            std::array::from_fn(|k| dot(&columns[i], &products[k]) + dot(&shapes[i], &shapes[k]))
        });
        (normal, std::array::from_fn(|i| dot(&columns[i], &slope) + dot(&shapes[i], &now)))
    }
}

#[cfg(test)]
pub(super) mod tests;
