//! NeRF: a deep perceptron of position and direction, sampled coarsely, then finely along rays
//! (Mildenhall et al., "NeRF: Representing Scenes as Neural Radiance Fields for View Synthesis",
//! ECCV 2020), and D-NeRF, which first moves each position to where it was at time 0 (Pumarola et
//! al., "D-NeRF: Neural Radiance Fields for Dynamic Scenes", CVPR 2021).

mod depths;
#[cfg(feature = "gpu")]
mod device;
mod encoding;
mod gradient;
mod network;
mod render;
mod settings;
mod train;

#[cfg(all(test, feature = "gpu"))]
mod device_tests;
#[cfg(test)]
mod reference;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod twin_tests;

use crate::FieldError;
use crate::adam::AdamMoments;
use crate::domain::Domain;
use crate::field::{Kept, RadianceField, StepPlace, StepReport};
use crate::kept::{Restored, kept_arrays};
use crate::rays::{self, PhotoRays, Ray};
use depths::Reach;
#[cfg(feature = "gpu")]
pub(crate) use device::NerfOnDevice;
use encoding::encode;
use glam::Vec3;
use network::{DIRECTION_OCTAVES, ENCODED_DIRECTION, NerfLayers, NerfNetworks, NerfRay, NerfWeights};
use scene::rng::rng;
use serde_json::{Value, json};
pub(crate) use settings::NerfShape;
use settings::{GROUP, NerfSettings};
use splat::{PinholeView, RenderOutput};

/// A NeRF or D-NeRF.
#[derive(Clone, Debug)]
pub(crate) struct Nerf {
    shape: NerfShape,
    settings: NerfSettings,
    networks: NerfNetworks,
    /// Parameters of the coarse and of the fine network, or of the one for both and of the
    /// deformation.
    weights: [Vec<f32>; 2],
    moments: [AdamMoments; 2],
}

impl Nerf {
    /// Untrained.
    pub(crate) fn new(shape: NerfShape, seed: u64) -> Self {
        let networks = NerfNetworks::new(shape.width, shape.deformed);
        let mut rng = rng(seed, "networks", 0);
        let first = networks.radiance.initial(&mut rng);
        let second = networks.deformation.as_ref().unwrap_or(&networks.radiance).initial(&mut rng);
        let moments = [AdamMoments::new(first.len()), AdamMoments::new(second.len())];
        Self { shape, settings: NerfSettings::default(), networks, weights: [first, second], moments }
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

    fn render(
        &self,
        view: &PinholeView,
        time: f32,
        background: [f32; 3],
    ) -> Result<RenderOutput, FieldError> {
        rays::picture(view, time, (background, rays::BLOCK), &|rays, out| {
            let mut layers = NerfLayers::default();
            let mut shade = |pass: usize, rays: &[NerfRay], depths: &[f32]| {
                Ok(self.shade(pass, rays, depths, &mut layers))
            };
            self.trace((rays, GROUP), background, out, &mut shade)
        })
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
