//! How well the poses of a torque-free body are known.

use super::likely::{DETERMINED, LikelyMotion};
use crate::result::{PoseDeviation, outer_square};
use crate::solvers::cholesky::cholesky;
use glam::{DMat3, DVec3};
use scene::Pose;

/// Half the width of the differences by which derivatives are taken, in standard deviations.
/// Source: derived: small against the curvature of the motion, large against rounding.
pub(super) const DIFFERENCE: f64 = 0.1;

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
    let mut squares = vec![(DVec3::ZERO, DMat3::ZERO); times.len()];
    for step in steps(likely) {
        let moved = |sign: f64| likely.motion.stepped(&step.map(|v| sign * DIFFERENCE * v)).poses(times);
        for ((sum, high), low) in squares.iter_mut().zip(moved(1.0)).zip(moved(-1.0)) {
            let [turned, moved] = difference(&high, &low).map(|d| d / (2.0 * DIFFERENCE));
            sum.0 += turned * turned;
            sum.1 += outer_square(moved);
        }
    }
    let deviations = squares.into_iter().map(|(rotation, centre)| PoseDeviation {
        rotation: rotation.to_array().map(|v| factor * v.sqrt()),
        centre: centre * (factor * factor),
    });
    deviations.collect()
}

/// From one pose to another: rotation vector, camera frame; centre, world frame.
fn difference(to: &Pose, from: &Pose) -> [DVec3; 2] {
    let turn = to.rotation * from.rotation.conjugate();
    let turned = (if turn.w < 0.0 { -turn } else { turn }).to_scaled_axis();
    [turned, to.centre() - from.centre()]
}
