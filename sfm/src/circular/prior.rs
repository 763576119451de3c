//! What is known of the angles of a video beside its pictures: a given rate, or that the object turns steadily, as
//! steadily as the angles themselves say.

use super::problem::{CircularCovariance, Relation};
use super::whiten::{cholesky, dot, whiten};
use scene::decision::{Decision, Measurement, Quantity, Rule, Subject};

/// Fewest frames from which the motion is learnt.
const FEWEST: usize = 10;
/// Most frames from which its strength is learnt (a Cholesky factor for each one that is tried).
const MOST: usize = 100;
/// Least factor on the angles' covariance that is tried, and how many doublings of it. Errors of one track in many frames are not
/// independent: outlines and glints slide along. On objects full of texture the angles themselves say 4 to 8; where there is
/// little, a smaller factor would take the drift of a few tracks for the motion.
const EXCESS: (f64, i32) = (8.0, 3);
/// Frames within such a turn see the same errors, radians: where a step is a smaller share of it than the least factor
/// says, more frames say no more, and the factor grows with their number.
const SAME_ERRORS: f64 = 0.5;
/// Standard deviations of independent jitter that are tried, radians.
const JITTER: [f64; 4] = [1e-6, 3e-5, 1.2e-4, 5e-4];
/// Standard deviations of slow deviations from a steady turn that are tried, radians: the least, and how many triplings.
const SWAY: (f64, i32) = (1e-4, 10);
/// How long such a deviation lasts, as a share of the video.
const LASTS: [f64; 3] = [1.0 / 32.0, 0.125, 0.5];
/// Motions that are less likely than the best by this (logarithm) are not asked.
const UNLIKELY: f64 = 4.0;
/// Most motions that are asked.
const ASKED: usize = 12;
/// Odds against a steady turn from which on it is not taken for one (Kass & Raftery 1995: "strong" evidence). Turns by hand have odds
/// of thousands; what lies between are tracks that slide along outlines.
const SLOW_ODDS: f64 = 20.0;
/// Standard deviation with which the learnt angles are held, radians.
const HELD: f64 = 2e-6;

/// What a known rate (radians a second, of either sign) says of neighbouring angles. `times`: seconds by frame.
pub(crate) fn known_rate(angles: &[Option<f64>], times: &[f64], rate: f64) -> Vec<Relation> {
    let known: Vec<usize> = (0..times.len()).filter(|&f| angles[f].is_some()).collect();
    let angle = |f: usize| angles[f].unwrap_or(0.0);
    let sense = match (known.first(), known.last()) {
        (Some(&f), Some(&l)) => (angle(l) - angle(f)).signum(),
        _ => 1.0,
    };
    let step = |w: &[usize]| {
        let target = sense * rate.abs() * (times[w[1]] - times[w[0]]);
        let sigma = (0.01 * target.abs()).max(1e-9);
        let frames = [Some(w[0] as u32), Some(w[1] as u32), None];
        Relation { frames, coefficients: [-1.0, 1.0, 0.0], target, sigma }
    };
    known.windows(2).map(step).collect()
}

/// The angles under what was learnt of the motion.
pub(crate) struct LearntMotion {
    /// Frames, in their order.
    images: Vec<usize>,
    /// Angles of these frames, radians.
    angles: Vec<f64>,
    /// Their standard deviations against the first, radians.
    pub deviations: Vec<f64>,
    /// Factor on the variances that the observations' noise alone would give.
    pub excess: f64,
    /// For the report.
    pub decision: Decision,
}

impl LearntMotion {
    /// Holds every angle against the first: the adjustment of all else under the learnt motion.
    pub fn holding_relations(&self) -> Vec<Relation> {
        self.relations(|_| HELD)
    }

    /// The same as loose as the angles are known, for standard deviations of all else.
    pub fn loose_relations(&self) -> Vec<Relation> {
        self.relations(|i| self.deviations[i].max(HELD))
    }

    /// By frame, of so many.
    pub fn by_frame(&self, frames: usize) -> Vec<Option<f64>> {
        let mut angles = vec![None; frames];
        self.images.iter().zip(&self.angles).for_each(|(&f, a)| angles[f] = Some(*a));
        angles
    }

    fn relations(&self, sigma: impl Fn(usize) -> f64) -> Vec<Relation> {
        let relation = |i: usize| Relation {
            frames: [Some(self.images[0] as u32), Some(self.images[i] as u32), None],
            coefficients: [-1.0, 1.0, 0.0],
            target: self.angles[i] - self.angles[0],
            sigma: sigma(i),
        };
        (1..self.images.len()).map(relation).collect()
    }
}

/// A motion that is tried: `θ = α + ω t + g(t)`, g a Gaussian process (Matérn 3/2 of standard deviation `sway` over
/// `lasts`, and white `jitter`), seen with `excess` times the covariance of the angles.
#[derive(Clone, Copy, Debug)]
struct AngleProcess {
    excess: f64,
    jitter: f64,
    sway: f64,
    lasts: f64,
}

impl AngleProcess {
    /// All that are tried where the angles' covariance is too small by so much at least.
    fn all(excess: f64) -> Vec<Self> {
        let sways = |lasts: f64| (0..SWAY.1).map(move |k| (SWAY.0 * 3f64.powi(k), lasts));
        let slow: Vec<(f64, f64)> =
            std::iter::once((0.0, 1.0)).chain(LASTS.into_iter().flat_map(sways)).collect();
        let mut all = Vec::new();
        for excess in (0..EXCESS.1).map(|k| excess * 2f64.powi(k)) {
            for jitter in JITTER {
                all.extend(slow.iter().map(|&(sway, lasts)| Self { excess, jitter, sway, lasts }));
            }
        }
        all
    }

    /// Logarithm of what is thought of it beforehand: a steady turn is as likely as all slow deviations together.
    fn prior(&self) -> f64 {
        if self.sway > 0.0 { -((LASTS.len() as f64 * f64::from(SWAY.1)).ln()) } else { 0.0 }
    }

    /// `E[g(s) g(t)]` for times in shares of the video.
    fn covariance(&self, s: f64, t: f64) -> f64 {
        let d = 3f64.sqrt() * (s - t).abs() / self.lasts;
        let white = if s == t { self.jitter * self.jitter } else { 0.0 };
        self.sway * self.sway * (1.0 + d) * (-d).exp() + white
    }
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

/// Generalised least squares of a steady turn: Cholesky's factor L of `S = κ C + K`, whitened unit and time columns,
/// their 2 × 2 normal matrix, and the whitened rest.
struct ProcessFit {
    l: Vec<f64>,
    columns: [Vec<f64>; 2],
    normal: [f64; 3],
    rest: Vec<f64>,
    slope: f64,
}

impl MeasuredAngles {
    fn len(&self) -> usize {
        self.angles.len()
    }

    /// Takes in what is known of the angle between the first and the last frame (Kalman's update), its variance in units of C.
    fn close(&mut self, range: f64, variance: f64) {
        let (n, last) = (self.len(), self.len() - 1);
        let with_range = |i: usize| self.covariance[i * n + last] - self.covariance[i * n];
        let column: Vec<f64> = (0..n).map(with_range).collect();
        let total = column[last] - column[0] + variance;
        let off = range - (self.angles[last] - self.angles[0]);
        (0..n).for_each(|i| self.angles[i] += column[i] / total * off);
        (0..n * n).for_each(|k| self.covariance[k] -= column[k / n] * column[k % n] / total);
    }

    /// Every so many-th angle, so that at most `most` are left.
    fn thin(&self, most: usize) -> Self {
        let kept: Vec<usize> = (0..self.len()).step_by(self.len().div_ceil(most)).collect();
        let n = self.len();
        let pair = |i: usize| kept.iter().map(move |&k| (i, k));
        Self {
            angles: kept.iter().map(|&i| self.angles[i]).collect(),
            times: kept.iter().map(|&i| self.times[i]).collect(),
            covariance: kept.iter().flat_map(|&i| pair(i)).map(|(i, k)| self.covariance[i * n + k]).collect(),
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
            slope,
        })
    }

    /// Angles given the motion, `y − κ C R y`, and their covariance's diagonal, `κ C − κ C R κ C`, with
    /// `R = S⁻¹ − S⁻¹ X (Xᵀ S⁻¹ X)⁻¹ Xᵀ S⁻¹` (X: unit and time; Rasmussen & Williams 2006, 2.7).
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
    /// Logarithm of the evidence with start and rate integrated out (type II maximum likelihood, MacKay 1992).
    fn evidence(&self, n: usize) -> f64 {
        let logs: f64 = (0..n).map(|i| self.l[i * (n + 1)].ln()).sum();
        let [a, b, d] = self.normal;
        -logs - 0.5 * (a * d - b * b).ln() - 0.5 * dot(&self.rest, &self.rest)
    }
}

/// What the angles that were found without a prior say of the motion, and the angles that follow.
///
/// Short steps are seen far better than long stretches, whose errors add up along the chain of tracks: the covariance C
/// of the angles knows. A motor that turns steadily over short stretches does so over long ones, so the motion's own
/// spectrum decides how much of a slow deviation is believed. Angles are averaged over the motions that are likely.
/// `closing`: the angle between the first and the last frame as it is known otherwise, with its standard deviation.
/// `None` where there are too few frames.
pub(crate) fn learn_motion(
    angles: &[Option<f64>],
    times: &[f64],
    images: &[usize],
    covariance: &CircularCovariance,
    closing: Option<(f64, f64)>,
) -> Option<LearntMotion> {
    let n = images.len();
    if n < FEWEST || covariance.joint.len() != n * n {
        return None;
    }
    let (first, last) = (times[images[0]], times[images[n - 1]]);
    let mut found = MeasuredAngles {
        angles: images.iter().map(|&f| angles[f].unwrap_or(0.0)).collect(),
        times: images.iter().map(|&f| (times[f] - first) / (last - first)).collect(),
        covariance: covariance.joint.clone(),
    };
    let step = (found.angles[n - 1] - found.angles[0]).abs() / (n - 1) as f64;
    let least = EXCESS.0.max(SAME_ERRORS / step.max(1e-3));
    if let Some((range, sigma)) = closing {
        found.close(range, sigma * sigma / least);
    }
    let some = found.thin(MOST);
    let tried = AngleProcess::all(least)
        .into_iter()
        .filter_map(|m| Some((some.fit(&m)?.evidence(some.len()) + m.prior(), m)));
    let mut tried: Vec<(f64, AngleProcess)> = tried.filter(|t| t.0.is_finite()).collect();
    tried.sort_by(|a, b| b.0.total_cmp(&a.0));
    let best = *tried.first()?;
    // Between two hypotheses, not two sizes: a motor turns steadily or it does not. Averaged with all slow deviations, errors of
    // a degree leave a tenth of themselves in a turn that is steady.
    let odds = |slow: bool| -> f64 {
        let of_kind = tried.iter().filter(|t| (t.1.sway > 0.0) == slow);
        of_kind.map(|t| (t.0 - best.0).exp()).sum()
    };
    let (even, uneven) = (odds(false), odds(true));
    let is_steady = SLOW_ODDS * even >= uneven;
    let steady = tried.iter().find(|t| t.1.sway == 0.0).map_or(f64::NAN, |t| t.0);
    let (mut sum, mut squares, mut total, mut excess) = (vec![0.0; n], vec![0.0; n], 0.0, 0.0);
    let mut slope = 0.0;
    tried.retain(|t| t.1.sway == 0.0 || !is_steady);
    let likeliest = tried.first()?.0;
    for (likely, motion) in tried.iter().take(ASKED).filter(|t| t.0 > likeliest - UNLIKELY) {
        let Some(fit) = found.fit(motion) else { continue };
        let weight = (likely - best.0).exp();
        let (mean, variance) = found.posterior(motion, &fit);
        for i in 0..n {
            let off = mean[i] - found.angles[i];
            sum[i] += weight * off;
            squares[i] += weight * (variance[i] + off * off);
        }
        total += weight;
        excess += weight * motion.excess;
        slope += weight * fit.slope;
    }
    if !(total > 0.0) {
        return None;
    }
    let angles: Vec<f64> = (0..n).map(|i| found.angles[i] + sum[i] / total).collect();
    let deviations: Vec<f64> =
        (0..n).map(|i| (squares[i] / total - (sum[i] / total).powi(2)).max(0.0).sqrt()).collect();
    let (excess, rate) = (excess / total, slope / total / (last - first));
    let rms = |off: &dyn Fn(usize) -> f64| {
        ((0..n).map(|i| off(i).powi(2)).sum::<f64>() / n as f64).sqrt().to_degrees()
    };
    let line = |of: &[f64], i: usize| of[i] - of[0] - (slope / total) * found.times[i];
    let centred = |of: &[f64]| {
        let mean = (0..n).map(|i| line(of, i)).sum::<f64>() / n as f64;
        rms(&|i| line(of, i) - mean)
    };
    let measured = [
        (Quantity::RateDeviation, centred(&found.angles)),
        (Quantity::ExpectedDeviation, rms(&|i| (excess * found.covariance[i * (n + 1)]).sqrt())),
        (Quantity::VarianceFactor, excess),
        (Quantity::SlowDeviation, best.1.sway.to_degrees()),
        (Quantity::SlowDuration, best.1.lasts),
        (Quantity::Jitter, best.1.jitter.to_degrees()),
        (Quantity::LogOdds, best.0 - steady),
        (Quantity::Probability, even / (even + uneven)),
        (Quantity::SmoothedDeviation, centred(&angles)),
    ]
    .map(|(quantity, value)| Measurement::new(quantity, value));
    let rate = Measurement::new(Quantity::AngularRate, rate.to_degrees());
    let decision = Decision::new(Subject::RotationRate, rate, Rule::Evidence).with_all(measured);
    Some(LearntMotion { images: images.to_vec(), angles, deviations, excess, decision })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solvers::testing::normal;
    use scene::rng::rng;

    const FRAMES: usize = 120;

    /// True angles that are seen with errors of a chain: each step has its own error of `noise`, and the sum of them
    /// is what an angle is off; half of what a closed turn leaves. `thought`: what a step's error is believed to be.
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
        learn_motion(&angles, &times, &images, &covariance, closing).unwrap()
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
            // Errors of tracks last: eight times the variance that independent ones would have.
            let (learnt, truth, _) = learn(|t| 6.0 * t, 2e-4 * EXCESS.0.sqrt(), 2e-4, 100 + seed);
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

    #[test]
    fn a_known_rate_follows_the_sense_of_the_turn() {
        let angles = [Some(0.0), None, Some(-0.2), Some(-0.31)];
        let relations = known_rate(&angles, &[0.0, 1.0, 2.0, 3.0], 0.1);
        assert_eq!(relations.len(), 2);
        assert!((relations[0].target + 0.2).abs() < 1e-12 && (relations[1].target + 0.1).abs() < 1e-12);
    }
}
