//! What NeRF and D-NeRF are told: the settings of the papers and of their authors' programs.

use crate::adam::AdamSettings;
use crate::domain::Domain;
use serde::{Deserialize, Serialize};
use splat::Dataset;

/// Samples that are evaluated together, unless one ray has more.
/// Source: docs/decisions/19: a third-level cache holds their activations.
pub(super) const GROUP: usize = 384;

/// The shape of a NeRF. With a time limit it is smaller: docs/decisions/19.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct NerfShape {
    pub(crate) domain: Domain,
    /// Nearest place that is sampled, normalised units.
    pub(crate) near: f32,
    /// Units of a layer. Source: Mildenhall et al. 2020, appendix A (256).
    pub(crate) width: usize,
    /// Samples of a ray, coarse and fine. Source: Mildenhall et al. 2020, section 5.3 (64, 128).
    pub(crate) samples: [usize; 2],
    /// Rays of a step. Source: Mildenhall et al. 2020: 4,096 in the paper, 1,024 in their program;
    /// Pumarola et al. 2021's settings for synthetic scenes (500).
    pub(crate) rays: usize,
    /// Whether positions are moved to time 0 first, and one network is both coarse and fine.
    pub(crate) deformed: bool,
    /// Whether the schedule is the time limit's.
    pub(crate) budget: bool,
}

/// Most units, samples and rays in a file. Source: eight times the rays of NeRF's program.
const MOST: usize = 8 * 1024;

/// How it is trained.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct NerfSettings {
    /// Source: Mildenhall et al. 2020, section 5.3.
    pub(super) adam: AdamSettings,
    /// Learning rate at the start. Source: Mildenhall et al. 2020, section 5.3.
    pub(super) learning_rate: f64,
    /// Its factor in `fall_steps` steps, or over the time limit. Source: as above (to 5e-5).
    pub(super) fall: f64,
    /// Steps. Source: the authors' program (`lrate_decay` 500).
    pub(super) fall_steps: f64,
    /// Share of the schedule in which only the middle of the pictures is seen.
    /// Source: D-NeRF's program: 500 steps, of 50,000.
    pub(super) cropped: f64,
    /// Share of a side that is the middle. Source: D-NeRF's program.
    pub(super) crop: f32,
    /// Share of the schedule in which times are admitted in order.
    /// Source: Pumarola et al. 2021's settings: 10,000 steps, of 50,000.
    pub(super) ordered: f64,
    /// Fewest photos admitted. Source: Pumarola et al. 2021's program.
    pub(super) fewest: usize,
    /// Stretches of rays whose gradients are added up apart. Source: chosen by hand; part of the
    /// result, as sums have a fixed order; each holds all gradients once.
    pub(super) stretches: usize,
}

impl Default for NerfSettings {
    fn default() -> Self {
        Self {
            adam: AdamSettings { betas: [0.9, 0.999], epsilon: 1e-7 },
            learning_rate: 5e-4,
            fall: 0.1,
            fall_steps: 500_000.0,
            cropped: 0.01,
            crop: 0.5,
            ordered: 0.2,
            fewest: 3,
            stretches: 16,
        }
    }
}

/// Where a scene that no masks bound begins.
struct NearSettings {
    /// In distances of the nearest point seen. Source: Mildenhall et al. 2020's program for photos.
    share: f32,
    /// One in so many points may be wrong and too near. Source: their scripts for photos.
    wrong: usize,
    /// Distance of the nearest point where there is no cloud, normalised units.
    /// Source: chosen by hand.
    without_cloud: f32,
}

impl Default for NearSettings {
    fn default() -> Self {
        Self { share: 0.9, wrong: 1000, without_cloud: 0.1 }
    }
}

impl NerfShape {
    /// The papers' settings, or with a `budget` those of a training with a time limit.
    pub(crate) fn new(domain: Domain, dataset: &Dataset, deformed: bool, budget: bool) -> Self {
        let near = if domain.cascades == 1 { 0.0 } else { NearSettings::default().near(dataset) };
        Self::with_near(domain, near, deformed, budget)
    }

    /// The same for a nearest place.
    pub(super) fn with_near(domain: Domain, near: f32, deformed: bool, budget: bool) -> Self {
        let rays = if deformed { 500 } else { 1024 };
        let paper = Self { domain, near, width: 256, samples: [64, 128], rays, deformed, budget };
        if budget { Self { width: 64, samples: [32, 32], rays: 512, ..paper } } else { paper }
    }

    /// Whether fields of this shape can be made.
    pub(crate) fn is_sane(&self) -> bool {
        let Self { width, samples, rays, near, .. } = *self;
        self.domain.is_sane()
            && near.is_finite()
            && near >= 0.0
            && (32..=MOST).contains(&width)
            && width.is_multiple_of(32)
            && samples.iter().all(|n| (3..=MOST).contains(n))
            && (1..=MOST).contains(&rays)
    }
}

impl NearSettings {
    /// The nearest place to sample, by the points of the cloud.
    fn near(&self, dataset: &Dataset) -> f32 {
        let mut depths: Vec<f32> = dataset
            .training_views()
            .iter()
            .map(|&i| &dataset.views[i].view)
            .flat_map(|v| dataset.points.iter().map(|(p, _)| (v.rotation * *p + v.translation).z))
            .filter(|z| z.is_finite() && *z > 0.0)
            .collect();
        if depths.is_empty() {
            return self.share * self.without_cloud;
        }
        let at = depths.len() / self.wrong;
        self.share * *depths.select_nth_unstable_by(at, f32::total_cmp).1
    }
}
