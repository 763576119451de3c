//! Geometric verification of image pairs: which matches agree with one rigid motion, and which.

mod correspondences;
mod models;

use crate::SfmError;
use correspondences::Correspondences;
use models::Models;
use rayon::prelude::*;
use scene::{Camera, Features, Progress, TwoViewGeometry, TwoViewKind};
use serde::{Deserialize, Serialize};

/// How pairs are verified.
#[derive(clap::Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TwoViewConfig {
    /// Largest epipolar or transfer error of an inlier match, pixels.
    #[arg(long, default_value_t = Self::default().max_error_px, help_heading = "Verification")]
    pub max_error_px: f64,
    /// Pairs with fewer inlier matches are dropped.
    #[arg(long, default_value_t = Self::default().min_inliers, help_heading = "Verification")]
    pub min_inliers: usize,
    /// Pairs of which a smaller part of the matches agrees are not searched for to the end.
    #[arg(long, default_value_t = Self::default().min_inlier_ratio, help_heading = "Verification")]
    pub min_inlier_ratio: f64,
    /// Probability of finding a model where there is one.
    #[arg(long, default_value_t = Self::default().verify_confidence, help_heading = "Verification")]
    pub verify_confidence: f64,
    /// Most samples drawn for a model.
    #[arg(long, default_value_t = Self::default().max_samples, help_heading = "Verification")]
    pub max_samples: usize,
    /// Matches that move by less than this between the images may be a watermark, pixels.
    #[arg(long, default_value_t = Self::default().static_px, help_heading = "Verification")]
    pub static_px: f64,
}

impl Default for TwoViewConfig {
    fn default() -> Self {
        Self {
            max_error_px: 4.0,
            min_inliers: 15,
            min_inlier_ratio: 0.25,
            verify_confidence: 0.9999,
            max_samples: 3000,
            static_px: 1.5,
        }
    }
}

/// Finds the motion that explains the matches of images `a` and `b`: an essential matrix where the focal lengths
/// can be trusted as far as this pair tells (it keeps at least 95 % of the fundamental matrix's inliers), else a
/// fundamental matrix; a homography where that explains nearly as much (a plane, or a rotation without
/// baseline). Matches that are not finite, out of range or not one-to-one are dropped. All matrices refer to
/// ideal (undistorted) pixels. [`TwoViewKind::Degenerate`] with no inliers where nothing is found.
#[allow(clippy::too_many_arguments)] // two of everything
pub fn verify_pair(
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
    if all.len() < config.min_inliers.max(8) {
        return none;
    }
    let stream = ((a as u64) << 32) ^ b as u64;
    match Models::find(&all, config, seed, stream) {
        Some(models) => models.choose(&all, config, none),
        None => none,
    }
}

/// Verifies pairs over all threads. `cameras` holds one camera a frame. The result is sorted by `(a, b)`, does
/// not depend on the number of threads and holds only pairs with `min_inliers`; matches given as `(b, a)` are
/// turned round, pairs of an image with itself or with a missing one are dropped.
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
            let geometry = verify_pair(
                a, b, &features[a], &features[b], &cameras[a], &cameras[b], &pairs, config, seed,
            );
            Ok((geometry.inliers.len() >= config.min_inliers).then_some(geometry))
        })
        .collect();
    let mut verified: Vec<TwoViewGeometry> = results?.into_iter().flatten().collect();
    verified.sort_by_key(|g| (g.a, g.b));
    Ok(verified)
}
