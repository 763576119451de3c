//! What the angles of a video themselves say of its motion: that the object turns steadily, as
//! steadily as they show.

use super::learnt_motion::{AngleAt, LearntMotion};
use super::limits::{COMPARABLE, FRAMES_TO_CHOOSE, LEAST_OBSERVATIONS};
use super::problem::CircularCovariance;
use crate::solvers::cholesky::{cholesky, dot, whiten};
use scene::decision::{Decision, Measurement, Quantity, Rule, Subject};

/// Motions that are less likely than the best by this (logarithm) are not averaged.
/// Source: derived; all that are left out weigh a few percent.
const UNLIKELY: f64 = 4.0;
/// Odds against a steady turn from which on it is not taken for one.
/// Source: Kass & Raftery 1995, "strong" evidence; docs/decisions/08, turns by hand have odds of
/// thousands.
const SLOW_ODDS: f64 = 20.0;

/// A motion that is tried: `θ = α + ω t + g(t)`, g a Gaussian process (Matérn 3/2 of standard
/// deviation `sway` over `lasts`, and white `jitter`), seen with `excess` times the covariance of
/// the angles.
#[derive(Clone, Copy, Debug)]
struct AngleProcess {
    excess: f64,
    jitter: f64,
    sway: f64,
    lasts: f64,
}

impl AngleProcess {
    /// All that are tried where the angles' covariance is too small by `least` at least, each with
    /// the logarithm of what is thought of it beforehand: the factor is log-normal by a factor of
    /// two, and a steady turn is as likely as all slow deviations together. Source of the jitters
    /// (radians): chosen by hand, never measured.
    fn all(least: f64) -> Vec<(f64, Self)> {
        let rare = -((slow_deviations().count() as f64).ln());
        let mut slow = vec![(0.0, 0.0, 1.0)];
        slow.extend(slow_deviations().map(|(sway, lasts)| (rare, sway, lasts)));
        let mut all = Vec::new();
        for doubled in 0..3 {
            let (excess, doubt) = (least * f64::from(1 << doubled), -0.5 * f64::from(doubled * doubled));
            for jitter in [1e-6, 3e-5, 1.2e-4, 5e-4] {
                for &(prior, sway, lasts) in &slow {
                    all.push((prior + doubt, Self { excess, jitter, sway, lasts }));
                }
            }
        }
        all
    }

    /// `E[g(s) g(t)]` for times in shares of the video.
    fn covariance(&self, s: f64, t: f64) -> f64 {
        let d = 3f64.sqrt() * (s - t).abs() / self.lasts;
        let white = if s == t { self.jitter * self.jitter } else { 0.0 };
        self.sway * self.sway * (1.0 + d) * (-d).exp() + white
    }
}

/// Slow deviations from a steady turn that are tried: standard deviation (radians, from 0.006
/// degrees by triplings) and how long each lasts (a share of the video). Source: chosen by hand,
/// never measured.
fn slow_deviations() -> impl Iterator<Item = (f64, f64)> {
    let lasting = [1.0 / 32.0, 0.125, 0.5];
    lasting.into_iter().flat_map(|lasts| (0..10).map(move |k| (1e-4 * 3f64.powi(k), lasts)))
}

/// Angles that were found without a prior, y = θ + e, with `Cov(e) = κ C`.
struct MeasuredAngles {
    /// Radians.
    angles: Vec<f64>,
    /// Shares of the video.
    times: Vec<f64>,
    /// [n × n] C.
    covariance: Vec<f64>,
}

/// Generalised least squares of a steady turn: Cholesky's factor L of `S = κ C + K`, whitened unit
/// and time columns, their 2 × 2 normal matrix, and the whitened rest.
struct ProcessFit {
    l: Vec<f64>,
    columns: [Vec<f64>; 2],
    normal: [f64; 3],
    rest: Vec<f64>,
    start: f64,
    slope: f64,
}

impl MeasuredAngles {
    fn len(&self) -> usize {
        self.angles.len()
    }

    /// Takes in what is known of the angle between the first and the last frame (Kalman's update),
    /// its variance in units of C.
    fn close(&mut self, range: f64, variance: f64) {
        let (n, last) = (self.len(), self.len() - 1);
        let column: Vec<f64> =
            (0..n).map(|i| self.covariance[i * n + last] - self.covariance[i * n]).collect();
        let total = column[last] - column[0] + variance;
        let off = range - (self.angles[last] - self.angles[0]);
        (0..n).for_each(|i| self.angles[i] += column[i] / total * off);
        (0..n * n).for_each(|k| self.covariance[k] -= column[k / n] * column[k % n] / total);
    }

    /// Every so many-th angle, so that at most `most` are left.
    fn thin(&self, most: usize) -> Self {
        let kept: Vec<usize> = (0..self.len()).step_by(self.len().div_ceil(most)).collect();
        let n = self.len();
        Self {
            angles: kept.iter().map(|&i| self.angles[i]).collect(),
            times: kept.iter().map(|&i| self.times[i]).collect(),
            covariance: kept
                .iter()
                .flat_map(|i| kept.iter().map(move |k| i * n + k))
                .map(|k| self.covariance[k])
                .collect(),
        }
    }

    fn fit(&self, motion: &AngleProcess) -> Option<ProcessFit> {
        let n = self.len();
        let (c, t) = (&self.covariance, &self.times);
        let s = (0..n * n).map(|k| motion.excess * c[k] + motion.covariance(t[k / n], t[k % n])).collect();
        let l = cholesky(s, n)?;
        let [one, time, y] = [&vec![1.0; n], t, &self.angles].map(|v| whiten(&l, v));
        let normal = [dot(&one, &one), dot(&one, &time), dot(&time, &time)];
        let [a, b, d] = normal;
        let (p, q, determinant) = (dot(&one, &y), dot(&time, &y), a * d - b * b);
        let (start, slope) = ((d * p - b * q) / determinant, (a * q - b * p) / determinant);
        let rest = (0..n).map(|i| y[i] - start * one[i] - slope * time[i]).collect();
        (start.is_finite() && slope.is_finite()).then_some(ProcessFit {
            l,
            columns: [one, time],
            normal,
            rest,
            start,
            slope,
        })
    }

    /// Angles given the motion, `y − κ C R y`, and their covariance's diagonal, `κ C − κ C R κ C`,
    /// with `R = S⁻¹ − S⁻¹ X (Xᵀ S⁻¹ X)⁻¹ Xᵀ S⁻¹` (X: unit and time; Rasmussen & Williams 2006,
    /// 2.7).
    fn posterior(&self, motion: &AngleProcess, fit: &ProcessFit) -> (Vec<f64>, Vec<f64>) {
        let n = self.len();
        let mut angles = Vec::with_capacity(n);
        let mut variances = Vec::with_capacity(n);
        let [a, b, d] = fit.normal;
        for i in 0..n {
            let row: Vec<f64> = (0..n).map(|k| motion.excess * self.covariance[i * n + k]).collect();
            let w = whiten(&fit.l, &row);
            let (p, q) = (dot(&fit.columns[0], &w), dot(&fit.columns[1], &w));
            let line = (d * p * p - 2.0 * b * p * q + a * q * q) / (a * d - b * b);
            angles.push(self.angles[i] - dot(&w, &fit.rest));
            variances.push((row[i] - dot(&w, &w) + line).max(0.0));
        }
        (angles, variances)
    }
}

impl ProcessFit {
    /// The angle at another time (a share of the video), `xᵀβ + kᵀ S⁻¹ (y − X β)`, and its variance
    /// (Rasmussen & Williams 2006, 2.7).
    fn predict(&self, motion: &AngleProcess, times: &[f64], time: f64) -> (f64, f64) {
        let k: Vec<f64> = times.iter().map(|t| motion.covariance(time, *t)).collect();
        let w = whiten(&self.l, &k);
        let [a, b, d] = self.normal;
        let (p, q) = (1.0 - dot(&self.columns[0], &w), time - dot(&self.columns[1], &w));
        let line = (d * p * p - 2.0 * b * p * q + a * q * q) / (a * d - b * b);
        let mean = self.start + self.slope * time + dot(&w, &self.rest);
        (mean, (motion.covariance(time, time) - dot(&w, &w) + line).max(0.0))
    }

    /// Logarithm of the evidence with start and rate integrated out (type II maximum likelihood,
    /// MacKay 1992).
    fn evidence(&self, n: usize) -> f64 {
        let logs: f64 = (0..n).map(|i| self.l[i * (n + 1)].ln()).sum();
        let [a, b, d] = self.normal;
        -logs - 0.5 * (a * d - b * b).ln() - 0.5 * dot(&self.rest, &self.rest)
    }
}

/// What the angles that were found without a prior say of the motion, and the angles that follow.
///
/// Short steps are seen far better than long stretches, whose errors add up along the chain of
/// tracks: the covariance C of the angles knows. A motor that turns steadily over short stretches
/// does so over long ones, so the motion's own spectrum decides how much of a slow deviation is
/// believed. Angles are averaged over the motions that are likely. `closing`: the angle between the
/// first and the last frame as it is known otherwise, with its standard deviation. `asked`: other
/// times at which angles are asked for, seconds. `None` where there are too few frames.
pub(crate) fn learn_motion(
    angles: &[Option<f64>],
    times: &[f64],
    images: &[usize],
    covariance: &CircularCovariance,
    closing: Option<(f64, f64)>,
    asked: &[f64],
) -> Option<LearntMotion> {
    let n = images.len();
    if n < LEAST_OBSERVATIONS || covariance.joint.len() != n * n {
        return None;
    }
    let (first, last) = (times[images[0]], times[images[n - 1]]);
    let mut found = MeasuredAngles {
        angles: images.iter().map(|&f| angles[f].unwrap_or(0.0)).collect(),
        times: images.iter().map(|&f| (times[f] - first) / (last - first)).collect(),
        covariance: covariance.joint.clone(),
    };
    let step = (found.angles[n - 1] - found.angles[0]).abs() / (n - 1) as f64;
    // Frames within such a turn see the same points err in the same way: they count as one
    // (docs/decisions/09).
    let least = (COMPARABLE / step.max(1e-3)).max(1.0);
    if let Some((range, sigma)) = closing {
        found.close(range, sigma * sigma / least);
    }
    let trials = ProcessTrials::of(&found.thin(FRAMES_TO_CHOOSE), least)?;
    let shares: Vec<f64> = asked.iter().map(|t| (t - first) / (last - first)).collect();
    let average = trials.average(&found, &shares)?;
    let mut between = Vec::with_capacity(asked.len());
    for (&time, &(angle, deviation)) in asked.iter().zip(&average.between) {
        between.push(AngleAt { time, angle, deviation });
    }
    let mut decision = Decision::new(
        Subject::RotationRate,
        Measurement::new(Quantity::AngularRate, (average.slope / (last - first)).to_degrees()),
        Rule::Evidence,
    );
    decision.measurements.extend(trials.figures(&found, &average));
    let ProcessAverage { angles, deviations, excess, .. } = average;
    Some(LearntMotion { images: images.to_vec(), angles, deviations, excess, between, decision })
}

/// Motions with the logarithms of their posterior probabilities, the likeliest first.
struct ProcessTrials(Vec<(f64, AngleProcess)>);

/// Angles averaged over likely motions.
struct ProcessAverage {
    /// Radians.
    angles: Vec<f64>,
    /// Standard deviations, radians.
    deviations: Vec<f64>,
    /// Angles at the other times, and their standard deviations, radians.
    between: Vec<(f64, f64)>,
    excess: f64,
    /// Radians over the whole video.
    slope: f64,
}

impl ProcessTrials {
    /// All motions on these angles, whose covariance is too small by `least` at least.
    fn of(found: &MeasuredAngles, least: f64) -> Option<Self> {
        let mut tried: Vec<(f64, AngleProcess)> = Vec::new();
        for (prior, motion) in AngleProcess::all(least) {
            tried.extend(found.fit(&motion).map(|fit| (fit.evidence(found.len()) + prior, motion)));
        }
        tried.retain(|t| t.0.is_finite());
        tried.sort_by(|a, b| b.0.total_cmp(&a.0));
        (!tried.is_empty()).then_some(Self(tried))
    }

    /// Odds of slow deviations or of a steady turn against the likeliest motion.
    fn odds(&self, slow: bool) -> f64 {
        let of_kind = self.0.iter().filter(|t| (t.1.sway > 0.0) == slow);
        of_kind.map(|t| (t.0 - self.0[0].0).exp()).sum()
    }

    /// Whether the turn is taken for a steady one. That is a choice between two hypotheses, not two
    /// sizes: a motor turns steadily or it does not. Averaged with all slow deviations, errors of a
    /// degree leave a tenth of themselves in a turn that is steady.
    fn is_steady(&self) -> bool {
        SLOW_ODDS * self.odds(false) >= self.odds(true)
    }

    /// The angles given the motions that are likely.
    fn average(&self, found: &MeasuredAngles, others: &[f64]) -> Option<ProcessAverage> {
        let n = found.len();
        let is_steady = self.is_steady();
        let asked: Vec<_> = self.0.iter().filter(|t| t.1.sway == 0.0 || !is_steady).collect();
        let likeliest = asked.first()?.0;
        let (mut sum, mut squares, mut total, mut excess) = (vec![0.0; n], vec![0.0; n], 0.0, 0.0);
        let mut slope = 0.0;
        let mut moments = vec![(0.0, 0.0); others.len()];
        for (likely, motion) in asked.into_iter().filter(|t| t.0 > likeliest - UNLIKELY) {
            let Some(fit) = found.fit(motion) else { continue };
            let weight = (likely - self.0[0].0).exp();
            let (mean, variance) = found.posterior(motion, &fit);
            for i in 0..n {
                let off = mean[i] - found.angles[i];
                sum[i] += weight * off;
                squares[i] += weight * (variance[i] + off * off);
            }
            for (sums, time) in moments.iter_mut().zip(others) {
                let (mean, variance) = fit.predict(motion, &found.times, *time);
                sums.0 += weight * mean;
                sums.1 += weight * (variance + mean * mean);
            }
            total += weight;
            excess += weight * motion.excess;
            slope += weight * fit.slope;
        }
        let spread = (0..n).map(|i| (squares[i] / total - (sum[i] / total).powi(2)).max(0.0).sqrt());
        let spread_of = |(sum, square): &(f64, f64)| {
            let mean = sum / total;
            (mean, (square / total - mean * mean).max(0.0).sqrt())
        };
        let between = moments.iter().map(spread_of).collect();
        (total > 0.0).then(|| ProcessAverage {
            between,
            angles: (0..n).map(|i| found.angles[i] + sum[i] / total).collect(),
            deviations: spread.collect(),
            excess: excess / total,
            slope: slope / total,
        })
    }

    /// For the report.
    fn figures(&self, found: &MeasuredAngles, average: &ProcessAverage) -> [Measurement; 9] {
        let n = found.len();
        let (best, motion) = self.0[0];
        let steady = self.0.iter().find(|t| t.1.sway == 0.0).map_or(f64::NAN, |t| t.0);
        let (even, uneven) = (self.odds(false), self.odds(true));
        let expected = (0..n).map(|i| (average.excess * found.covariance[i * (n + 1)]).sqrt());
        [
            (Quantity::RateDeviation, found.deviation_from_rate(&found.angles, average.slope)),
            (Quantity::ExpectedDeviation, root_mean_square(expected).to_degrees()),
            (Quantity::VarianceFactor, average.excess),
            (Quantity::SlowDeviation, motion.sway.to_degrees()),
            (Quantity::SlowDuration, motion.lasts),
            (Quantity::Jitter, motion.jitter.to_degrees()),
            (Quantity::LogOdds, best - steady),
            (Quantity::Probability, even / (even + uneven)),
            (Quantity::SmoothedDeviation, found.deviation_from_rate(&average.angles, average.slope)),
        ]
        .map(|(quantity, value)| Measurement::new(quantity, value))
    }
}

impl MeasuredAngles {
    /// Root mean square deviation of angles from a line of this slope, degrees.
    fn deviation_from_rate(&self, angles: &[f64], slope: f64) -> f64 {
        let pairs = angles.iter().zip(&self.times);
        let off: Vec<f64> = pairs.map(|(a, t)| a - angles[0] - slope * t).collect();
        let mean = off.iter().sum::<f64>() / off.len() as f64;
        root_mean_square(off.iter().map(|o| o - mean)).to_degrees()
    }
}

fn root_mean_square(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len() as f64;
    (values.map(|v| v.powi(2)).sum::<f64>() / n).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solvers::testing::normal;
    use scene::rng::rng;

    const FRAMES: usize = 120;

    /// True angles that are seen with errors of a chain: each step has its own error of `noise`,
    /// and the sum of them is what an angle is off; half of what a closed turn leaves. `thought`:
    /// what a step's error is believed to be.
    fn learn(
        truth: impl Fn(f64) -> f64,
        noise: f64,
        thought: f64,
        seed: u64,
    ) -> (LearntMotion, Vec<f64>, Vec<f64>) {
        let mut r = rng(seed, "rate", 0);
        let truth: Vec<f64> = (0..FRAMES).map(|i| truth(i as f64 / (FRAMES - 1) as f64)).collect();
        let mut drift = 0.0;
        let found: Vec<f64> = truth
            .iter()
            .enumerate()
            .map(|(i, t)| {
                drift += if i > 0 { noise * normal(&mut r) } else { 0.0 };
                t + drift
            })
            .collect();
        (of_chain(&found, thought, None), truth, found)
    }

    /// What is learnt of such angles.
    fn of_chain(found: &[f64], thought: f64, closing: Option<(f64, f64)>) -> LearntMotion {
        let angles: Vec<Option<f64>> = found.iter().map(|a| Some(*a)).collect();
        let times: Vec<f64> = (0..FRAMES).map(|i| 0.1 * i as f64).collect();
        let images: Vec<usize> = (0..FRAMES).collect();
        let joint =
            (0..FRAMES * FRAMES).map(|k| thought * thought * (k / FRAMES).min(k % FRAMES) as f64).collect();
        let covariance = CircularCovariance { joint, ..CircularCovariance::default() };
        learn_motion(&angles, &times, &images, &covariance, closing, &[]).unwrap()
    }

    /// Root mean square of the error, its mean aside.
    fn rms(found: &[f64], truth: &[f64]) -> f64 {
        let off: Vec<f64> = found.iter().zip(truth).map(|(a, b)| a - b).collect();
        let mean = off.iter().sum::<f64>() / off.len() as f64;
        (off.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / off.len() as f64).sqrt()
    }

    #[test]
    fn a_steady_turn_is_found_through_errors_that_add_up() {
        for (seed, thought) in [(0, 2e-4), (1, 2e-4), (2, 1e-4), (3, 4e-4)] {
            let (learnt, truth, found) = learn(|t| 6.0 * t, 2e-4, thought, seed);
            let line = |a: &[f64], b: &[f64]| {
                // What a wrong rate leaves is the same before and after.
                let slope = |v: &[f64]| (v[FRAMES - 1] - v[0]) / (FRAMES - 1) as f64;
                let level = |v: &[f64]| {
                    v.iter().enumerate().map(|(i, x)| x - slope(v) * i as f64).collect::<Vec<_>>()
                };
                rms(&level(a), &level(b))
            };
            let (before, after) = (line(&found, &truth), line(&learnt.angles, &truth));
            assert!(after < 0.4 * before, "seed {seed}: {before} became {after}, {:?}", learnt.decision);
        }
    }

    #[test]
    fn a_turn_by_hand_is_left_as_it_was_seen() {
        for seed in 0..4 {
            let hand = |t: f64| 6.0 * t + 0.4 * (7.0 * t).sin() + 0.1 * (40.0 * t).sin();
            let (learnt, truth, found) = learn(hand, 1e-4, 1e-4, seed);
            let (before, after) = (rms(&found, &truth), rms(&learnt.angles, &truth));
            assert!(after < 1.1 * before, "seed {seed}: {before} became {after}, {:?}", learnt.decision);
        }
    }

    #[test]
    fn errors_and_their_standard_deviations_are_of_one_size() {
        let mut ratio = 0.0;
        for seed in 0..20 {
            // Errors of tracks last: the frames within half a radian, ten of them, count as one.
            let (learnt, truth, _) = learn(|t| 6.0 * t, 2e-4 * 10f64.sqrt(), 2e-4, 100 + seed);
            let middle = FRAMES / 2;
            let off = learnt.angles[middle] - learnt.angles[0] - truth[middle];
            ratio += (off / learnt.deviations[middle]).powi(2) / 20.0;
        }
        assert!((0.3..3.0).contains(&ratio), "mean square of error over deviation: {ratio}");
    }

    #[test]
    fn a_turn_that_is_closed_otherwise_takes_the_drift_out() {
        for seed in 0..6 {
            let noise = 2e-3;
            let (_, truth, found) = learn(|t| 6.0 * t, noise, noise, seed);
            let closed = of_chain(&found, noise, Some((6.0, 1e-4)));
            let range = closed.angles[FRAMES - 1] - closed.angles[0];
            assert!((range - 6.0).abs() < 1e-3, "seed {seed}: {range}");
            assert!(rms(&closed.angles, &truth) < 5e-4, "seed {seed}: {}", rms(&closed.angles, &truth));
        }
    }
}
