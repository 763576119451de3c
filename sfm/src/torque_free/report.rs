//! What a torque-free motion is, in numbers with their standard deviations.

use super::deviations::{DIFFERENCE, steps};
use super::dynamics::TorqueFreeBody;
use super::likely::LikelyMotion;
use glam::{DQuat, DVec3};
use scene::decision::MotionModel;
use scene::motion_report::{Estimate, MotionReport, MotionSample, TumbleReport};

/// Figures of a motion over some times, seconds.
struct Figures {
    /// Mean rate, rad/s.
    rate: f64,
    /// Mean angle between the spin's principal axis and the momentum, radians.
    nutation: f64,
    /// After which the rates repeat in the body's frame, seconds; infinite where they do not.
    period: f64,
    /// Moments of inertia in ascending order, shares of the largest; the last is 1.
    ratios: [f64; 3],
    momentum: DVec3,
    /// The principal axis about which the body turns, body frame.
    axis: DVec3,
}

impl Figures {
    fn of(body: &TorqueFreeBody, attitudes: &[DQuat], near: DVec3) -> Self {
        let (values, axes) = body.principal_axes();
        let rates: Vec<DVec3> = attitudes.iter().map(|q| body.rates(*q)).collect();
        let mean = rates.iter().sum::<DVec3>();
        let columns = [axes.x_axis, axes.y_axis, axes.z_axis];
        let axis = columns.into_iter().max_by(|a, b| a.dot(mean).abs().total_cmp(&b.dot(mean).abs()));
        let axis = axis.unwrap_or(DVec3::Z);
        let axis = if axis.dot(if near == DVec3::ZERO { mean } else { near }) < 0.0 { -axis } else { axis };
        let lean = |q: &DQuat| (*q * axis).dot(body.momentum).clamp(-1.0, 1.0).acos();
        let n = attitudes.len().max(1) as f64;
        // The inertia is exp(−S): the largest moment belongs to the smallest eigenvalue.
        let ratios = [2, 1, 0].map(|k| (values[0] - values[k]).exp());
        Self {
            rate: rates.iter().map(|w| w.length()).sum::<f64>() / n,
            nutation: attitudes.iter().map(lean).sum::<f64>() / n,
            period: polhode_period(values, body.momentum_in_principal_axes()),
            ratios,
            momentum: body.momentum,
            axis,
        }
    }
}

/// The report of a motion over the times of the images, seconds. `factor`: on the standard
/// deviations.
pub(super) fn report(likely: &LikelyMotion, times: &[f64], factor: f64) -> MotionReport {
    let turn = &likely.motion.turn;
    let attitudes = turn.attitudes(times);
    let found = Figures::of(&turn.body, &attitudes, DVec3::ZERO);
    let mut variances = [0.0; 5];
    let mut of_axes = [0.0; 2];
    for step in steps(likely) {
        let [high, low] = [1.0, -1.0].map(|sign| {
            let moved = likely.motion.stepped(&step.map(|v| sign * DIFFERENCE * v)).turn;
            Figures::of(&moved.body, &moved.attitudes(times), found.axis)
        });
        let numbers = |f: &Figures| [f.rate, f.nutation, f.period, f.ratios[0], f.ratios[1]];
        for ((v, h), l) in variances.iter_mut().zip(numbers(&high)).zip(numbers(&low)) {
            *v += ((h - l) / (2.0 * DIFFERENCE)).powi(2);
        }
        for (v, d) in of_axes.iter_mut().zip([high.momentum - low.momentum, high.axis - low.axis]) {
            *v += (d / (2.0 * DIFFERENCE)).length_squared();
        }
    }
    let [rate, nutation, period, least, middle] = variances.map(|v| factor * v.sqrt());
    let [of_momentum, of_axis] = of_axes.map(|v| factor * v.sqrt().to_degrees());
    let rates: Vec<DVec3> = attitudes.iter().map(|q| *q * turn.body.rates(*q)).collect();
    let samples = times.iter().zip(&rates).map(|(time_s, w)| MotionSample {
        time_s: *time_s,
        rate_deg_s: (*w).to_array().map(f64::to_degrees),
    });
    MotionReport {
        motion: MotionModel::TorqueFree,
        axis_camera: found.momentum.to_array(),
        axis_camera_deviation_deg: of_momentum,
        axis_body: found.axis.to_array(),
        axis_body_deviation_deg: of_axis,
        rate_deg_s: Estimate::new(found.rate, rate).in_degrees(),
        tumble: Some(TumbleReport {
            nutation_deg: Estimate::new(found.nutation, nutation).in_degrees(),
            period_s: found.period.is_finite().then(|| Estimate::new(found.period, period)),
            inertia_ratios: [Estimate::new(found.ratios[0], least), Estimate::new(found.ratios[1], middle)],
        }),
        samples: samples.collect(),
    }
}

/// After which the rates repeat in the body's frame, seconds: `4 K(k²) / n` with the complete
/// elliptic integral by the arithmetic-geometric mean (Landau & Lifshitz, Mechanics, § 37).
/// `log_response`: logarithms of 1/I in ascending order, for a momentum of length 1; `momentum`:
/// its coordinates along these axes. Infinite for a turn about a principal axis.
fn polhode_period(log_response: [f64; 3], momentum: DVec3) -> f64 {
    // Moments of inertia in ascending order, and the squares of the momentum along their axes.
    let inertia = [2, 1, 0].map(|k| (-log_response[k]).exp());
    let m = [momentum.z, momentum.y, momentum.x].map(|v| v * v);
    let energy: f64 = m.iter().zip(&inertia).map(|(m, i)| m / i).sum();
    let about_largest = 1.0 > energy * inertia[1];
    let [a, b, c] = if about_largest { inertia } else { [inertia[2], inertia[1], inertia[0]] };
    let k2 = (b - a) * (energy * c - 1.0) / ((c - b) * (1.0 - energy * a));
    if !(0.0..1.0).contains(&k2) {
        return f64::INFINITY;
    }
    let (mut x, mut y) = (1.0, (1.0 - k2).sqrt());
    for _ in 0..40 {
        (x, y) = (0.5 * (x + y), (x * y).sqrt());
    }
    let frequency = ((c - b) * (1.0 - energy * a) / (a * b * c)).sqrt();
    2.0 * std::f64::consts::PI / x / frequency
}

#[cfg(test)]
mod tests;
