use super::*;
use crate::torque_free::fit::tests::{body, seen};

/// Poses of a body whose centre of mass is off the world's origin and drifts, in scenes of some
/// size.
fn poses(scale: f64) -> (Vec<Pose>, Vec<f64>) {
    let attitudes = seen(&body(), 100, 0.0);
    let centre = DVec3::new(0.3, -0.2, 0.1) * scale;
    let pose = |a: &Attitude| {
        let place = (DVec3::new(0.1, 0.0, 4.0) + DVec3::new(0.01, 0.02, -0.03) * a.time) * scale;
        Pose::new(a.rotation, place - a.rotation * centre)
    };
    (attitudes.iter().map(pose).collect(), attitudes.iter().map(|a| a.time).collect())
}

#[test]
fn centre_of_mass_and_drift_are_found_at_any_scale() {
    for scale in [1e-6, 1.0, 1e6] {
        let (poses, times) = poses(scale);
        let motion = TorqueFreeMotion::of_poses(&poses, &times).unwrap();
        let off = (motion.mass.centre / scale - DVec3::new(0.3, -0.2, 0.1)).length();
        let drift = (motion.mass.velocity / scale - DVec3::new(0.01, 0.02, -0.03)).length();
        assert!(off < 1e-4 && drift < 1e-4, "{scale}: {off} {drift}");
        for (found, pose) in motion.poses(&times).iter().zip(&poses) {
            assert!((found.translation - pose.translation).length() < 1e-3 * scale);
        }
    }
}
