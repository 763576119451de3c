//! Forward and backward for a stretch of rays.

use super::Nerf;
use super::depths::{Reach, refine, weights};
use super::network::{NerfLayers, NerfRay, NerfWeights};
use crate::composite::{Traced, compose, compose_backward};
use crate::dense::padded_rows;
use crate::loss::{mean_square, square_error};
use crate::rays::Sighting;
use rand::Rng as _;
use scene::rng::Rng;

/// A ray of a step.
#[derive(Clone, Debug)]
pub(super) struct SightedRay {
    pub(super) ray: NerfRay,
    pub(super) reach: Reach,
    pub(super) sighting: Sighting,
}

/// What a stretch of rays adds up to.
#[derive(Clone, Debug, Default)]
pub(super) struct NerfSums {
    /// Gradients as [`Nerf`] has its weights.
    pub(super) gradients: [Vec<f32>; 2],
    pub(super) loss: f64,
    pub(super) square_error: f64,
}

/// Buffers of a group of rays.
#[derive(Default)]
pub(super) struct NerfBuffers {
    pub(super) layers: NerfLayers,
    traced: Vec<Traced>,
    of_colours: Vec<f32>,
    of_densities: Vec<f32>,
    weights: Vec<f32>,
}

/// A field and the transposes of its weights.
#[derive(Clone, Copy)]
pub(super) struct NerfPass<'a> {
    pub(super) field: &'a Nerf,
    pub(super) transposed: &'a [Vec<f32>; 2],
    /// Weight of a ray's loss.
    pub(super) weight: f32,
}

impl NerfPass<'_> {
    /// The gradients of a stretch of rays, both passes.
    pub(super) fn stretch(&self, rays: &[SightedRay], rng: &mut Rng) -> NerfSums {
        let mut sums = NerfSums {
            gradients: self.field.weights.each_ref().map(|w| vec![0.0; w.len()]),
            ..NerfSums::default()
        };
        let mut buffers = NerfBuffers::default();
        let [coarse, fine] = self.field.shape.samples;
        for group in rays.chunks(self.field.group()) {
            let (mut first, mut second) = (Vec::new(), Vec::new());
            group.iter().for_each(|r| r.reach.stratified(coarse, &mut || rng.random(), &mut first));
            self.pass(0, group, &first, &mut buffers, &mut sums);
            for ((r, depths), i) in group.iter().zip(first.chunks_exact(coarse)).zip((0..).step_by(coarse)) {
                let densities = (i..i + coarse).map(|s| self.field.networks.density(&buffers.layers, s));
                let unit = self.field.unit();
                weights(densities, r.reach.steps(depths).map(|dt| dt * unit), &mut buffers.weights);
                refine(depths, &buffers.weights, fine, &mut || rng.random(), &mut second);
            }
            self.pass(1, group, &second, &mut buffers, &mut sums);
        }
        sums
    }

    /// Forward and backward through samples of the rays at `depths`, coarse (0) or fine (1).
    pub(super) fn pass(
        &self,
        pass: usize,
        rays: &[SightedRay],
        depths: &[f32],
        buffers: &mut NerfBuffers,
        sums: &mut NerfSums,
    ) {
        let plain: Vec<NerfRay> = rays.iter().map(|r| r.ray.clone()).collect();
        let NerfWeights { radiance, deformation } = self.field.parts(&self.field.weights, pass);
        let forward = NerfWeights { radiance, deformation };
        self.field.networks.evaluate(forward, &plain, depths, &mut buffers.layers);
        self.trace(pass, rays, depths, buffers, sums);
        let (first, second) = sums.gradients.split_at_mut(1);
        let deformed = self.field.shape.deformed;
        let into = match (deformed, pass) {
            (true, _) => (&mut first[0][..], &mut second[0][..]),
            (false, 0) => (&mut first[0][..], &mut [][..]),
            (false, _) => (&mut second[0][..], &mut [][..]),
        };
        let given = (&buffers.of_colours[..], &buffers.of_densities[..]);
        let transposed = self.field.parts(self.transposed, pass);
        self.field.networks.backward(transposed, &plain, &mut buffers.layers, given, into);
    }

    /// Colours and losses, and the gradients of the networks' outputs.
    fn trace(
        &self,
        pass: usize,
        rays: &[SightedRay],
        depths: &[f32],
        buffers: &mut NerfBuffers,
        sums: &mut NerfSums,
    ) {
        let NerfBuffers { layers, traced, of_colours, of_densities, .. } = buffers;
        let (networks, unit) = (&self.field.networks, self.field.unit());
        let width = networks.colour_width();
        of_colours.clear();
        of_colours.resize(padded_rows(depths.len()) * width, 0.0);
        of_densities.clear();
        let each = depths.len() / rays.len();
        for (r, (ray, depths)) in rays.iter().zip(depths.chunks_exact(each)).enumerate() {
            let first = r * each;
            traced.clear();
            traced.extend(ray.reach.steps(depths).enumerate().map(|(i, dt)| Traced {
                density: networks.density(layers, first + i),
                dt: dt * unit,
                rgb: networks.colour(layers, first + i),
                ..Traced::default()
            }));
            let Sighting { colour, background, .. } = ray.sighting;
            let shown = compose(traced.iter().map(|s| (s.density, s.dt, 0.0, s.rgb)), background);
            let (loss, of_ray) = mean_square(shown.rgb, colour);
            sums.loss += f64::from(loss);
            if pass == 1 {
                sums.square_error += square_error(shown.rgb, colour);
            }
            compose_backward(traced, background, of_ray.map(|g| g * self.weight));
            for (i, s) in traced.iter().enumerate() {
                for c in 0..3 {
                    of_colours[(first + i) * width + c] = s.of_rgb[c] * s.rgb[c] * (1.0 - s.rgb[c]);
                }
                of_densities.push(if s.density > 0.0 { s.of_density } else { 0.0 });
            }
        }
    }
}
