//! The candidate models of a pair and the choice among them.

use super::TwoViewConfig;
use super::correspondences::Correspondences;
use crate::ransac::{
    EssentialEstimator, EssentialModel, FundamentalEstimator, HomographyEstimator, RansacConfig, RansacResult, ransac,
};
use crate::solvers::{motions_from_homography, pose_from_essential};
use glam::{DMat3, DVec3};
use scene::{Pose, TwoViewGeometry, TwoViewKind};

/// An essential matrix is trusted if it keeps this part of the fundamental matrix's inliers.
const ESSENTIAL_OVER_FUNDAMENTAL: f64 = 0.95;
/// A homography is preferred if it keeps this part of the epipolar inliers.
const HOMOGRAPHY_OVER_EPIPOLAR: f64 = 0.8;

/// What the three searches found.
pub struct Models {
    fundamental: Option<RansacResult<DMat3>>,
    essential: Option<RansacResult<EssentialModel>>,
    homography: Option<RansacResult<(DMat3, DMat3)>>,
}

impl Models {
    /// Searches for a fundamental matrix, an essential matrix and a homography. `None` if none has enough inliers.
    pub fn find(all: &Correspondences, config: &TwoViewConfig, seed: u64, stream: u64) -> Option<Self> {
        let n = all.len();
        let least = config.min_inliers.max((config.min_inlier_ratio * n as f64) as usize);
        let pixels = RansacConfig {
            threshold: config.max_error_px,
            confidence: config.verify_confidence,
            min_iterations: 20,
            max_iterations: config.max_samples,
            min_inliers: least,
            seed,
        };
        let scaled = RansacConfig { threshold: config.max_error_px / all.size, ..pixels };
        let (a, b) = all.scaled();
        let loss_scale = 0.25 * config.max_error_px;
        let essential = EssentialEstimator::new(all.a.clone(), all.b.clone(), all.focal, loss_scale);
        let essential = ransac(&essential, &pixels, stream);
        let homography = HomographyEstimator { a: a.clone(), b: b.clone() };
        let homography = ransac(&homography, &scaled, stream);
        let fundamental = FundamentalEstimator { a, b, loss_scale: loss_scale / all.size };
        let fundamental = ransac(&fundamental, &scaled, stream);
        let found = fundamental.is_some() || essential.is_some() || homography.is_some();
        found.then_some(Self { fundamental, essential, homography })
    }

    /// The model that explains the matches best, with its pose.
    pub fn choose(self, all: &Correspondences, config: &TwoViewConfig, none: TwoViewGeometry) -> TwoViewGeometry {
        let count = |inliers: Option<&Vec<usize>>| inliers.map_or(0, Vec::len) as f64;
        let n_e = count(self.essential.as_ref().map(|m| &m.inliers));
        let n_f = count(self.fundamental.as_ref().map(|m| &m.inliers));
        let n_h = count(self.homography.as_ref().map(|m| &m.inliers));
        let epipolar = n_e.max(n_f);
        let mut result = none;
        if let Some(m) = &self.fundamental {
            result.f = Some(all.fundamental_to_pixels(&m.model));
        }
        result.e = self.essential.as_ref().map(|m| m.model.e);
        result.h = self.homography.as_ref().map(|m| all.homography_to_pixels(&m.model.0));
        let pose = if n_h >= HOMOGRAPHY_OVER_EPIPOLAR * epipolar {
            result.kind = TwoViewKind::Planar;
            self.planar_pose(all)
        } else {
            let trusted = n_e >= ESSENTIAL_OVER_FUNDAMENTAL * n_f;
            result.kind = if trusted { TwoViewKind::Calibrated } else { TwoViewKind::Uncalibrated };
            self.epipolar_pose(all)
        };
        let mut inliers = match result.kind {
            TwoViewKind::Uncalibrated => self.fundamental.map(|m| m.inliers),
            TwoViewKind::Planar if n_h >= epipolar => self.homography.map(|m| m.inliers),
            _ if n_e >= n_f => self.essential.map(|m| m.inliers),
            _ => self.fundamental.map(|m| m.inliers),
        }
        .unwrap_or_default();
        inliers.truncate(all.len());
        if let Some(pose) = pose {
            result.median_angle = median_angle(&pose, all, &inliers);
            if result.kind == TwoViewKind::Planar && pose.translation == DVec3::ZERO {
                result.kind = TwoViewKind::Panoramic;
            }
        }
        result.b_from_a = pose;
        result.inliers = inliers.iter().map(|&i| all.matches[i]).collect();
        if result.inliers.len() < config.min_inliers {
            result.kind = TwoViewKind::Degenerate;
        }
        result
    }

    fn epipolar_pose(&self, all: &Correspondences) -> Option<Pose> {
        let (e, inliers) = match (&self.essential, &self.fundamental) {
            (Some(m), _) => (m.model.e, &m.inliers),
            (None, Some(m)) => (all.fundamental_to_rays(&m.model), &m.inliers),
            _ => return None,
        };
        let rays: Vec<(DVec3, DVec3)> = inliers.iter().map(|&i| all.rays(i)).collect();
        pose_from_essential(&e, &rays).map(|(pose, _)| pose)
    }

    fn planar_pose(&self, all: &Correspondences) -> Option<Pose> {
        let m = self.homography.as_ref()?;
        let rays: Vec<DVec3> = m.inliers.iter().map(|&i| all.rays(i).0).collect();
        let motions = motions_from_homography(&all.homography_to_rays(&m.model.0), &rays);
        let pose = motions.first()?.b_from_a;
        Some(Pose { translation: pose.translation.normalize_or_zero(), ..pose })
    }
}

/// Median angle between the two rays of the matches, radians.
pub fn median_angle(b_from_a: &Pose, all: &Correspondences, inliers: &[usize]) -> f64 {
    let mut angles: Vec<f64> = inliers
        .iter()
        .map(|&i| {
            let (a, b) = all.rays(i);
            let a = b_from_a.rotation * a;
            a.cross(b).length().atan2(a.dot(b))
        })
        .collect();
    if angles.is_empty() {
        return 0.0;
    }
    let middle = angles.len() / 2;
    *angles.select_nth_unstable_by(middle, f64::total_cmp).1
}
