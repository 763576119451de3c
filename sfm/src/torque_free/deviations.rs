//! How well the poses of a torque-free body are known.

use super::likely::{DETERMINED, LikelyMotion};
use crate::result::PoseDeviation;
use crate::solvers::cholesky::cholesky;
use scene::Pose;

/// Half the width of the differences by which derivatives are taken, in standard deviations.
/// Source: derived: small against the curvature of the motion, large against rounding.
const DIFFERENCE: f64 = 0.1;

/// Steps whose squares sum up to the covariance of a motion: the columns of its Cholesky factor.
pub(super) fn steps(likely: &LikelyMotion) -> Vec<[f64; DETERMINED]> {
    let flat = likely.covariance.iter().flatten().copied().collect();
    let Some(lower) = cholesky(flat, DETERMINED) else { return Vec::new() };
    let column = |k: usize| -> [f64; DETERMINED] {
        std::array::from_fn(|i| if i < k { 0.0 } else { lower[i * DETERMINED + k] })
    };
    (0..DETERMINED).map(column).collect()
}

/// Standard deviations of the poses at some times, seconds, against the attitude at the epoch and
/// the centre of mass. `factor`: on all of them.
pub(super) fn of_poses(likely: &LikelyMotion, times: &[f64], factor: f64) -> Vec<PoseDeviation> {
    let mut squares = vec![[0.0; 6]; times.len()];
    for step in steps(likely) {
        let moved = |sign: f64| likely.motion.stepped(&step.map(|v| sign * DIFFERENCE * v)).poses(times);
        for ((sum, high), low) in squares.iter_mut().zip(moved(1.0)).zip(moved(-1.0)) {
            for (s, d) in sum.iter_mut().zip(difference(&high, &low)) {
                *s += (d / (2.0 * DIFFERENCE)).powi(2);
            }
        }
    }
    let deviation = |s: [f64; 6]| {
        let [a, b, c, x, y, z] = s.map(|v| factor * v.sqrt());
        PoseDeviation { rotation: [a, b, c], centre: [x, y, z] }
    };
    squares.into_iter().map(deviation).collect()
}

/// From one pose to another: rotation vector, camera frame; centre, world frame.
fn difference(to: &Pose, from: &Pose) -> [f64; 6] {
    let turn = to.rotation * from.rotation.conjugate();
    let [a, b, c] = (if turn.w < 0.0 { -turn } else { turn }).to_scaled_axis().to_array();
    let [x, y, z] = (to.centre() - from.centre()).to_array();
    [a, b, c, x, y, z]
}
