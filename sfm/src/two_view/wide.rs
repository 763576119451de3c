//! A second look at pairs that did not pass, once the intrinsics are known: fewer matches are
//! enough then.

use super::chance::{Constraint, log10_false_alarms};
use super::config::TwoViewConfig;
use super::correspondences::Correspondences;
use super::pose::{best_pose, median_angle};
use crate::error::SfmError;
use crate::matching::{MatchConfig, PreparedSet, match_prepared};
use crate::ransac::{EssentialEstimator, Estimator, RansacConfig, ransac};
use crate::solvers::sampson_sq;
use rayon::prelude::*;
use scene::{Camera, Features, Progress, TwoViewGeometry, TwoViewKind};

/// Ratio of distances of descriptors that views from afar still keep.
/// Source: judgement: looser than the 0.8 of Lowe 2004, as verification follows.
const WIDE_RATIO: f32 = 0.87;
/// Distance of descriptors that they keep.
/// Source: judgement: looser than near matches, as verification follows.
const WIDE_DISTANCE: f32 = 0.8;

/// Matches `pairs` loosely and keeps those that one motion of the solved cameras explains beyond
/// chance: with half of the error that is allowed elsewhere, as known intrinsics make the model
/// exact, and with as few false alarms over all pairs as are allowed elsewhere for one
/// (Bonferroni), as most of them show different places. `cameras`: one a frame. The same for any
/// number of threads.
pub(crate) fn second_look(
    features: &[Features],
    cameras: &[Camera],
    pairs: &[(usize, usize)],
    (matching, verification): (&MatchConfig, &TwoViewConfig),
    seed: u64,
    progress: &Progress,
) -> Result<Vec<TwoViewGeometry>, SfmError> {
    progress.begin("wide pairs", pairs.len());
    let prepared = PreparedSet::new(features);
    let loose = MatchConfig {
        match_ratio: WIDE_RATIO.max(matching.match_ratio),
        match_max_distance: WIDE_DISTANCE.max(matching.match_max_distance),
        ..matching.clone()
    };
    let strict = TwoViewConfig {
        max_error_px: verification.max_error_px / 2.0,
        max_log10_false_alarms: verification.max_log10_false_alarms - (pairs.len() as f64).log10(),
        ..verification.clone()
    };
    let found = pairs.par_iter().map(|&(a, b)| {
        progress.tick()?;
        let (Some(in_a), Some(in_b)) = (prepared.get(a), prepared.get(b)) else { return Ok(None) };
        let matches = match_prepared(&in_a, &in_b, &loose);
        let all = Correspondences::new(&features[a], &features[b], &cameras[a], &cameras[b], &matches);
        Ok(verify_wide(a, b, &all, &strict, seed))
    });
    let found: Result<Vec<Option<TwoViewGeometry>>, SfmError> = found.collect();
    Ok(found?.into_iter().flatten().collect())
}

fn verify_wide(
    a: usize,
    b: usize,
    all: &Correspondences,
    strict: &TwoViewConfig,
    seed: u64,
) -> Option<TwoViewGeometry> {
    let limit = strict.max_error_px;
    let estimator = EssentialEstimator::new(all.a.clone(), all.b.clone(), all.focal, 0.5 * limit);
    // As many as were drawn for the model must agree with it.
    let fewest = 2 * estimator.sample_size();
    let config = RansacConfig {
        threshold: limit,
        min_inliers: fewest.max(all.len() / 5),
        max_iterations: 5000,
        seed,
        best_first: all.best_first,
        ..RansacConfig::default()
    };
    let stream = ((a as u64) << 32) ^ b as u64;
    let found = ransac(&estimator, &config, stream)?;
    let squared: Vec<f64> = (0..all.len()).map(|i| sampson_sq(&found.model.f, all.a[i], all.b[i])).collect();
    let alarms = log10_false_alarms(&squared, &all.b, Constraint::Line, 5, 10.0, limit);
    let pose = best_pose(all, &found.inliers, &[found.model.e], None, limit)?;
    // What does not move at all is no view from afar.
    let moving = found.inliers.iter().filter(|&&i| all.displacement(i) > 4.0 * strict.static_px);
    if alarms > strict.max_log10_false_alarms || moving.count() < fewest {
        return None;
    }
    let mut inliers: Vec<[u32; 2]> = found.inliers.iter().map(|&i| all.matches[i]).collect();
    inliers.sort_unstable();
    Some(TwoViewGeometry {
        a,
        b,
        kind: TwoViewKind::Calibrated,
        inliers,
        f: Some(all.ideal_to_pixels(&found.model.f)),
        e: Some(found.model.e),
        h: None,
        b_from_a: Some(pose),
        median_angle: median_angle(&pose, all, &found.inliers),
    })
}
