use super::*;
use crate::solvers::testing::normal;
use crate::torque_free::dynamics::TorqueFreeBody;
use glam::{DMat3, DQuat, DVec3};

/// A body with moments of inertia 1, 0.8 and 0.5 about tilted axes that turns at some 40° a second.
pub(crate) fn body() -> TorqueFreeBody {
    let axes = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(0.3, -0.8, 0.5)));
    let inertia = DVec3::new(1.0, 0.8, 0.5);
    let response = axes * DMat3::from_diagonal(0.7 / inertia) * axes.transpose();
    TorqueFreeBody {
        attitude: DQuat::from_scaled_axis(DVec3::new(-0.4, 0.2, 1.1)),
        momentum: DVec3::new(0.2, -0.9, 0.3).normalize(),
        log_response: of_eigenvalues(&response, f64::ln),
    }
}

/// Attitudes fifteen times a second for `n` frames, each wrong by `noise` radians a coordinate.
pub(crate) fn seen(body: &TorqueFreeBody, n: usize, noise: f64) -> Vec<Attitude> {
    let times: Vec<f64> = (0..n).map(|i| i as f64 / 15.0).collect();
    let truth = body.attitudes(&times);
    let mut r = scene::rng::rng(7, "attitudes", 0);
    let mut found = Vec::new();
    for (time, rotation) in times.iter().zip(truth) {
        let wrong = DVec3::new(normal(&mut r), normal(&mut r), normal(&mut r)) * noise;
        found.push(Attitude { time: *time, rotation: DQuat::from_scaled_axis(wrong) * rotation });
    }
    found
}

#[test]
fn exact_attitudes_give_the_body_back() {
    let truth = body();
    let fit = TorqueFreeFit::of(&seen(&truth, 120, 0.0)).unwrap();
    let [found, expected] = [&fit.body, &truth].map(|b| b.principal_axes().0);
    for k in 0..3 {
        assert!((found[k] - expected[k]).abs() < 2e-3, "{found:?} {expected:?}");
    }
    assert!(fit.body.momentum.angle_between(truth.momentum) < 1e-4);
    assert!(fit.sigma < 1e-4, "{}", fit.sigma);
}

#[test]
fn noisy_attitudes_give_nearly_the_body() {
    let truth = body();
    let fit = TorqueFreeFit::of(&seen(&truth, 150, 0.006)).unwrap();
    assert!((fit.sigma / 0.006 - 1.0).abs() < 0.2, "{}", fit.sigma);
    assert!(fit.body.momentum.angle_between(truth.momentum) < 0.01);
    let at = truth.attitudes(&[fit.epoch])[0];
    let error = rotation_vector(fit.body.attitude * at.conjugate()).length();
    assert!(error < 0.003, "{error}");
}

#[test]
fn outliers_do_not_count() {
    let truth = body();
    let mut attitudes = seen(&truth, 120, 0.003);
    for a in attitudes.iter_mut().step_by(10) {
        a.rotation = DQuat::from_rotation_x(0.5) * a.rotation;
    }
    let fit = TorqueFreeFit::of(&attitudes).unwrap();
    assert!(fit.body.momentum.angle_between(truth.momentum) < 0.01);
    assert!(fit.sigma < 0.005, "{}", fit.sigma);
}

#[test]
fn a_steady_turn_is_a_body_of_which_only_the_rate_is_known() {
    let spin = TorqueFreeBody { log_response: DMat3::from_diagonal(DVec3::splat(-0.5)), ..body() };
    let fit = TorqueFreeFit::of(&seen(&spin, 100, 0.002)).unwrap();
    let rate = fit.body.rates(fit.body.attitude).length();
    assert!((rate - (-0.5f64).exp()).abs() < 2e-3, "{rate}");
}

#[test]
fn what_does_not_move_and_what_is_no_number_is_no_motion() {
    let still = |i: usize| Attitude { time: i as f64, rotation: DQuat::IDENTITY };
    assert!(TorqueFreeFit::of(&(0..40).map(still).collect::<Vec<_>>()).is_none());
    assert!(TorqueFreeFit::of(&seen(&body(), 5, 0.0)).is_none());
    let mut broken = seen(&body(), 40, 0.0);
    broken[3].rotation.x = f64::NAN;
    assert!(TorqueFreeFit::of(&broken).is_none());
}
