//! Pictures: rays are marched a few samples at a time until they are opaque.

use super::InstantNgp;
use super::network::{LATENT, Layers, density, encode_direction};
use super::occupancy::{March, Sample};
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

impl InstantNgp {
    /// Colours, transmittances and distances of rays.
    pub(super) fn trace(&self, rays: &[Ray], background: [f32; 3], out: &mut [RayColour]) {
        let directions: Vec<[f32; SH_COUNT]> = rays.iter().map(encode_direction).collect();
        out.fill(RayColour { transmittance: 1.0, ..RayColour::default() });
        let mut alive: Vec<Alive> = rays
            .iter()
            .enumerate()
            .map(|(ray, r)| Alive { ray, march: self.occupancy.march(self.local(r), 0.5), samples: 0 })
            .collect();
        let (mut layers, mut samples, mut points) = (Layers::default(), Vec::new(), Vec::new());
        while !alive.is_empty() {
            samples.clear();
            for a in &mut alive {
                let first = samples.len();
                samples.extend((0..ROUND).map_while(|_| self.occupancy.next(&mut a.march)));
                a.samples = samples.len() - first;
            }
            points.clear();
            points.extend(samples.iter().map(|s: &Sample| self.grid_point(s.position)));
            let [of_density, of_colour] = self.shown();
            self.network.densities(&self.grid, of_density, &points, &mut layers.density);
            let owners: Vec<&[f32; SH_COUNT]> =
                alive.iter().flat_map(|a| std::iter::repeat_n(&directions[a.ray], a.samples)).collect();
            self.network.colours(of_colour, &mut layers, owners.into_iter());
            self.blend(&alive, &samples, &layers, out);
            alive.retain(|a| a.samples == ROUND && out[a.ray].transmittance >= OPAQUE);
        }
        let unit = 2.0 * self.shape.domain.half;
        for out in out.iter_mut() {
            out.rgb.iter_mut().zip(background).for_each(|(sum, v)| *sum += out.transmittance * v);
            out.distance *= unit;
        }
    }

    fn blend(&self, alive: &[Alive], samples: &[Sample], layers: &Layers, out: &mut [RayColour]) {
        let width = self.network.colour.outputs();
        let rows =
            layers.density.layers[2].chunks_exact(LATENT).zip(layers.colour.layers[3].chunks_exact(width));
        let mut rows = samples.iter().zip(rows);
        for a in alive {
            let out = &mut out[a.ray];
            for (sample, (latent, rgb)) in rows.by_ref().take(a.samples) {
                let weight = out.transmittance * opacity(density(latent[0]), sample.dt);
                out.rgb.iter_mut().zip(rgb).for_each(|(sum, &v)| *sum += weight * logistic(v));
                out.distance += weight * sample.t;
                out.transmittance -= weight;
            }
        }
    }
}
