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

/// A prior on the bend of the angles (each against the one that its neighbours give by time), with the strength under
/// which the angles found without it are most likely: `D θ̂ ~ N(0, κ D C Dᵀ + q I)` with the angles' covariance C and the
/// bends' variance q (type II maximum likelihood, MacKay 1992). C is known up to a factor, which is found with q: noise of
/// the angles and changes of the rate have different spectra. `None` where there are too few frames.
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
    let mut rows: Vec<(usize, [f64; 3])> = Vec::new();
    let mut relations = Vec::new();
    let mut bends = Vec::new();
    for i in 0..n - 2 {
        let f = [images[i], images[i + 1], images[i + 2]];
        let share = (times[f[1]] - times[f[0]]) / (times[f[2]] - times[f[0]]);
        let coefficients = [share - 1.0, 1.0, -share];
        bends.push((0..3).map(|k| coefficients[k] * angles[f[k]].unwrap_or(0.0)).sum::<f64>());
        rows.push((i, coefficients));
        let frames = f.map(|f| Some(f as u32));
        relations.push(Relation { frames, coefficients, target: 0.0, sigma: 1.0 });
    }
    let of_bends = bend_covariance(&rows, &covariance.joint, n);
    let strengths = || (0..=STRENGTHS.1).map(|k| STRENGTHS.0 * f64::from(1 << k));
    let candidates = EXCESS.iter().flat_map(|&excess| strengths().map(move |s| (excess, s)));
    let scored = candidates
        .filter_map(|(excess, s)| Some((log_likelihood(&of_bends, &bends, excess, s * s)?, excess, s)));
    let (_, excess, bend) = scored.max_by(|a, b| a.0.total_cmp(&b.0))?;
    // The sightings weigh by their own noise, so the prior does by the same measure.
    relations.iter_mut().for_each(|r| r.sigma = bend / excess.sqrt());
    let rms = |values: f64| (values / bends.len() as f64).sqrt().to_degrees();
    let evidence = format!(
        "each angle is {:.4}° off what its neighbours give, {:.4}° would come from independent noise alone; variance of the noise × {excess}",
        rms(bends.iter().map(|b| b * b).sum()),
        rms((0..bends.len()).map(|i| of_bends[i * bends.len() + i]).sum()),
    );
    let chosen = format!("bends of {:.4}° a frame expected", bend.to_degrees());
    Some((relations, Decision { what: "smoothness of the turn".to_owned(), chosen, evidence }))
}

/// `D C Dᵀ`; row i of D has three coefficients from column `rows[i].0` on.
fn bend_covariance(rows: &[(usize, [f64; 3])], joint: &[f64], n: usize) -> Vec<f64> {
    let m = rows.len();
    let mut out = vec![0.0; m * m];
    for (i, (at, c)) in rows.iter().enumerate() {
        for (k, (to, d)) in rows.iter().enumerate() {
            let term = |a: usize, b: usize| c[a] * d[b] * joint[(at + a) * n + to + b];
            out[i * m + k] = (0..3).map(|a| (0..3).map(|b| term(a, b)).sum::<f64>()).sum();
        }
    }
    out
}

/// `−½ (ln |S| + bᵀ S⁻¹ b)` of `S = κ A + q I`, by Cholesky's factors; `None` where S is not positive definite.
fn log_likelihood(a: &[f64], b: &[f64], excess: f64, q: f64) -> Option<f64> {
    let n = b.len();
    let mut l: Vec<f64> = a.iter().map(|v| v * excess).collect();
    (0..n).for_each(|i| l[i * n + i] += q);
    let mut whitened = b.to_vec();
    let mut sum = 0.0;
    for i in 0..n {
        for k in 0..=i {
            let dot: f64 = l[i * n..i * n + k].iter().zip(&l[k * n..k * n + k]).map(|(x, y)| x * y).sum();
            let rest = l[i * n + k] - dot;
            if i == k {
                if !(rest > 0.0) {
                    return None;
                }
                l[i * n + i] = rest.sqrt();
            } else {
                l[i * n + k] = rest / l[k * n + k];
            }
        }
        let dot: f64 = (0..i).map(|j| l[i * n + j] * whitened[j]).sum();
        whitened[i] = (whitened[i] - dot) / l[i * n + i];
        sum += 2.0 * l[i * n + i].ln() + whitened[i] * whitened[i];
    }
    Some(-0.5 * sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solvers::testing::normal;
    use scene::rng::rng;

    /// Angles whose rate wanders by `bend` a frame, measured with independent errors of `noise`.
    fn learn(bend: f64, noise: f64, thought: f64, seed: u64) -> f64 {
        let mut r = rng(seed, "rate", 0);
        let (mut angle, mut rate) = (0.0, 0.05);
        let angles: Vec<Option<f64>> = (0..150)
            .map(|_| {
                angle += rate;
                rate += 2.0 * bend * normal(&mut r); // a bend is half a second difference
                Some(angle + noise * normal(&mut r))
            })
            .collect();
        let times: Vec<f64> = (0..150).map(f64::from).collect();
        let images: Vec<usize> = (0..150).collect();
        let mut joint = vec![0.0; 150 * 150];
        (0..150).for_each(|i| joint[i * 151] = thought * thought);
        let covariance = TurnCovariance { joint, ..TurnCovariance::default() };
        learnt(&angles, &times, &images, &covariance).unwrap().0[0].sigma
    }

    #[test]
    fn the_strength_of_the_prior_is_that_of_the_motion_and_not_of_the_noise() {
        for seed in 0..5 {
            let wild = learn(2e-3, 1e-4, 1e-4, seed);
            assert!((0.5e-3..4e-3).contains(&wild), "{wild}");
            let noisy = learn(2e-5, 1e-3, 1e-3, seed);
            assert!(noisy < 1.5e-4, "{noisy}");
            let noisier = learn(2e-5, 1e-3, 3e-4, seed);
            assert!(noisier < 1.5e-4, "{noisier}: the noise is three times what was thought");
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
