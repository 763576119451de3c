//! Pictures: rays are marched a few samples at a time until they are opaque.

use super::InstantNgp;
use super::network::{LATENT, Layers, density, encode_direction};
use super::occupancy::{March, Sample};
use crate::FieldError;
use crate::composite::{OPAQUE, RayColour, opacity};
use crate::mlp::logistic;
use crate::rays::Ray;
use scene::sh::SH_COUNT;

/// Samples that each ray takes in a round. Source: chosen by hand.
const ROUND: usize = 8;

/// A ray that is not yet opaque.
struct Alive {
    ray: usize,
    march: March,
    samples: usize,
}

/// The samples of a round.
pub(super) struct SampleRound<'a> {
    /// Places in the unit cube of the hash grid.
    pub(super) points: &'a [[f32; 3]],
    /// Ray of each sample.
    pub(super) owners: &'a [u32],
    /// Encoded directions of the rays.
    pub(super) directions: &'a [[f32; SH_COUNT]],
}

/// What gives colour and density of each sample of a round.
pub(super) type Shader<'a> = dyn FnMut(SampleRound) -> Result<Vec<[f32; 4]>, FieldError> + 'a;

impl InstantNgp {
    /// Colours, transmittances and distances of rays.
    pub(super) fn trace(
        &self,
        rays: &[Ray],
        background: [f32; 3],
        out: &mut [RayColour],
        shade: &mut Shader,
    ) -> Result<(), FieldError> {
        let directions: Vec<[f32; SH_COUNT]> = rays.iter().map(encode_direction).collect();
        out.fill(RayColour { transmittance: 1.0, ..RayColour::default() });
        let mut alive: Vec<Alive> = rays
            .iter()
            .enumerate()
            .map(|(ray, r)| Alive { ray, march: self.occupancy.march(self.local(r), 0.5), samples: 0 })
            .collect();
        let (mut samples, mut points) = (Vec::new(), Vec::new());
        while !alive.is_empty() {
            samples.clear();
            for a in &mut alive {
                let first = samples.len();
                samples.extend((0..ROUND).map_while(|_| self.occupancy.next(&mut a.march)));
                a.samples = samples.len() - first;
            }
            points.clear();
            points.extend(samples.iter().map(|s: &Sample| self.grid_point(s.position)));
            let owners: Vec<u32> =
                alive.iter().flat_map(|a| std::iter::repeat_n(a.ray as u32, a.samples)).collect();
            let shaded = shade(SampleRound { points: &points, owners: &owners, directions: &directions })?;
            blend(&alive, &samples, &shaded, out);
            alive.retain(|a| a.samples == ROUND && out[a.ray].transmittance >= OPAQUE);
        }
        let unit = 2.0 * self.shape.domain.half;
        for out in out.iter_mut() {
            out.rgb.iter_mut().zip(background).for_each(|(sum, v)| *sum += out.transmittance * v);
            out.distance *= unit;
        }
        Ok(())
    }

    /// Colours and densities by this processor.
    pub(super) fn shade(&self, round: SampleRound, layers: &mut Layers) -> Vec<[f32; 4]> {
        let [of_density, of_colour] = self.shown();
        self.network.densities(&self.grid, of_density, round.points, &mut layers.density);
        let owners: Vec<&[f32; SH_COUNT]> =
            round.owners.iter().map(|&o| &round.directions[o as usize]).collect();
        self.network.colours(of_colour, layers, owners.into_iter());
        let width = self.network.colour.outputs();
        let latent = layers.density.layers[2].chunks_exact(LATENT);
        let rows = latent.zip(layers.colour.layers[3].chunks_exact(width)).take(round.points.len());
        let shaded = rows
            .map(|(latent, rgb)| [logistic(rgb[0]), logistic(rgb[1]), logistic(rgb[2]), density(latent[0])]);
        shaded.collect()
    }
}

/// Adds the samples of a round to what their rays show.
fn blend(alive: &[Alive], samples: &[Sample], shaded: &[[f32; 4]], out: &mut [RayColour]) {
    let mut rows = samples.iter().zip(shaded);
    for a in alive {
        let out = &mut out[a.ray];
        for (sample, &[r, g, b, density]) in rows.by_ref().take(a.samples) {
            let weight = out.transmittance * opacity(density, sample.dt);
            out.rgb.iter_mut().zip([r, g, b]).for_each(|(sum, v)| *sum += weight * v);
            out.distance += weight * sample.t;
            out.transmittance -= weight;
        }
    }
}
