//! The shape of moving Gaussians: what their sizes follow from.

use super::settings::FirstGaussians;
use crate::domain::Domain;
use glam::{Quat, Vec3};
use rand::Rng as _;
use scene::Gaussians;
use scene::rng::rng;
use serde::{Deserialize, Serialize};
use splat::Dataset;
use splat::model::{Model, Planes};
use splat::moved::MovedGaussians;

/// Planes of the geometry that move: mean, logarithms of the scales, quaternion.
/// Source: Wu et al. 2024's settings (opacity stays).
pub(super) const MOVES: usize = 10;
/// What is moved of a Gaussian: these planes, and the constant terms of the colour's harmonics.
/// Source: as above; the colour is an option of the authors' program, see docs/decisions/19.
pub(super) const OUTPUTS: usize = MOVES + 3;

/// Gaussians at a time, or gradients of what they are.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Moved {
    pub(super) geometry: Planes,
    /// What is added to the constant terms of the spherical harmonics, [N × 3].
    pub(super) tint: Vec<f32>,
}

impl Moved {
    /// Gaussians at rest.
    pub(super) fn rest(geometry: &Planes, count: usize) -> Self {
        Self { geometry: geometry.clone(), tint: vec![0.0; 3 * count] }
    }

    /// One of the [`OUTPUTS`] of a Gaussian.
    pub(super) fn value(&self, output: usize, i: usize) -> f32 {
        match output.checked_sub(MOVES) {
            Some(channel) => self.tint[3 * i + channel],
            None => self.geometry[output][i],
        }
    }

    /// The same, to be changed.
    pub(super) fn value_mut(&mut self, output: usize, i: usize) -> &mut f32 {
        match output.checked_sub(MOVES) {
            Some(channel) => &mut self.tint[3 * i + channel],
            None => &mut self.geometry[output][i],
        }
    }
}

/// Most Gaussians in a file. Source: memory: 16 GiB of parameters and moments.
pub(super) const MOST_IN_FILES: usize = 1 << 24;
/// Most cells along an axis of planes in a file. Source: seven times the authors' or more.
const MOST_CELLS: usize = 1 << 10;

/// The shape of moving Gaussians.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct MovingShape {
    pub(crate) domain: Domain,
    /// Cells of the planes along axes of space, on the first level. Source: docs/decisions/19
    /// (Wu et al. 2024's settings: 64).
    pub(crate) space: usize,
    /// Cells of the planes along time: a quarter of the times. Source: docs/decisions/19 (Wu et al.
    /// 2024's settings: half for synthetic scenes, 150 for HyperNeRF's scenes).
    pub(crate) times: usize,
    /// Most Gaussians. Source: docs/decisions/19.
    pub(crate) gaussians: usize,
    /// Width of a pixel in the scene, normalised units.
    pub(crate) pixel: f32,
}

impl MovingShape {
    /// The defaults for a data set whose views have `times`.
    pub(crate) fn new(domain: Domain, dataset: &Dataset, times: &[f32]) -> Self {
        let mut distinct = times.to_vec();
        distinct.sort_by(f32::total_cmp);
        distinct.dedup();
        let times = (distinct.len() / 4).clamp(2, 150);
        let pixel = MovedGaussians::pixel(dataset);
        Self { domain, space: 16, times, gaussians: 30_000, pixel }
    }

    /// Gaussians at the points of the cloud or, without one, anywhere in the cube: what mattes of
    /// different times leave room for together is only what stands still.
    pub(super) fn first_gaussians(
        &self,
        first: &FirstGaussians,
        dataset: &Dataset,
        seed: u64,
    ) -> Result<MovedGaussians, splat::SplatError> {
        if self.domain.cascades > 1 || !dataset.points.is_empty() {
            return MovedGaussians::of(dataset, self.gaussians, seed);
        }
        let (half, count) = (self.domain.half, first.count.min(self.gaussians));
        let mut rng = rng(seed, "first", 0);
        let scale = 2.0 * half / (count as f32).cbrt();
        let mut means = Vec::new();
        means.resize_with(count, || {
            self.domain.centre + Vec3::from(rng.random::<[f32; 3]>().map(|v| (2.0 * v - 1.0) * half))
        });
        MovedGaussians::new(Model::from_gaussians(&Gaussians {
            means,
            log_scales: vec![Vec3::splat((first.size * scale).ln()); count],
            rotations: vec![Quat::IDENTITY; count],
            opacity_logits: vec![first.logit; count],
            sh: vec![0.0; 3 * count],
            sh_degree: 0,
        }))
    }

    /// Whether fields of this shape can be made.
    pub(crate) fn is_sane(&self) -> bool {
        let Self { domain, space, times, gaussians, pixel } = *self;
        domain.is_sane()
            && (2..=MOST_CELLS).contains(&space)
            && (1..=MOST_CELLS).contains(&times)
            && (1..=MOST_IN_FILES).contains(&gaussians)
            && pixel.is_finite()
    }
}
