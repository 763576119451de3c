use super::*;
use crate::bundle::PoseInformation;
use crate::torque_free::fit::tests::body;
use crate::torque_free::likely::tests::poses;
use crate::torque_free::motion::TorqueFreeMotion;

#[test]
fn rate_axis_and_inertia_are_within_their_deviations() {
    let (poses, times) = poses(150, 0.005);
    let information = PoseInformation::independent(&poses, [0.005, 0.01]);
    let rough = TorqueFreeMotion::of_poses(&poses, &times).unwrap();
    let report = report(&rough.most_likely(&information, &times).unwrap(), &times, 1.0);
    let tumble = report.tumble.unwrap();
    for (found, truth) in tumble.inertia_ratios.iter().zip([0.5, 0.8]) {
        let off = (found.value - truth).abs();
        assert!(off < 3.0 * found.deviation && found.deviation < 0.1, "{found:?}");
    }
    let truth = body();
    let rates: Vec<f64> = truth.attitudes(&times).iter().map(|q| truth.rates(*q).length()).collect();
    let mean = (rates.iter().sum::<f64>() / 150.0).to_degrees();
    let rate = report.rate_deg_s;
    assert!((rate.value - mean).abs() < 3.0 * rate.deviation + 1e-3, "{rate:?} {mean}");
    assert!(rate.deviation < 0.005 * mean, "{rate:?}");
}

#[test]
fn rates_repeat_after_the_period() {
    let truth = body();
    let (values, axes) = truth.principal_axes();
    let period = polhode_period(values, truth.momentum_in_principal_axes());
    let at = truth.attitudes(&[0.0, period, 0.5 * period]);
    let [start, end, middle] = [at[0], at[1], at[2]].map(|q| axes.transpose() * truth.rates(q));
    assert!((start - end).length() < 1e-5, "{start} {end}");
    assert!((start - middle).length() > 1e-2);
}
