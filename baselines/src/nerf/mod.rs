//! NeRF: a deep perceptron of position and direction, sampled coarsely, then finely along rays
//! (Mildenhall et al., "NeRF: Representing Scenes as Neural Radiance Fields for View Synthesis",
//! ECCV 2020), and D-NeRF, which first moves each position to where it was at time 0 (Pumarola et
//! al., "D-NeRF: Neural Radiance Fields for Dynamic Scenes", CVPR 2021).

mod depths;
mod encoding;
mod gradient;
mod network;
mod render;
mod train;

#[cfg(test)]
mod reference;
#[cfg(test)]
mod tests;

use crate::FieldError;
use crate::adam::AdamMoments;
use crate::domain::Domain;
use crate::field::{Kept, RadianceField, StepPlace, StepReport};
use crate::kept::{Restored, kept_arrays};
use crate::rays::{self, PhotoRays, Ray};
use depths::Reach;
use encoding::encode;
use glam::Vec3;
use network::{DIRECTION_OCTAVES, ENCODED_DIRECTION, NerfNetworks, NerfRay, NerfWeights};
use scene::rng::rng;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use splat::{PinholeView, RenderOutput};

/// Units of a layer. Source: Mildenhall et al. 2020, appendix A.
const WIDTH: usize = 256;
/// Coarse samples of a ray, and fine ones. Source: Mildenhall et al. 2020, section 5.3.
const SAMPLES: [usize; 2] = [64, 128];
/// Rays of a step. Source: Mildenhall et al. 2020: 4,096 in the paper, 1,024 in their program.
const RAYS: usize = 1024;
/// Rays of a step of D-NeRF. Source: Pumarola et al. 2021's settings for synthetic scenes.
const DEFORMED_RAYS: usize = 500;
/// The same for a training with a time limit. Source: docs/decisions/19.
const BUDGET_WIDTH: usize = 64;
/// See [`BUDGET_WIDTH`].
const BUDGET_SAMPLES: [usize; 2] = [32, 32];
/// See [`BUDGET_WIDTH`].
const BUDGET_RAYS: usize = 512;
/// Nearest place in distances of the points seen, where no masks bound the scene.
/// Source: Mildenhall et al. 2020's program for photos.
const NEAREST: f32 = 0.9;
/// Most of each in a file. Source: eight times the paper's.
const MOST: usize = 8 * RAYS;

/// The shape of a NeRF.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct NerfShape {
    pub(crate) domain: Domain,
    /// Nearest place that is sampled, normalised units.
    pub(crate) near: f32,
    pub(crate) width: usize,
    /// Coarse and fine.
    pub(crate) samples: [usize; 2],
    /// Rays of a step.
    pub(crate) rays: usize,
    /// Whether positions are moved to time 0 first, and one network is both coarse and fine.
    pub(crate) deformed: bool,
    /// Whether the schedule is the time limit's.
    pub(crate) budget: bool,
}

/// A NeRF or D-NeRF.
#[derive(Clone, Debug)]
pub(crate) struct Nerf {
    shape: NerfShape,
    networks: NerfNetworks,
    /// Parameters of the coarse and of the fine network, or of the one for both and of the
    /// deformation.
    weights: [Vec<f32>; 2],
    moments: [AdamMoments; 2],
}

impl NerfShape {
    /// The papers' settings, or with a `budget` those of a training with a time limit.
    pub(crate) fn new(domain: Domain, nearest_point: f32, deformed: bool, budget: bool) -> Self {
        let rays = if deformed { DEFORMED_RAYS } else { RAYS };
        let paper = Self {
            domain,
            near: if domain.cascades == 1 { 0.0 } else { NEAREST * nearest_point },
            width: WIDTH,
            samples: SAMPLES,
            rays,
            deformed,
            budget,
        };
        if !budget {
            return paper;
        }
        Self { width: BUDGET_WIDTH, samples: BUDGET_SAMPLES, rays: BUDGET_RAYS, ..paper }
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

impl Nerf {
    /// Untrained.
    pub(crate) fn new(shape: NerfShape, seed: u64) -> Self {
        let networks = NerfNetworks::new(shape.width, shape.deformed);
        let mut rng = rng(seed, "networks", 0);
        let first = networks.radiance.initial(&mut rng);
        let second = networks.deformation.as_ref().unwrap_or(&networks.radiance).initial(&mut rng);
        let moments = [AdamMoments::new(first.len()), AdamMoments::new(second.len())];
        Self { shape, networks, weights: [first, second], moments }
    }

    /// A ray in the frame of the field's cube, and the stretch of it inside; none where it misses.
    fn local(&self, ray: &Ray) -> Option<(NerfRay, Reach)> {
        let Domain { centre, cascades, .. } = self.shape.domain;
        let reach = self.shape.domain.reach();
        let (origin, direction) = ((ray.origin - centre) / reach, ray.direction / reach);
        let inverse = direction.recip();
        let (a, b) = ((Vec3::NEG_ONE - origin) * inverse, (Vec3::ONE - origin) * inverse);
        let near = a.min(b).max_element().max(self.shape.near);
        let far = a.max(b).min_element();
        if !(near < far && far.is_finite()) {
            return None;
        }
        let mut encoded = [0.0; ENCODED_DIRECTION];
        encode(&ray.direction.to_array(), DIRECTION_OCTAVES, &mut encoded);
        let (origin, direction) = (origin.to_array(), direction.to_array());
        let stretch = Reach { near, far, inverse: cascades > 1 && near > 0.0 };
        Some((NerfRay { origin, direction, encoded, time: ray.time }, stretch))
    }

    /// Length of a unit of the normalised frame in that of the cube.
    fn unit(&self) -> f32 {
        1.0 / self.shape.domain.reach()
    }

    /// What a pass (0: coarse, 1: fine) reads.
    fn parts<'a>(&self, of: &'a [Vec<f32>; 2], pass: usize) -> NerfWeights<'a> {
        match self.shape.deformed {
            true => NerfWeights { radiance: &of[0], deformation: &of[1] },
            false => NerfWeights { radiance: &of[pass], deformation: &[] },
        }
    }
}

impl RadianceField for Nerf {
    fn train_step(&mut self, photos: &PhotoRays, place: StepPlace) -> Result<StepReport, FieldError> {
        Ok(self.step(photos, place))
    }

    fn render(&self, view: &PinholeView, time: f32, background: [f32; 3]) -> RenderOutput {
        rays::picture(view, time, background, &|rays, out| self.trace(rays, background, out))
    }

    fn size(&self) -> usize {
        self.weights.iter().map(Vec::len).sum()
    }

    fn arrays(&self, kept: Kept) -> (Vec<&[f32]>, Value) {
        let parts = self.weights.iter().map(Vec::as_slice).zip(&self.moments);
        (kept_arrays(kept, parts), json!({}))
    }

    fn restore(&mut self, kept: Kept, arrays: Vec<Vec<f32>>, _: &Value) -> Result<(), String> {
        let mut restored = Restored::new(kept, arrays)?;
        for (weights, moments) in self.weights.iter_mut().zip(&mut self.moments) {
            restored.take_trained(weights, moments)?;
        }
        Ok(())
    }
}
