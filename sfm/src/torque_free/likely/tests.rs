use super::*;
use crate::torque_free::fit::Attitude;
use crate::torque_free::fit::tests::{body, seen};
use scene::Pose;

/// Poses of a body whose centre of mass keeps its station, and their times.
pub(crate) fn poses(n: usize, noise: f64) -> (Vec<Pose>, Vec<f64>) {
    let attitudes = seen(&body(), n, noise);
    let pose = |a: &Attitude| {
        let centre = DVec3::new(0.1, -0.2, 0.1);
        Pose::new(a.rotation, DVec3::new(0.1, 0.0, 4.0) - a.rotation * centre)
    };
    (attitudes.iter().map(pose).collect(), attitudes.iter().map(|a| a.time).collect())
}

#[test]
fn errors_are_as_large_as_the_deviations_say() {
    let truth = body();
    let mut squares = Vec::new();
    for n in 90..120 {
        let (poses, times) = poses(n, 0.004);
        let rough = TorqueFreeMotion::of_poses(&poses, &times).unwrap();
        let information = PoseInformation::independent(&poses, [0.004, 0.01]);
        let likely = rough.most_likely(&information, &times).unwrap();
        // Turned into the frame of the truth, in which attitudes are compared.
        let found = likely.motion.turn.body.principal_axes().0;
        let expected = truth.principal_axes().0;
        let momentum = likely.motion.turn.body.momentum;
        let off = momentum.angle_between(truth.momentum).powi(2);
        squares.push(off / (likely.covariance[0][0] + likely.covariance[1][1]));
        assert!((0..3).all(|k| (found[k] - expected[k]).abs() < 0.1), "{found:?} {expected:?}");
    }
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    assert!((0.5..1.7).contains(&mean), "{mean}");
}

#[test]
fn what_nothing_tells_is_not_determined() {
    let (poses, times) = poses(60, 0.0);
    let motion = TorqueFreeMotion::of_poses(&poses, &times).unwrap();
    let information = PoseInformation::independent(&poses, [f64::INFINITY, f64::INFINITY]);
    assert!(motion.most_likely(&information, &times).is_none());
}
