//! A step of training: march, encode, forward and backward, scatter, Adam, occupancy.

use super::InstantNgp;
use super::gradient::{Pass, RayBatch, Sums, TrainingRay};
use super::hash_grid::{Corner, FEATURES};
use super::network::{LATENT, Weights, density};
use super::occupancy::cell_point;
use crate::adam::AdamRates;
use crate::field::{StepPlace, StepReport};
use crate::mlp::Activations;
use crate::rays::{Draw, PhotoRays, Sighting};
use rand::Rng as _;
use rayon::prelude::*;
use scene::rng::rng;

/// Most rays of a step. Source: as many as samples: each ray has one at least.
const MOST_RAYS: usize = 1 << 18;
/// Learning rate. Source: Müller et al. 2022, section 4.
const LEARNING_RATE: f64 = 1e-2;
/// Decay of the second moment. Source: Müller et al. 2022, section 4.
const BETA2: f32 = 0.99;
/// Against division by nothing. Source: Müller et al. 2022, section 4.
const EPSILON: f32 = 1e-15;
/// Weight decay of the networks. Source: Müller et al. 2022, section 4.
const DECAY: f32 = 1e-6;
/// Factor of the learning rate at each of [`FALLS`]. Source: the authors' base configuration.
const FALL: f64 = 0.33;
/// Positions in the schedule at which it falls.
/// Source: the base configuration: steps 20,000, 30,000 and 40,000 of 50,000.
const FALLS: [f64; 3] = [0.4, 0.6, 0.8];
/// Position from which the weights are averaged: what lies earlier no longer counts at the end.
/// Source: 0.95 to the power of the steps left is nothing.
const AVERAGE_FROM: f64 = 0.9;
/// Steps between updates of the occupancy. Source: Müller et al. 2022, appendix E.2.
const OCCUPANCY_EVERY: u32 = 16;
/// Cells that an update visits, in samples of a step: an update costs less than one step.
/// Source: Müller et al. 2022, appendix E.2, visit 2²⁰ cells where a step has 2¹⁸ samples.
const VISITED: usize = 4;
/// Share of a cell's density that an update keeps. Source: Müller et al. 2022, appendix E.2.
const KEPT: f32 = 0.95;
/// Stretches of rays whose gradients are added up apart: many enough for many threads.
/// Source: chosen by hand; part of the result, as sums have a fixed order.
const STRETCHES: usize = 32;
/// Cells that are evaluated together. Source: a second-level cache of 512 KiB.
const BLOCK: usize = 1024;
/// Cells of a task. Source: chosen by hand: many tasks for many threads.
const CHUNK: usize = 1 << 14;

impl InstantNgp {
    /// See [`crate::RadianceField::train_step`].
    pub(super) fn step(&mut self, photos: &PhotoRays, place: StepPlace) -> StepReport {
        if place.step.is_multiple_of(OCCUPANCY_EVERY) {
            self.update_occupancy(place);
        }
        let sightings = photos.sample(Draw::anywhere(self.rays), place.seed, place.step);
        let mut batch = self.march(&sightings, place);
        self.grid.encode(&batch.points, &mut batch.features);
        let sums = self.gradients(&batch);
        self.descend(&batch, &sums, place);
        let rays = batch.rays.len().max(1);
        let mean = |of: fn(&Sums) -> f64| sums.iter().map(of).sum::<f64>() / rays as f64;
        let survivors = sums.iter().map(|s| s.survivors.len()).sum();
        let report = StepReport {
            loss: mean(|s| s.loss),
            square_error: mean(|s| s.square_error),
            rays: batch.rays.len(),
            samples: batch.samples.len(),
            operations: self.operations(batch.samples.len(), survivors),
        };
        let seen = batch.samples.len().max(1);
        self.rays = (rays * self.shape.samples / seen).clamp(1, (2 * self.rays).min(MOST_RAYS));
        report
    }

    /// Products of weights and sums of a step: densities of all samples, and all else of those seen.
    fn operations(&self, samples: usize, survivors: usize) -> f64 {
        let [density, colour] = [&self.network.density, &self.network.colour].map(|n| 2 * n.parameters());
        (samples * density + survivors * (2 * density + 3 * colour)) as f64
    }

    /// The samples of rays in occupied cells.
    fn march(&self, sightings: &[Sighting], place: StepPlace) -> RayBatch {
        let stretch = sightings.len().div_ceil(STRETCHES).max(1);
        let part = |(index, sightings): (usize, &[Sighting])| {
            let mut rng = rng(place.seed, "march", (u64::from(place.step) << 16) + index as u64);
            let mut batch = RayBatch::default();
            for &sighting in sightings {
                let begin = batch.samples.len();
                let mut march = self.occupancy.march(self.local(&sighting.ray), rng.random());
                while let Some(sample) = self.occupancy.next(&mut march) {
                    batch.points.push(self.grid_point(sample.position));
                    batch.samples.push(sample);
                }
                batch.rays.push(TrainingRay { sighting, begin, count: batch.samples.len() - begin });
            }
            batch
        };
        let parts: Vec<RayBatch> = sightings.par_chunks(stretch).enumerate().map(part).collect();
        let mut all = RayBatch::default();
        for part in parts {
            let begin = all.samples.len();
            all.rays.extend(part.rays.into_iter().map(|r| TrainingRay { begin: r.begin + begin, ..r }));
            all.samples.extend(part.samples);
            all.points.extend(part.points);
        }
        all
    }

    /// Gradients by stretch of rays.
    fn gradients(&self, batch: &RayBatch) -> Vec<Sums> {
        let transposed = [
            self.network.density.transposed(&self.weights[0]),
            self.network.colour.transposed(&self.weights[1]),
        ];
        let pass = Pass {
            network: &self.network,
            weights: self.weights(),
            transposed: Weights { density: &transposed[0], colour: &transposed[1] },
            weight: 1.0 / batch.rays.len().max(1) as f32,
        };
        let stretch = batch.rays.len().div_ceil(STRETCHES).max(1);
        batch.rays.par_chunks(stretch).map(|rays| pass.stretch(batch, rays)).collect()
    }

    /// Adam on the networks and, level by level, on the tables.
    fn descend(&mut self, batch: &RayBatch, sums: &[Sums], place: StepPlace) {
        let falls = FALLS.iter().filter(|&&at| place.position >= at).count();
        let rate = LEARNING_RATE * FALL.powi(falls as i32);
        let rates = AdamRates {
            average: place.position >= AVERAGE_FROM,
            ..AdamRates::new(rate as f32, BETA2, EPSILON, place.step + 1)
        };
        let of: [fn(&Sums) -> &Vec<f32>; 2] = [|s| &s.density, |s| &s.colour];
        let networks = self.weights.iter_mut().zip(&mut self.moments).zip(of);
        for ((weights, moments), of) in networks {
            let mut gradient = vec![0.0; weights.len()];
            for part in sums {
                gradient.iter_mut().zip(of(part)).for_each(|(g, p)| *g += p);
            }
            moments.step(weights, &mut gradient, &AdamRates { decay: DECAY, ..rates });
        }
        let width = self.network.density.inputs();
        self.grid.tables.par_iter_mut().enumerate().rev().for_each(|(level, table)| {
            for part in sums {
                let rows = part.of_features.chunks_exact(width);
                table.scatter(part.survivors.iter().zip(rows).map(|(&i, row)| {
                    let gradient: Corner = std::array::from_fn(|k| row[level * FEATURES + k]);
                    (batch.points[i as usize], gradient)
                }));
            }
            table.step(&rates);
        });
    }

    /// Looks at the densities of cells again.
    fn update_occupancy(&mut self, place: StepPlace) {
        let update = (place.step / OCCUPANCY_EVERY) as usize;
        let few = (self.occupancy.density.len() / (VISITED * self.shape.samples)).max(1);
        let apart = if place.step == 0 { 1 } else { few };
        let mut densities = std::mem::take(&mut self.occupancy.density);
        densities.iter_mut().filter(|d| **d > 0.0).for_each(|d| *d *= KEPT);
        let visit = |(index, densities): (usize, &mut [f32])| {
            let mut rng = rng(place.seed, "occupancy", (u64::from(place.step) << 20) + index as u64);
            let first = index * CHUNK;
            let cells: Vec<usize> = (0..densities.len())
                .filter(|i| (first + i + update).is_multiple_of(apart) && densities[*i] >= 0.0)
                .collect();
            let mut layers = Activations::default();
            for cells in cells.chunks(BLOCK) {
                let points: Vec<[f32; 3]> = cells
                    .iter()
                    .map(|i| {
                        let jitter = rng.random::<[f32; 3]>().map(|j| j - 0.5);
                        self.grid_point(cell_point(first + i, jitter))
                    })
                    .collect();
                self.network.densities(&self.grid, &self.weights[0], &points, &mut layers);
                for (&i, outputs) in cells.iter().zip(layers.layers[2].chunks_exact(LATENT)) {
                    densities[i] = densities[i].max(density(outputs[0]));
                }
            }
        };
        densities.par_chunks_mut(CHUNK).enumerate().for_each(visit);
        self.occupancy.density = densities;
        self.occupancy.refresh();
    }
}
