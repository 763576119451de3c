//! A motion about one axis, read off free poses.

use crate::circular::limits::LEAST_SIGMA;
use crate::circular::motion::{CircularMotion, wrap_angle};
use crate::solvers::linalg::{moments, symmetric_eigen};
use crate::statistics::median;
use glam::{DQuat, DVec3};
use scene::Pose;

/// Pairs of frames that are compared at most when an axis is fitted.
/// Source: chosen by hand, never measured.
const MOST_PAIRS: usize = 20_000;
/// Rounds of reweighting.
/// Source: chosen by hand, never measured.
const ROUNDS: usize = 10;

/// How far poses are from a [`CircularMotion`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct CircularMisfit {
    /// Median angle between the axes of relative rotations and the common one, weighted by the sine
    /// of their half angle: the tilt that is left in a pose, radians.
    pub tilt: f64,
    /// Median distance of relative translations from those of the turn, in radii.
    pub slip: f64,
}

impl CircularMotion {
    /// The turn that explains free poses best, and how far they are from it. `None` where they do
    /// not turn (fewer than two poses, no rotation, or no distance from the axis).
    ///
    /// Axis: the direction that the vector parts of relative rotations share, `max Σ w (a·v_ij)²`,
    /// reweighted for its outliers (iteratively reweighted least squares, Holland & Welsch 1977).
    /// Place: `t_ij = (I − R_ij) t`.
    pub(crate) fn of_poses(poses: &[Option<Pose>]) -> Option<(Self, CircularMisfit)> {
        let known: Vec<(usize, Pose)> =
            poses.iter().enumerate().filter_map(|(i, p)| Some((i, (*p)?))).collect();
        let relative = relative_poses(&known);
        let vectors: Vec<DVec3> = relative.iter().map(|p| vector_part(p.rotation)).collect();
        let (direction, tilt) = common_axis(&vectors)?;
        let start = known.first()?.1.rotation.conjugate();
        let mut angles = vec![None; poses.len()];
        for (i, pose) in &known {
            angles[*i] = Some(twist(pose.rotation * start, direction));
        }
        let (place, slip) = common_place(&relative, direction)?;
        let turn = Self::new(direction, place, angles)?;
        let slip = slip / turn.radius();
        Some((turn, CircularMisfit { tilt, slip }))
    }
}

/// Angle of the part of a rotation that is about a unit axis, radians in (−π, π].
pub(crate) fn twist(rotation: DQuat, axis: DVec3) -> f64 {
    let along = 2.0 * rotation.xyz().dot(axis).atan2(rotation.w);
    wrap_angle(along)
}

/// `sin(angle / 2) · axis`, of the rotation by less than half a turn.
fn vector_part(q: DQuat) -> DVec3 {
    if q.w < 0.0 { -q.xyz() } else { q.xyz() }
}

/// Poses of later frames from earlier ones, a spread of all pairs.
fn relative_poses(known: &[(usize, Pose)]) -> Vec<Pose> {
    let n = known.len();
    let step = (n * n.saturating_sub(1) / 2).div_ceil(MOST_PAIRS).max(1);
    let pairs = (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b)));
    pairs.step_by(step).map(|(a, b)| known[b].1.compose(&known[a].1.inverse())).collect()
}

/// The line that most of the vectors are along, and the median distance from it.
pub(crate) fn common_axis(vectors: &[DVec3]) -> Option<(DVec3, f64)> {
    let mut weights = vec![1.0; vectors.len()];
    let mut axis = None;
    let mut tilt = 0.0;
    for _ in 0..ROUNDS {
        let (values, rows) = symmetric_eigen(&moments(weights.iter().copied().zip(vectors.iter().copied())));
        if !(values[2] > LEAST_SIGMA * LEAST_SIGMA) {
            return None;
        }
        let found = DVec3::from_array(rows[2]);
        let off: Vec<f64> = vectors.iter().map(|v| (*v - found * found.dot(*v)).length()).collect();
        tilt = median(off.clone());
        weights = cauchy_weights(&off, (2.0 * tilt).max(1e-12));
        axis = Some(found);
    }
    axis.map(|a| (a, tilt))
}

/// The point across the axis for which `t_ij = (I − R_ij) t` holds best, and the median violation.
fn common_place(relative: &[Pose], axis: DVec3) -> Option<(DVec3, f64)> {
    let (u, v) = axis.any_orthonormal_pair();
    let mut weights = vec![1.0; relative.len()];
    let mut found = None;
    for _ in 0..ROUNDS {
        let (mut a, mut b) = ([[0.0; 2]; 2], [0.0; 2]);
        for (pose, w) in relative.iter().zip(&weights) {
            let columns = [u, v].map(|e| e - pose.rotation * e);
            for i in 0..2 {
                b[i] += w * columns[i].dot(pose.translation);
                (0..2).for_each(|k| a[i][k] += w * columns[i].dot(columns[k]));
            }
        }
        let determinant = a[0][0] * a[1][1] - a[0][1] * a[1][0];
        if !(determinant > 1e-12 * (a[0][0] + a[1][1]).powi(2)) {
            return None;
        }
        let x = (a[1][1] * b[0] - a[0][1] * b[1]) / determinant;
        let y = (a[0][0] * b[1] - a[1][0] * b[0]) / determinant;
        let place = u * x + v * y;
        let off = relative.iter().map(|p| (p.translation - (place - p.rotation * place)).length());
        let off: Vec<f64> = off.collect();
        let slip = median(off.clone());
        weights = cauchy_weights(&off, (2.0 * slip).max(1e-12 * place.length()));
        found = Some((place, slip));
    }
    found.filter(|(place, _)| place.is_finite() && place.length() > 0.0)
}

/// Weights of reweighted least squares with Cauchy's loss.
fn cauchy_weights(distances: &[f64], scale: f64) -> Vec<f64> {
    distances.iter().map(|d| 1.0 / (1.0 + (d / scale).powi(2))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example(unit: f64) -> CircularMotion {
        let direction = DVec3::new(0.05, -0.9, -0.3);
        let place = DVec3::new(0.1, 0.2, 4.0) * unit;
        let angles = (0..12).map(|i| (i != 5).then_some(0.5 * f64::from(i))).collect();
        CircularMotion::new(direction, place, angles).unwrap()
    }

    #[test]
    fn a_turn_is_read_off_its_own_poses_in_any_world_and_unit() {
        for unit in [1e-6, 1.0, 1e6] {
            let turn = example(unit);
            let world = Pose::new(DQuat::from_xyzw(0.3, -0.2, 0.5, 0.4), DVec3::new(3.0, -8.0, 1.0) * unit);
            let poses: Vec<Option<Pose>> = (0..12).map(|i| turn.pose(i).map(|p| p.compose(&world))).collect();
            let (found, misfit) = CircularMotion::of_poses(&poses).unwrap();
            let sign = found.direction().dot(turn.direction()).signum();
            assert!((found.direction() * sign - turn.direction()).length() < 1e-9, "unit {unit}");
            assert!((found.axis.translation - turn.axis.translation).length() < 1e-8 * unit);
            for (a, b) in found.angles.iter().zip(&turn.angles) {
                assert_eq!(a.is_some(), b.is_some());
                let off = a.zip(*b).map_or(0.0, |(a, b)| wrap_angle(a * sign - b));
                assert!(off.abs() < 1e-9, "unit {unit}: {off}");
            }
            assert!(misfit.tilt < 1e-9 && misfit.slip < 1e-9, "{misfit:?}");
        }
    }

    #[test]
    fn a_wrong_pose_does_not_move_the_axis() {
        let turn = example(1.0);
        let mut poses: Vec<Option<Pose>> = (0..12).map(|i| turn.pose(i)).collect();
        poses[3] = poses[3].map(|p| Pose::new(DQuat::from_rotation_x(0.3) * p.rotation, p.translation * 1.2));
        let (found, _) = CircularMotion::of_poses(&poses).unwrap();
        assert!(found.direction().cross(turn.direction()).length() < 2e-3);
        assert!((found.axis.translation - turn.axis.translation).length() < 2e-2);
    }

    #[test]
    fn poses_that_do_not_turn_are_no_turn() {
        assert!(CircularMotion::of_poses(&[]).is_none());
        assert!(CircularMotion::of_poses(&[Some(Pose::IDENTITY)]).is_none());
        assert!(CircularMotion::of_poses(&[Some(Pose::IDENTITY); 5]).is_none());
        let shifted = |i: i32| Some(Pose::from_centre(DQuat::IDENTITY, DVec3::X * f64::from(i)));
        assert!(CircularMotion::of_poses(&[shifted(0), shifted(1), shifted(2)]).is_none());
        // A camera that turns about itself has no distance from the axis.
        let spin = |i: i32| Some(Pose::new(DQuat::from_rotation_y(0.2 * f64::from(i)), DVec3::ZERO));
        assert!(CircularMotion::of_poses(&[spin(0), spin(1), spin(2)]).is_none());
    }
}
