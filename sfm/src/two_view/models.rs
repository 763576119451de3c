//! The candidate models of a pair and the choice among them.

use super::chance::{Constraint, log10_false_alarms};
use super::config::TwoViewConfig;
use super::correspondences::Correspondences;
use super::gric::{gric, noise};
use super::pose::{best_pose, median_angle, pure_rotation};
use crate::ransac::{
    EssentialEstimator, EssentialModel, FundamentalEstimator, HomographyEstimator, RansacConfig,
    RansacResult, ransac,
};
use crate::solvers::{sampson_sq, transfer_sq};
use glam::{DMat3, DVec3};
use scene::{Pose, TwoViewGeometry, TwoViewKind};

/// An essential matrix is trusted if it keeps this part of the fundamental matrix's inliers.
/// Source: as in COLMAP (`min_E_F_inlier_ratio`).
const ESSENTIAL_OVER_FUNDAMENTAL: f64 = 0.95;

/// What the three searches found.
pub(crate) struct TwoViewModels {
    fundamental: Option<RansacResult<DMat3>>,
    essential: Option<RansacResult<EssentialModel>>,
    homography: Option<RansacResult<(DMat3, DMat3)>>,
}

impl TwoViewModels {
    /// Searches for a homography and a fundamental matrix and, if one of them has enough inliers,
    /// for an essential matrix, which costs ten times as much a sample. `None` if none has enough.
    pub(crate) fn find(
        all: &Correspondences,
        config: &TwoViewConfig,
        seed: u64,
        stream: u64,
    ) -> Option<Self> {
        let n = all.len();
        let pixels = RansacConfig {
            threshold: config.max_error_px,
            confidence: config.verify_confidence,
            min_iterations: 20,
            max_iterations: config.max_samples,
            min_inliers: config.min_inliers.max((config.min_inlier_ratio * n as f64) as usize),
            seed,
            best_first: all.best_first,
        };
        let scaled = RansacConfig { threshold: config.max_error_px / all.size, ..pixels };
        let (a, b) = all.scaled();
        let loss_scale = config.sigma_px();
        let homography = HomographyEstimator { a: a.clone(), b: b.clone() };
        let homography = ransac(&homography, &scaled, stream);
        let fundamental = FundamentalEstimator { a, b, loss_scale: loss_scale / all.size };
        let fundamental = ransac(&fundamental, &scaled, stream);
        let count_f = fundamental.as_ref().map_or(0, |m| m.inliers.len());
        let count_h = homography.as_ref().map_or(0, |m| m.inliers.len());
        if count_f.max(count_h) == 0 {
            return None;
        }
        let essential = EssentialEstimator::new(all.a.clone(), all.b.clone(), all.focal, loss_scale);
        let wanted = pixels.min_inliers.max(count_f.max(count_h) / 2);
        let essential = ransac(&essential, &RansacConfig { min_inliers: wanted, ..pixels }, stream);
        Some(Self { fundamental, essential, homography })
    }

    /// The model that explains the matches best, with its pose.
    pub(crate) fn choose(
        self,
        all: &Correspondences,
        config: &TwoViewConfig,
        none: TwoViewGeometry,
    ) -> TwoViewGeometry {
        let mut result = none;
        let n_e = self.essential.as_ref().map_or(0, |m| m.inliers.len()) as f64;
        let n_f = self.fundamental.as_ref().map_or(0, |m| m.inliers.len()) as f64;
        let trusted = n_e >= ESSENTIAL_OVER_FUNDAMENTAL * n_f;
        let planar = self.is_planar(all, trusted, config.max_error_px);
        result.f = self.fundamental.as_ref().map(|m| all.fundamental_to_pixels(&m.model));
        result.e = self.essential.as_ref().map(|m| m.model.e);
        result.h = self.homography.as_ref().map(|m| all.homography_to_pixels(&m.model.0));
        result.kind = match (planar, trusted) {
            (true, _) => TwoViewKind::Planar,
            (false, true) => TwoViewKind::Calibrated,
            (false, false) => TwoViewKind::Uncalibrated,
        };
        let inliers = self.inliers_of(result.kind);
        let homography = self.homography.as_ref().filter(|_| planar);
        let rotation = homography.and_then(|m| pure_rotation(all, &m.inliers, &m.model.0));
        if let Some(rotation) = rotation {
            result.kind = TwoViewKind::Panoramic;
            result.b_from_a = Some(Pose::new(rotation, DVec3::ZERO));
        } else {
            let mut essentials: Vec<DMat3> = result.e.into_iter().collect();
            essentials.extend(self.fundamental.as_ref().map(|m| all.fundamental_to_rays(&m.model)));
            let h = homography.map(|m| &m.model.0);
            result.b_from_a = best_pose(all, &inliers, &essentials, h, config.max_error_px);
            result.median_angle = result.b_from_a.map_or(0.0, |pose| median_angle(&pose, all, &inliers));
        }
        result.inliers = inliers.iter().map(|&i| all.matches[i]).collect();
        result.inliers.sort_unstable();
        if result.inliers.len() < config.min_inliers {
            result.kind = TwoViewKind::Degenerate;
        }
        result
    }

    /// The least log10 of the number of false alarms of the three models.
    pub(crate) fn log10_false_alarms(&self, all: &Correspondences, limit: f64) -> f64 {
        let (a, b) = all.scaled();
        let unit = all.size * all.size;
        let each = 0..all.len();
        let f = self.fundamental.as_ref().map(|m| {
            let squared: Vec<f64> = each.clone().map(|i| unit * sampson_sq(&m.model, a[i], b[i])).collect();
            log10_false_alarms(&squared, &all.b, Constraint::Line, 7, 3.0, limit)
        });
        let e = self.essential.as_ref().map(|m| {
            let squared: Vec<f64> =
                each.clone().map(|i| sampson_sq(&m.model.f, all.a[i], all.b[i])).collect();
            log10_false_alarms(&squared, &all.b, Constraint::Line, 5, 10.0, limit)
        });
        let h = self.homography.as_ref().map(|m| {
            let squared: Vec<f64> =
                each.clone().map(|i| unit * transfer_sq(&m.model.0, a[i], b[i])).collect();
            log10_false_alarms(&squared, &all.b, Constraint::Point, 4, 1.0, limit)
        });
        [f, e, h].into_iter().flatten().fold(f64::INFINITY, f64::min)
    }

    /// Whether the homography is the better description of all matches.
    fn is_planar(&self, all: &Correspondences, trusted: bool, limit: f64) -> bool {
        let Some(homography) = &self.homography else { return false };
        let (a, b) = all.scaled();
        let unit = all.size * all.size;
        let epipolar: Vec<f64> = match (&self.essential, &self.fundamental) {
            (Some(m), _) if trusted => {
                (0..all.len()).map(|i| sampson_sq(&m.model.f, all.a[i], all.b[i])).collect()
            }
            (_, Some(m)) => (0..all.len()).map(|i| unit * sampson_sq(&m.model, a[i], b[i])).collect(),
            _ => return true,
        };
        // Half of the squared transfer error: the error is shared between the two images.
        let transfer: Vec<f64> =
            (0..all.len()).map(|i| 0.5 * unit * transfer_sq(&homography.model.0, a[i], b[i])).collect();
        let inliers = epipolar.iter().copied().filter(|e| *e < limit * limit).collect();
        let sigma = noise(inliers, limit);
        let parameters = if trusted { 5.0 } else { 7.0 };
        let space = gric(epipolar.into_iter(), sigma, 3.0, parameters);
        gric(transfer.into_iter(), sigma, 2.0, 8.0) < space
    }

    /// The largest inlier set that the kind stands for.
    fn inliers_of(&self, kind: TwoViewKind) -> Vec<usize> {
        let f = self.fundamental.as_ref().map(|m| &m.inliers);
        let e = self.essential.as_ref().map(|m| &m.inliers);
        let h = self.homography.as_ref().map(|m| &m.inliers);
        let candidates = match kind {
            TwoViewKind::Uncalibrated => [f, None, None],
            TwoViewKind::Calibrated => [e, None, None],
            _ => [e, f, h],
        };
        candidates.into_iter().flatten().max_by_key(|inliers| inliers.len()).cloned().unwrap_or_default()
    }
}
