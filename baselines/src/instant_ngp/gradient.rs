//! Forward and backward through the networks for a stretch of rays, whose activations stay in the
//! cache.

use super::hash_grid::{Corner, FEATURES};
use super::network::{LATENT, Layers, NgpNetwork, Weights, density, encode_direction};
use super::occupancy::Sample;
use crate::composite::{Traced, compose, compose_backward, seen};
use crate::loss::{huber, square_error};
use crate::mlp::logistic;
use crate::rays::Sighting;
use scene::sh::SH_COUNT;

/// Samples whose activations are held at a time, unless one ray has more.
/// Source: half a second-level cache of 512 KiB.
const GROUP: usize = 256;

/// A ray of a step and its samples.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TrainingRay {
    pub(crate) sighting: Sighting,
    /// Its first sample.
    pub(crate) begin: usize,
    /// Number of its samples.
    pub(crate) count: usize,
}

/// The samples of a step.
#[derive(Clone, Debug, Default)]
pub(crate) struct RayBatch {
    pub(crate) rays: Vec<TrainingRay>,
    pub(crate) samples: Vec<Sample>,
    /// Positions in the unit cube of the hash grid.
    pub(crate) points: Vec<[f32; 3]>,
    /// Features by level.
    pub(crate) features: Vec<Vec<Corner>>,
}

/// What a stretch of rays adds up to.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sums {
    pub(crate) density: Vec<f32>,
    pub(crate) colour: Vec<f32>,
    pub(crate) loss: f64,
    pub(crate) square_error: f64,
    /// Samples that are seen.
    pub(crate) survivors: Vec<u32>,
    /// Gradients of their features: [survivors × levels · FEATURES].
    pub(crate) of_features: Vec<f32>,
}

/// Networks, weights and their transposes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pass<'a> {
    pub(crate) network: &'a NgpNetwork,
    pub(crate) weights: Weights<'a>,
    pub(crate) transposed: Weights<'a>,
    /// Weight of a ray's loss.
    pub(crate) weight: f32,
    /// See [`huber`].
    pub(crate) linear_from: f32,
}

/// Buffers of a stretch.
#[derive(Default)]
struct GroupBuffers {
    layers: Layers,
    directions: Vec<[f32; SH_COUNT]>,
    /// By ray of the group: how many of its samples are seen.
    counts: Vec<usize>,
    traced: Vec<Traced>,
    of_colour: Vec<f32>,
    of_density: Vec<f32>,
}

impl Pass<'_> {
    /// The gradients of a stretch of rays.
    pub(crate) fn stretch(&self, batch: &RayBatch, rays: &[TrainingRay]) -> Sums {
        let mut sums = Sums {
            density: vec![0.0; self.network.density.parameters()],
            colour: vec![0.0; self.network.colour.parameters()],
            ..Sums::default()
        };
        let mut scratch = GroupBuffers::default();
        let mut begin = 0;
        while begin < rays.len() {
            let (mut end, mut samples) = (begin, 0);
            while end < rays.len() && (end == begin || samples + rays[end].count <= GROUP) {
                samples += rays[end].count;
                end += 1;
            }
            self.group(batch, &rays[begin..end], &mut scratch, &mut sums);
            begin = end;
        }
        sums
    }

    fn group(&self, batch: &RayBatch, rays: &[TrainingRay], scratch: &mut GroupBuffers, sums: &mut Sums) {
        let first = rays[0].begin;
        let samples: usize = rays.iter().map(|r| r.count).sum();
        self.evaluate_densities(batch, first..first + samples, scratch);
        let survivors = self.keep_seen(batch, rays, scratch, sums);
        self.network.colours(self.weights.colour, &mut scratch.layers, scratch.directions.iter());
        self.trace(batch, rays, scratch, sums);
        if survivors > 0 {
            self.propagate(survivors, scratch, sums);
        }
    }

    fn evaluate_densities(
        &self,
        batch: &RayBatch,
        range: std::ops::Range<usize>,
        scratch: &mut GroupBuffers,
    ) {
        let layers = &mut scratch.layers.density;
        self.network.density.reserve(range.len(), layers);
        let width = self.network.density.inputs();
        for (level, features) in batch.features.iter().enumerate() {
            let rows = layers.layers[0].chunks_exact_mut(width);
            for (row, f) in rows.zip(&features[range.clone()]) {
                row[level * FEATURES..][..FEATURES].copy_from_slice(f);
            }
        }
        self.network.density.forward(self.weights.density, layers);
    }

    /// Moves the activations of what is seen to the front; says how many there are.
    fn keep_seen(
        &self,
        batch: &RayBatch,
        rays: &[TrainingRay],
        scratch: &mut GroupBuffers,
        sums: &mut Sums,
    ) -> usize {
        let first = rays[0].begin;
        scratch.counts.clear();
        scratch.directions.clear();
        let layers = &mut scratch.layers.density.layers;
        let widths = self.network.density.widths();
        let mut to = 0;
        for ray in rays {
            let from = ray.begin - first;
            let outputs = layers[2][from * LATENT..].chunks_exact(LATENT).map(|o| density(o[0]));
            let steps = batch.samples[ray.begin..][..ray.count].iter().map(|s| s.dt);
            let count = seen(outputs, steps);
            for (layer, &width) in layers.iter_mut().zip(widths) {
                layer.copy_within(from * width..(from + count) * width, to * width);
            }
            sums.survivors.extend((ray.begin..ray.begin + count).map(|i| i as u32));
            scratch.counts.push(count);
            let direction = encode_direction(&ray.sighting.ray);
            scratch.directions.extend(std::iter::repeat_n(direction, count));
            to += count;
        }
        self.network.density.reserve(to, &mut scratch.layers.density);
        to
    }

    /// Colours, losses, and their gradients with respect to the networks' outputs.
    fn trace(&self, batch: &RayBatch, rays: &[TrainingRay], scratch: &mut GroupBuffers, sums: &mut Sums) {
        let colour_width = self.network.colour.outputs();
        let GroupBuffers { layers, counts, traced, of_colour, of_density, .. } = scratch;
        let colours = &layers.colour.layers[3];
        let latent = &layers.density.layers[2];
        for (buffer, like) in [(&mut *of_colour, colours), (&mut *of_density, latent)] {
            buffer.clear();
            buffer.resize(like.len(), 0.0);
        }
        let mut at = 0;
        for (ray, &count) in rays.iter().zip(counts.iter()) {
            traced.clear();
            traced.extend((at..at + count).zip(&batch.samples[ray.begin..]).map(|(i, s)| Traced {
                density: density(latent[i * LATENT]),
                dt: s.dt,
                rgb: [0, 1, 2].map(|c| logistic(colours[i * colour_width + c])),
                ..Traced::default()
            }));
            let background = ray.sighting.background;
            let shown = compose(traced.iter().map(|s| (s.density, s.dt, 0.0, s.rgb)), background);
            let (loss, of_ray) = huber(shown.rgb, ray.sighting.colour, self.linear_from);
            sums.loss += f64::from(loss);
            sums.square_error += square_error(shown.rgb, ray.sighting.colour);
            compose_backward(traced, background, of_ray.map(|g| g * self.weight));
            for (i, s) in (at..).zip(traced.iter()) {
                for c in 0..3 {
                    of_colour[i * colour_width + c] = s.of_rgb[c] * s.rgb[c] * (1.0 - s.rgb[c]);
                }
                of_density[i * LATENT] = s.of_density * s.density;
            }
            at += count;
        }
    }

    /// From the gradients of the outputs to those of weights and features.
    fn propagate(&self, survivors: usize, scratch: &mut GroupBuffers, sums: &mut Sums) {
        let GroupBuffers { layers, of_colour, of_density, .. } = scratch;
        let of_inputs = self.network.colour.backward(
            self.transposed.colour,
            &mut layers.colour,
            of_colour,
            &mut sums.colour,
        );
        let rows = of_inputs.chunks_exact(LATENT + SH_COUNT);
        for (sum, row) in of_density.chunks_exact_mut(LATENT).zip(rows).take(survivors) {
            sum.iter_mut().zip(row).for_each(|(s, r)| *s += r);
        }
        let of_features = self.network.density.backward(
            self.transposed.density,
            &mut layers.density,
            of_density,
            &mut sums.density,
        );
        let width = self.network.density.inputs();
        sums.of_features.extend_from_slice(&of_features[..survivors * width]);
    }
}
