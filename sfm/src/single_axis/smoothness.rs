//! What is known of the angles of a video beside its pictures: a given rate, or that the rate changes little, as little
//! as the angles themselves say.

use super::problem::{Relation, TurnCovariance};
use crate::Decision;

/// Fewest frames from which the strength of the prior is learnt.
const FEWEST: usize = 10;
/// Standard deviations of the bend that are compared, radians: the least, and how many doublings.
const STRENGTHS: (f64, i32) = (2e-6, 14);
/// Factors on the angles' covariance that are compared: errors of one track in many frames are not independent.
const EXCESS: [f64; 7] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];

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

/// What the angles that were found without a prior say of the motion.
///
/// Two motions are compared by how likely they make the angles' bends b (each angle against the one that its neighbours
/// give by time), `b ~ N(0, κ D C Dᵀ + s² P)` with the angles' covariance C: a steady rate with jitter, `P = D Dᵀ`, and a
/// rate that wanders, `P = I` (type II maximum likelihood, MacKay 1992). C is known up to a factor κ, which is found
/// with s: noise and motion have different spectra. `None` where there are too few frames.
pub(crate) fn learnt(
    angles: &[Option<f64>],
    times: &[f64],
    images: &[usize],
    covariance: &TurnCovariance,
) -> Option<(Vec<Relation>, Decision)> {
    let n = images.len();
    if n < FEWEST || covariance.joint.len() != n * n {
        return None;
    }
    let found: Vec<f64> = images.iter().map(|&f| angles[f].unwrap_or(0.0)).collect();
    let when: Vec<f64> = images.iter().map(|&f| times[f]).collect();
    let rows: Vec<[f64; 3]> = when
        .windows(3)
        .map(|t| (t[1] - t[0]) / (t[2] - t[0]))
        .map(|share| [share - 1.0, 1.0, -share])
        .collect();
    let bends: Vec<f64> =
        rows.iter().zip(found.windows(3)).map(|(c, w)| (0..3).map(|k| c[k] * w[k]).sum()).collect();
    let of_noise = bend_covariance(&rows, |i, k| covariance.joint[i * n + k]);
    let jitter = bend_covariance(&rows, |i, k| f64::from(u8::from(i == k)));
    let m = bends.len();
    let wander: Vec<f64> = (0..m * m).map(|k| f64::from(u8::from(k % (m + 1) == 0))).collect();
    let mut best: Option<(f64, bool, f64, f64)> = None;
    for (steady, motion) in [(true, &jitter), (false, &wander)] {
        for excess in EXCESS {
            for s in (0..=STRENGTHS.1).map(|k| STRENGTHS.0 * f64::from(1 << k)) {
                let sum: Vec<f64> =
                    of_noise.iter().zip(motion).map(|(a, p)| excess * a + s * s * p).collect();
                let Some(likely) = log_likelihood(sum, &bends) else { continue };
                if best.is_none_or(|(l, ..)| likely > l) {
                    best = Some((likely, steady, excess, s));
                }
            }
        }
    }
    let (_, steady, excess, s) = best?;
    // The sightings weigh by their own noise, so the prior does by the same measure.
    let sigma = s / excess.sqrt();
    let relations = if steady {
        let joint: Vec<f64> = covariance.joint.iter().map(|c| c * excess).collect();
        steady_relations(&found, &when, images, joint, s, sigma)?
    } else {
        let relation = |(c, f): (&[f64; 3], &[usize])| Relation {
            frames: [0, 1, 2].map(|k| Some(f[k] as u32)),
            coefficients: *c,
            target: 0.0,
            sigma,
        };
        rows.iter().zip(images.windows(3)).map(relation).collect()
    };
    let rms = |sum: f64| (sum / m as f64).sqrt().to_degrees();
    let evidence = format!(
        "each angle is {:.4}° off what its neighbours give, {:.4}° would come from independent noise alone; variance of the noise × {excess}",
        rms(bends.iter().map(|b| b * b).sum()),
        rms((0..m).map(|i| of_noise[i * m + i]).sum()),
    );
    let chosen = match steady {
        true => format!("steady, jitter of {:.4}°", s.to_degrees()),
        false => format!("rate wanders, bends of {:.4}° a frame", s.to_degrees()),
    };
    Some((relations, Decision { what: "rate of the turn".to_owned(), chosen, evidence }))
}

/// Every angle against the line through all of them, `θ = α + ω t`, fitted under their covariance and the jitter.
fn steady_relations(
    found: &[f64],
    when: &[f64],
    images: &[usize],
    mut joint: Vec<f64>,
    jitter: f64,
    sigma: f64,
) -> Option<Vec<Relation>> {
    let n = found.len();
    (0..n).for_each(|i| joint[i * (n + 1)] += jitter * jitter);
    let l = cholesky(joint, n)?;
    let since: Vec<f64> = when.iter().map(|t| t - when[0]).collect();
    let [one, time, angle] = [&vec![1.0; n], &since, &found.to_vec()].map(|v| whiten(&l, v));
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let (a, b, c) = (dot(&one, &one), dot(&one, &time), dot(&time, &time));
    let (p, q) = (dot(&one, &angle), dot(&time, &angle));
    let determinant = a * c - b * b;
    let (alpha, rate) = ((c * p - b * q) / determinant, (a * q - b * p) / determinant);
    if !(alpha.is_finite() && rate.is_finite()) {
        return None;
    }
    let relation = |i: usize| Relation {
        frames: [Some(images[0] as u32), Some(images[i] as u32), None],
        coefficients: [-1.0, 1.0, 0.0],
        target: alpha + rate * since[i] - found[0],
        sigma,
    };
    Some((1..n).map(relation).collect())
}

/// `D A Dᵀ`; row i of D has three coefficients from column i on.
fn bend_covariance(rows: &[[f64; 3]], a: impl Fn(usize, usize) -> f64) -> Vec<f64> {
    let m = rows.len();
    let term = |i: usize, k: usize| -> f64 {
        let products = (0..9).map(|j| rows[i][j / 3] * rows[k][j % 3] * a(i + j / 3, k + j % 3));
        products.sum()
    };
    (0..m * m).map(|k| term(k / m, k % m)).collect()
}

/// `−½ (ln |S| + bᵀ S⁻¹ b)`; `None` where S is not positive definite.
fn log_likelihood(s: Vec<f64>, b: &[f64]) -> Option<f64> {
    let n = b.len();
    let l = cholesky(s, n)?;
    let whitened = whiten(&l, b);
    let logs: f64 = (0..n).map(|i| 2.0 * l[i * (n + 1)].ln()).sum();
    Some(-0.5 * (logs + whitened.iter().map(|v| v * v).sum::<f64>()))
}

/// Cholesky's lower factor of a symmetric matrix (what is above its diagonal has no meaning).
fn cholesky(mut s: Vec<f64>, n: usize) -> Option<Vec<f64>> {
    for i in 0..n {
        for k in 0..=i {
            let (a, b) = (&s[i * n..i * n + k], &s[k * n..k * n + k]);
            let rest = s[i * n + k] - a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
            s[i * n + k] = match i == k {
                true if !(rest > 0.0) => return None,
                true => rest.sqrt(),
                false => rest / s[k * n + k],
            };
        }
    }
    Some(s)
}

/// `L⁻¹ v`.
fn whiten(l: &[f64], v: &[f64]) -> Vec<f64> {
    let n = v.len();
    let mut out: Vec<f64> = Vec::with_capacity(n);
    for i in 0..n {
        let dot: f64 = l[i * n..i * n + i].iter().zip(&out).map(|(a, b)| a * b).sum();
        out.push((v[i] - dot) / l[i * n + i]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solvers::testing::normal;
    use scene::rng::rng;

    /// Angles whose rate wanders by `bend` a frame about a steady one, with independent `jitter`, measured with
    /// independent errors of `noise` where `thought` is what they are believed to be.
    fn learn(bend: f64, jitter: f64, noise: f64, thought: f64, seed: u64) -> (Vec<Relation>, Decision) {
        let mut r = rng(seed, "rate", 0);
        let (mut angle, mut rate) = (0.0, 0.05);
        let angles: Vec<Option<f64>> = (0..120)
            .map(|_| {
                angle += rate;
                rate += 2.0 * bend * normal(&mut r); // a bend is half a second difference
                Some(angle + jitter * normal(&mut r) + noise * normal(&mut r))
            })
            .collect();
        let times: Vec<f64> = (0..120).map(f64::from).collect();
        let images: Vec<usize> = (0..120).collect();
        let mut joint = vec![0.0; 120 * 120];
        (0..120).for_each(|i| joint[i * 121] = thought * thought);
        let covariance = TurnCovariance { joint, ..TurnCovariance::default() };
        learnt(&angles, &times, &images, &covariance).unwrap()
    }

    #[test]
    fn a_wandering_rate_is_told_from_noise() {
        for seed in 0..3 {
            let (relations, decision) = learn(2e-3, 0.0, 1e-4, 1e-4, seed);
            let sigma = relations[0].sigma;
            assert!(decision.chosen.starts_with("rate wanders"), "{decision:?}");
            assert!((0.5e-3..4e-3).contains(&sigma), "{sigma}");
        }
    }

    #[test]
    fn a_steady_rate_is_found_through_noise_that_is_larger_than_thought() {
        for (seed, thought) in [(0, 1e-3), (1, 1e-3), (2, 3e-4)] {
            let (relations, decision) = learn(0.0, 1e-5, 1e-3, thought, seed);
            let worst = relations.iter().zip(1..).map(|(r, i)| r.target - 0.05 * f64::from(i));
            let spread = worst.clone().fold(f64::MIN, f64::max) - worst.fold(f64::MAX, f64::min);
            assert!(relations[0].sigma < 6e-4, "{decision:?}");
            assert!(!decision.chosen.starts_with("steady") || spread < 1e-3, "{spread} {decision:?}");
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
