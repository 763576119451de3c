//! Similarities that fit point pairs: least squares, and least trimmed squares where some pairs are
//! wrong.

use super::{Sim3, nearest_rotation};
use crate::rng::rng;
use glam::{DMat3, DVec3};
use rand::seq::index::sample;

/// The similarity with the least `Σ |target − (s R source + t)|²`. S. Umeyama, "Least-squares
/// estimation of transformation parameters between two point patterns", PAMI 13(4), 1991 (the
/// rotation by Horn's equivalent quaternion form). `None` for fewer than 3 pairs and where all
/// source points coincide; for points on one line the rotation about it is arbitrary.
pub fn umeyama(source: &[DVec3], target: &[DVec3]) -> Option<Sim3> {
    let n = source.len();
    if n < 3 || n != target.len() {
        return None;
    }
    let [a, b] = [source, target].map(|points| points.iter().copied().sum::<DVec3>() / n as f64);
    let mut variance = 0.0;
    let mut covariance = DMat3::ZERO;
    for (s, t) in source.iter().zip(target) {
        let (x, y) = (*s - a, *t - b);
        variance += x.length_squared();
        covariance += DMat3::from_cols(y * x.x, y * x.y, y * x.z);
    }
    let rotation = nearest_rotation(covariance);
    let r = DMat3::from_quat(rotation);
    let trace =
        r.x_axis.dot(covariance.x_axis) + r.y_axis.dot(covariance.y_axis) + r.z_axis.dot(covariance.z_axis);
    let scale = trace / variance;
    let sim = Sim3 { scale, rotation, translation: b - scale * (rotation * a) };
    (variance > 0.0 && scale > 0.0 && scale.is_finite() && sim.translation.is_finite()).then_some(sim)
}

/// Share of the pairs that must fit. Source: chosen by hand, never measured.
const SHARE: f64 = 0.75;
/// Random samples of three pairs. Source: chosen by hand, never measured.
const STARTS: u64 = 500;
/// Refinements of the best of them. Source: chosen by hand, never measured.
const STEPS: usize = 30;

/// The similarity that fits three quarters of the pairs best, and which pairs it rests on.
///
/// Least trimmed squares (Rousseeuw and Van Driessen 2006): [`umeyama`] of all pairs and of 500
/// random triples, each followed by concentration steps on the best 75 %; the winner is fitted once
/// more to all pairs within three robust standard deviations. Repeatable. `None` as for
/// [`umeyama`].
pub fn robust_alignment(source: &[DVec3], target: &[DVec3]) -> Option<(Sim3, Vec<bool>)> {
    let n = source.len();
    if n < 3 || n != target.len() {
        return None;
    }
    let keep = n.min(3.max((SHARE * n as f64).ceil() as usize));
    let mut best: Option<(Sim3, f64)> = None;
    let starts = if n > 3 { STARTS } else { 0 };
    for start in 0..=starts {
        let subset: Vec<usize> = match start {
            0 => (0..n).collect(),
            _ => sample(&mut rng(0, "alignment", start), n, 3).into_vec(),
        };
        let Some((sim, cost)) = concentrate(source, target, subset, keep) else { continue };
        if best.is_none_or(|b| cost < b.1) {
            best = Some((sim, cost));
        }
    }
    let (sim, _) = best?;
    let residuals = residuals(&sim, source, target);
    let mut sorted = residuals.clone();
    sorted.sort_by(f64::total_cmp);
    let median = (sorted[(n - 1) / 2] + sorted[n / 2]) / 2.0;
    // The median length of an isotropic Gaussian residual is 1.538 σ.
    let limit = 3.0 * median.max(1e-9 * box_diagonal(target)) / 1.538 * 3.0_f64.sqrt();
    let limit = limit.max(sorted[keep - 1]);
    let inliers: Vec<bool> = residuals.iter().map(|&r| r <= limit).collect();
    let pick =
        |points: &[DVec3]| points.iter().zip(&inliers).filter(|p| *p.1).map(|p| *p.0).collect::<Vec<_>>();
    let refined = umeyama(&pick(source), &pick(target)).unwrap_or(sim);
    Some((refined, inliers))
}

/// Diagonal of the axis-parallel box around the points.
pub(super) fn box_diagonal(points: &[DVec3]) -> f64 {
    let low = points.iter().fold(DVec3::INFINITY, |a, &p| a.min(p));
    let high = points.iter().fold(DVec3::NEG_INFINITY, |a, &p| a.max(p));
    if points.is_empty() { 0.0 } else { (high - low).length() }
}

pub(super) fn residuals(sim: &Sim3, source: &[DVec3], target: &[DVec3]) -> Vec<f64> {
    source.iter().zip(target).map(|(s, t)| (sim.transform(*s) - *t).length()).collect()
}

/// Fits, keeps the `keep` best pairs, fits again until the trimmed sum of squares no longer falls.
fn concentrate(source: &[DVec3], target: &[DVec3], subset: Vec<usize>, keep: usize) -> Option<(Sim3, f64)> {
    let mut order = subset;
    let mut best: Option<(Sim3, f64)> = None;
    for _ in 0..STEPS {
        let [from, to] = [source, target].map(|points| order.iter().map(|&i| points[i]).collect::<Vec<_>>());
        let Some(sim) = umeyama(&from, &to) else { break };
        let squares: Vec<f64> = residuals(&sim, source, target).iter().map(|r| r * r).collect();
        order = (0..source.len()).collect();
        order.select_nth_unstable_by(keep - 1, |&i, &j| squares[i].total_cmp(&squares[j]).then(i.cmp(&j)));
        order.truncate(keep);
        let cost: f64 = order.iter().map(|&i| squares[i]).sum();
        if best.is_some_and(|b| cost >= b.1 * (1.0 - 1e-12)) {
            break;
        }
        best = Some((sim, cost));
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::rotation_angle;
    use glam::DQuat;
    use rand::Rng;

    fn case(seed: u64, n: usize, scale: f64) -> (Vec<DVec3>, Vec<DVec3>, Sim3) {
        let mut r = rng(seed, "case", 0);
        let mut v = || r.random_range(-1.0..1.0);
        let rotation = DQuat::from_xyzw(v(), v(), v(), v()).normalize();
        let sim = Sim3 { scale, rotation, translation: DVec3::new(v(), v(), v()) * 10.0 * scale };
        let source: Vec<DVec3> = (0..n).map(|_| DVec3::new(v(), v(), v())).collect();
        let target = source.iter().map(|&x| sim.transform(x)).collect();
        (source, target, sim)
    }

    fn same(a: &Sim3, b: &Sim3, tolerance: f64) -> bool {
        (a.scale / b.scale - 1.0).abs() < tolerance
            && rotation_angle(a.rotation, b.rotation) < tolerance
            && (a.translation - b.translation).length() < tolerance * (b.scale + b.translation.length())
    }

    #[test]
    fn an_exact_similarity_is_recovered_from_1e_minus_6_to_1e6() {
        for seed in 0..100 {
            for scale in [1e-6, 1.0, 1e6] {
                let (source, target, sim) = case(seed, 3 + seed as usize % 5, scale);
                assert!(same(&umeyama(&source, &target).unwrap(), &sim, 1e-11), "seed {seed}, scale {scale}");
            }
        }
    }

    #[test]
    fn a_fifth_of_wild_pairs_does_not_move_the_alignment() {
        for seed in 0..10 {
            let (source, mut target, sim) = case(seed, 20, 3.0);
            for t in target.iter_mut().step_by(5) {
                *t += DVec3::new(50.0, -20.0, 9.0);
            }
            let (found, inliers) = robust_alignment(&source, &target).unwrap();
            assert!(same(&found, &sim, 1e-11), "seed {seed}");
            assert!(inliers.iter().enumerate().all(|(i, &fits)| fits == (i % 5 != 0)), "seed {seed}");
        }
    }

    #[test]
    fn degenerate_pairs_have_no_alignment_or_a_finite_one() {
        let p = [DVec3::ONE; 5];
        assert!(umeyama(&p, &p).is_none() && robust_alignment(&p, &p).is_none());
        assert!(umeyama(&p[..2], &p[..2]).is_none() && robust_alignment(&[], &[]).is_none());
        let line: Vec<DVec3> = (0..5).map(|i| DVec3::X * f64::from(i)).collect();
        let found = umeyama(&line, &line).unwrap();
        assert!(residuals(&found, &line, &line).iter().all(|&r| r < 1e-12));
        let nan = [DVec3::NAN; 5];
        assert!(robust_alignment(&nan, &line).is_none());
    }

    #[test]
    fn moving_a_pose_moves_its_centre_and_turns_it() {
        let (_, _, sim) = case(7, 3, 2.5);
        let pose = crate::Pose::look_at(DVec3::new(1.0, 2.0, 3.0), DVec3::ZERO, DVec3::Z);
        let moved = sim.transform_pose(&pose);
        let x = DVec3::new(0.3, -0.2, 0.9);
        assert!((moved.transform(sim.transform(x)) - sim.scale * pose.transform(x)).length() < 1e-12);
        assert!(same(&sim.compose(&sim.inverse()), &Sim3::IDENTITY, 1e-12));
    }
}
