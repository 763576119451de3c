//! Geometric verification of image pairs: which matches agree with one rigid motion, and which.
//!
//! ```
//! use scene::{Camera, CameraModel, Features, Keypoint, Progress, TwoViewKind};
//! use sfm::two_view::{TwoViewConfig, verify_pairs};
//!
//! // Points of a grid in space, seen from two places side by side.
//! let camera = Camera::centred(1, CameraModel::SimplePinhole, 640, 480, 500.0);
//! let view = |x0: f32| {
//!     let keypoints = (0..64).map(|i| {
//!         let (x, y, z) = ((i % 4) as f32 - 1.5, (i / 4 % 4) as f32 - 1.5, 4.0 + (i / 16) as f32);
//!         let (x, y) = (500.0 * (x - x0) / z + 320.0, 500.0 * y / z + 240.0);
//!         Keypoint { x, y, scale: 2.0, angle: 0.0 }
//!     });
//!     Features { keypoints: keypoints.collect(), descriptors: Vec::new() }
//! };
//! let matches = vec![(0, 1, (0..64).map(|i| [i, i]).collect())];
//! let cameras = [camera.clone(), camera];
//! let config = TwoViewConfig::default();
//! let pairs = verify_pairs(&[view(0.0), view(0.5)], &cameras, matches, &config, 0,
//! &Progress::silent())?;
//! assert_eq!((pairs[0].kind, pairs[0].inliers.len()), (TwoViewKind::Calibrated, 64));
//! # Ok::<(), sfm::SfmError>(())
//! ```

mod chance;
mod config;
mod correspondences;
mod gric;
mod models;
mod pose;
mod static_matches;
mod wide;

pub use config::TwoViewConfig;
pub(crate) use wide::second_look;

use crate::error::SfmError;
use crate::matching::{MatchConfig, PreparedSet, guided_match_prepared};
use crate::solvers::{sampson_sq, transfer_sq};
use correspondences::Correspondences;
use models::TwoViewModels;
use rayon::prelude::*;
use scene::{Camera, Features, Progress, TwoViewGeometry, TwoViewKind};
use static_matches::StaticMatches;

/// Finds the motion that explains the matches of images `a` and `b`: an essential matrix where the
/// focal lengths can be trusted as far as this pair tells (it keeps at least 95 % of the
/// fundamental matrix's inliers), else a fundamental matrix; a homography where that is the better
/// description (a plane, or a rotation without baseline). Matches that stay in place while others
/// move (watermark, dust, the background of a turntable) are dropped; where nothing else agrees the
/// pair is a [`TwoViewKind::Watermark`]. Matches that are not finite, out of range or not
/// one-to-one are dropped. All matrices refer to ideal (undistorted) pixels.
/// [`TwoViewKind::Degenerate`] with no inliers where nothing is found.
#[allow(clippy::too_many_arguments)] // two of everything
pub(crate) fn verify_pair(
    a: usize,
    b: usize,
    features_a: &Features,
    features_b: &Features,
    camera_a: &Camera,
    camera_b: &Camera,
    matches: &[[u32; 2]],
    config: &TwoViewConfig,
    seed: u64,
) -> TwoViewGeometry {
    let none = TwoViewGeometry {
        a,
        b,
        kind: TwoViewKind::Degenerate,
        inliers: Vec::new(),
        f: None,
        e: None,
        h: None,
        b_from_a: None,
        median_angle: 0.0,
    };
    let all = Correspondences::new(features_a, features_b, camera_a, camera_b, matches);
    let parts = StaticMatches::of(&all, config);
    if !parts.suspicious {
        return find_motion(&all, &none, config, seed).unwrap_or(none);
    }
    // The static matches agree with each other perfectly and would win: only what moves is asked.
    if let Some(moving) = find_motion(&all.subset(&parts.moving), &none, config, seed) {
        return moving;
    }
    if parts.still.len() < config.min_inliers {
        return none;
    }
    let inliers = parts.still.iter().map(|&i| all.matches[i]).collect();
    TwoViewGeometry { kind: TwoViewKind::Watermark, inliers, ..none }
}

/// The motion that explains matches beyond chance. `none`: what the pair is without one.
fn find_motion(
    all: &Correspondences,
    none: &TwoViewGeometry,
    config: &TwoViewConfig,
    seed: u64,
) -> Option<TwoViewGeometry> {
    if all.len() < config.min_inliers.max(8) {
        return None;
    }
    let models = TwoViewModels::find(all, config, seed, ((none.a as u64) << 32) ^ none.b as u64)?;
    let alarms = models.log10_false_alarms(all, config.max_error_px);
    let chosen = (alarms < config.max_log10_false_alarms).then(|| models.choose(all, config, none.clone()));
    chosen.filter(|g| g.kind != TwoViewKind::Degenerate)
}

/// Adds matches found later (along epipolar lines, say) to a verified pair: those that fit its
/// model within the error bound are verified anew together with the old inliers. The old geometry
/// where that loses inliers.
pub(crate) fn merge_guided(
    geometry: &TwoViewGeometry,
    features: [&Features; 2],
    cameras: [&Camera; 2],
    more: &[[u32; 2]],
    config: &TwoViewConfig,
    seed: u64,
) -> TwoViewGeometry {
    let limit = config.max_error_px * config.max_error_px;
    let mut union = geometry.inliers.clone();
    for &[i, j] in more {
        let (Some(p), Some(q)) =
            (features[0].keypoints.get(i as usize), features[1].keypoints.get(j as usize))
        else {
            continue;
        };
        let p = cameras[0].unproject(p.position()) * cameras[0].focal() + cameras[0].principal_point();
        let q = cameras[1].unproject(q.position()) * cameras[1].focal() + cameras[1].principal_point();
        let error_sq = match (geometry.f, geometry.h) {
            (Some(f), _) => sampson_sq(&f, p, q),
            (None, Some(h)) => transfer_sq(&h, p, q),
            (None, None) => f64::INFINITY,
        };
        if error_sq < limit {
            union.push([i, j]);
        }
    }
    let (a, b) = (geometry.a, geometry.b);
    let merged = verify_pair(a, b, features[0], features[1], cameras[0], cameras[1], &union, config, seed);
    if merged.inliers.len() >= geometry.inliers.len() { merged } else { geometry.clone() }
}

/// Seeks more matches of verified pairs along their epipolar lines, over all threads; `wanted` says
/// of which pairs. The same for any number of threads.
pub(crate) fn match_along_lines(
    features: &[Features],
    cameras: &[Camera],
    geometries: Vec<TwoViewGeometry>,
    (matching, verification): (&MatchConfig, &TwoViewConfig),
    wanted: impl Fn(&TwoViewGeometry) -> bool + Sync,
    seed: u64,
    progress: &Progress,
) -> Result<Vec<TwoViewGeometry>, SfmError> {
    if !geometries.iter().any(&wanted) {
        return Ok(geometries);
    }
    progress.begin("guided matching", geometries.len());
    let prepared = PreparedSet::new(features);
    let pairs = geometries.into_par_iter();
    let merged = pairs.map(|g| {
        progress.tick()?;
        let epipolar = matches!(g.kind, TwoViewKind::Calibrated | TwoViewKind::Uncalibrated);
        let Some(f) = g.f.filter(|_| epipolar && wanted(&g)) else { return Ok(g) };
        let (Some(in_a), Some(in_b)) = (prepared.get(g.a), prepared.get(g.b)) else { return Ok(g) };
        let [a, b] = [g.a, g.b].map(|i| &features[i]);
        let sigma = verification.sigma_px();
        let more = guided_match_prepared((a, &in_a), (b, &in_b), &f, sigma, matching);
        let cameras = [&cameras[g.a], &cameras[g.b]];
        Ok(merge_guided(&g, [a, b], cameras, &more, verification, seed))
    });
    merged.collect()
}

/// Verifies pairs over all threads. `cameras` holds one camera a frame. The result is sorted by
/// `(a, b)`, does not depend on the number of threads and holds only pairs with `min_inliers`;
/// matches given as `(b, a)` are turned round, pairs of an image with itself or with a missing one
/// are dropped.
pub fn verify_pairs(
    features: &[Features],
    cameras: &[Camera],
    matches: Vec<(usize, usize, Vec<[u32; 2]>)>,
    config: &TwoViewConfig,
    seed: u64,
    progress: &Progress,
) -> Result<Vec<TwoViewGeometry>, SfmError> {
    progress.begin("verify", matches.len());
    let known = features.len().min(cameras.len());
    let results: Result<Vec<Option<TwoViewGeometry>>, SfmError> = matches
        .into_par_iter()
        .map(|(a, b, mut pairs)| {
            progress.tick()?;
            if a == b || a >= known || b >= known {
                return Ok(None);
            }
            if a > b {
                pairs.iter_mut().for_each(|p| p.reverse());
            }
            let (a, b) = (a.min(b), a.max(b));
            let geometry =
                verify_pair(a, b, &features[a], &features[b], &cameras[a], &cameras[b], &pairs, config, seed);
            Ok((geometry.inliers.len() >= config.min_inliers).then_some(geometry))
        })
        .collect();
    let mut verified: Vec<TwoViewGeometry> = results?.into_iter().flatten().collect();
    verified.sort_by_key(|g| (g.a, g.b));
    Ok(verified)
}

#[cfg(test)]
mod tests;
