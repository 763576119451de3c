//! What verified pairs say about a focal length that was only guessed.

use super::correspondences::Correspondences;
use crate::solvers::{Pairs, essential_from_pose, pose_from_essential, refine_relative, sampson_sq};
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use scene::{Camera, Features, TwoViewGeometry, TwoViewKind};

/// The pairs that are asked at most, the ones with most parallax and inliers first.
/// Source: chosen by hand for the time that it takes.
const MOST_PAIRS: usize = 80;
/// Matches of a pair that are used at most.
/// Source: chosen by hand for the time that it takes.
const MOST_MATCHES: usize = 200;

/// How well the pairs agree with focal lengths of `factors` times those of `cameras`: for each
/// factor the mean robust epipolar error of the best relative poses (Cauchy's loss of width 1 px,
/// pixels squared; smaller is better). A pair of views whose axes meet says little by itself (Sturm
/// 2001), many together say more; where the curve is flat nothing is known. Empty where no pair can
/// be asked.
pub fn focal_evidence(
    features: &[Features],
    cameras: &[Camera],
    geometries: &[TwoViewGeometry],
    factors: &[f64],
) -> Vec<f64> {
    let known = features.len().min(cameras.len());
    let asked = |g: &&TwoViewGeometry| {
        let epipolar = matches!(g.kind, TwoViewKind::Calibrated | TwoViewKind::Uncalibrated);
        epipolar && g.f.is_some() && g.a < known && g.b < known && g.inliers.len() >= 20
    };
    let mut pairs: Vec<&TwoViewGeometry> = geometries.iter().filter(asked).collect();
    let weight =
        |g: &TwoViewGeometry| g.median_angle.min(0.3) * (g.inliers.len().min(MOST_MATCHES) as f64).sqrt();
    pairs.sort_by(|g, h| weight(h).total_cmp(&weight(g)).then((g.a, g.b).cmp(&(h.a, h.b))));
    pairs.truncate(MOST_PAIRS);
    if pairs.is_empty() {
        return Vec::new();
    }
    let costs: Vec<Vec<f64>> = pairs
        .par_iter()
        .map(|g| {
            let step = g.inliers.len().div_ceil(MOST_MATCHES);
            let some: Vec<[u32; 2]> = g.inliers.iter().copied().step_by(step).collect();
            let all =
                Correspondences::new(&features[g.a], &features[g.b], &cameras[g.a], &cameras[g.b], &some);
            factors.iter().map(|factor| pair_cost(&all, g.f.unwrap_or_default(), *factor)).collect()
        })
        .collect();
    (0..factors.len()).map(|k| costs.iter().map(|c| c[k]).sum::<f64>() / pairs.len() as f64).collect()
}

/// Mean Cauchy loss of the best pose at this multiple of the focal lengths. `f`: fundamental
/// matrix, pixels.
fn pair_cost(all: &Correspondences, f: DMat3, factor: f64) -> f64 {
    let focal = all.focal.map(|x| x * factor);
    let k = [0, 1]
        .map(|i| DMat3::from_cols(DVec3::X * focal[i], DVec3::Y * focal[i], all.principal[i].extend(1.0)));
    let rays: Vec<(DVec3, DVec3)> = (0..all.len())
        .map(|i| ((all.a[i] / focal[0]).extend(1.0), (all.b[i] / focal[1]).extend(1.0)))
        .collect();
    let worst = 4.0_f64.ln_1p();
    let Some((pose, _)) = pose_from_essential(&(k[1].transpose() * f * k[0]), &rays) else { return worst };
    let indices: Vec<usize> = (0..all.len()).collect();
    let pose = refine_relative(&pose, focal, Pairs { a: &all.a, b: &all.b, indices: &indices }, 1.0, 15);
    let inverse = focal.map(|f| DMat3::from_diagonal(DVec3::new(1.0 / f, 1.0 / f, 1.0)));
    let m = inverse[1] * essential_from_pose(&pose) * inverse[0];
    let loss: f64 = indices.iter().map(|&i| sampson_sq(&m, all.a[i], all.b[i]).ln_1p()).sum();
    loss / all.len().max(1) as f64
}
