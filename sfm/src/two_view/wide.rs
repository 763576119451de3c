//! A second look at pairs that did not pass, once the intrinsics are known: fewer matches are
//! enough then.

use super::chance::{Constraint, log10_false_alarms};
use super::config::TwoViewConfig;
use super::correspondences::Correspondences;
use super::pose::{best_pose, median_angle};
use crate::SfmError;
use crate::matching::{MatchConfig, PreparedFeatures, match_prepared};
use crate::ransac::{EssentialEstimator, RansacConfig, ransac};
use crate::solvers::sampson_sq;
use rayon::prelude::*;
use scene::{Camera, Features, Progress, TwoViewGeometry, TwoViewKind};

/// Ratio of distances of descriptors that views from afar still keep.
/// Source: chosen by hand, never measured.
const WIDE_RATIO: f32 = 0.87;
/// Distance of descriptors that they keep.
/// Source: chosen by hand, never measured.
const WIDE_DISTANCE: f32 = 0.8;
/// Fewest matches that may agree.
/// Source: chosen by hand, never measured.
const WIDE_INLIERS: usize = 10;
/// Largest epipolar error, pixels: with known intrinsics the model is exact.
/// Source: chosen by hand, never measured.
const WIDE_ERROR_PX: f64 = 2.0;
/// Random matches would agree as well less often than 10 to this power: most pairs looked at show
/// different places.
/// Source: chosen by hand, never measured.
const WIDE_LOG10_FALSE_ALARMS: f64 = -5.0;

/// Matches `pairs` loosely and keeps those that one motion of the solved cameras explains beyond
/// chance. `cameras`: one a frame. The same for any number of threads.
pub(crate) fn second_look(
    features: &[Features],
    cameras: &[Camera],
    pairs: &[(usize, usize)],
    matching: &MatchConfig,
    seed: u64,
    progress: &Progress,
) -> Result<Vec<TwoViewGeometry>, SfmError> {
    progress.begin("wide pairs", pairs.len());
    let prepared: Vec<PreparedFeatures> = features.par_iter().map(PreparedFeatures::new).collect();
    let loose = MatchConfig {
        match_ratio: WIDE_RATIO.max(matching.match_ratio),
        match_max_distance: WIDE_DISTANCE.max(matching.match_max_distance),
        ..matching.clone()
    };
    let one = |&(a, b): &(usize, usize)| {
        progress.tick()?;
        let matches = match_prepared(&prepared[a], &prepared[b], &loose);
        let all = Correspondences::new(&features[a], &features[b], &cameras[a], &cameras[b], &matches);
        Ok(verify_wide(a, b, &all, seed))
    };
    let found: Result<Vec<Option<TwoViewGeometry>>, SfmError> = pairs.par_iter().map(one).collect();
    Ok(found?.into_iter().flatten().collect())
}

fn verify_wide(a: usize, b: usize, all: &Correspondences, seed: u64) -> Option<TwoViewGeometry> {
    let still = TwoViewConfig::default().static_px;
    let config = RansacConfig {
        threshold: WIDE_ERROR_PX,
        min_inliers: WIDE_INLIERS.max(all.len() / 5),
        max_iterations: 5000,
        seed,
        best_first: all.best_first,
        ..RansacConfig::default()
    };
    let estimator = EssentialEstimator::new(all.a.clone(), all.b.clone(), all.focal, 0.5 * WIDE_ERROR_PX);
    let stream = ((a as u64) << 32) ^ b as u64;
    let found = ransac(&estimator, &config, stream)?;
    let squared: Vec<f64> = (0..all.len()).map(|i| sampson_sq(&found.model.f, all.a[i], all.b[i])).collect();
    let alarms = log10_false_alarms(&squared, &all.b, Constraint::Line, 5, 10.0, WIDE_ERROR_PX);
    let pose = best_pose(all, &found.inliers, &[found.model.e], None, WIDE_ERROR_PX)?;
    // What does not move at all is no view from afar.
    let moving = found.inliers.iter().filter(|&&i| all.displacement(i) > 4.0 * still);
    if alarms > WIDE_LOG10_FALSE_ALARMS || moving.count() < WIDE_INLIERS {
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
