//! A step of training: march, encode, forward and backward, scatter, Adam, occupancy.

use super::InstantNgp;
use super::gradient::{Pass, RayBatch, Sums, TrainingRay};
use super::hash_grid::{CHUNK, Corner, FEATURES};
use super::network::{LATENT, Weights, density};
use super::occupancy::cell_point;
use super::settings::OccupancySettings;
use crate::adam::AdamRates;
use crate::field::{StepPlace, StepReport};
use crate::mlp::Activations;
use crate::rays::{Draw, PhotoRays, Sighting};
use rand::Rng as _;
use rayon::prelude::*;
use scene::rng::{Rng, rng};

/// Cells that are evaluated together. Source: a second-level cache of 512 KiB.
const BLOCK: usize = 1024;
impl InstantNgp {
    /// See [`crate::RadianceField::train_step`].
    pub(super) fn step(&mut self, photos: &PhotoRays, place: StepPlace) -> StepReport {
        if place.step.is_multiple_of(self.settings.occupancy.every) {
            self.update_occupancy(place);
        }
        let sightings = photos.sample(Draw::anywhere(self.rays), place.seed, place.step);
        let mut batch = self.march(&sightings, place);
        self.grid.encode(&batch.points, &mut batch.features);
        let sums = self.gradients(&batch);
        self.descend(&batch, &sums, place);
        let survivors = sums.iter().map(|s| s.survivors.len()).sum();
        let losses = [sums.iter().map(|s| s.loss).sum(), sums.iter().map(|s| s.square_error).sum()];
        self.report(&batch, losses, survivors)
    }

    /// What a step saw, from the sums of its rays' losses and squared errors; and how many rays the
    /// next one takes.
    pub(super) fn report(
        &mut self,
        batch: &RayBatch,
        [loss, square_error]: [f64; 2],
        survivors: usize,
    ) -> StepReport {
        let rays = batch.rays.len().max(1);
        let report = StepReport {
            loss: loss / rays as f64,
            square_error: square_error / rays as f64,
            rays: batch.rays.len(),
            samples: batch.samples.len(),
            operations: self.operations(batch.samples.len(), survivors),
        };
        let seen = batch.samples.len().max(1);
        self.rays = (rays * self.shape.samples / seen).clamp(1, (2 * self.rays).min(self.settings.most_rays));
        report
    }

    /// Products of weights and sums of a step: densities of all samples, and all else of those
    /// seen.
    fn operations(&self, samples: usize, survivors: usize) -> f64 {
        let [density, colour] = [&self.network.density, &self.network.colour].map(|n| 2 * n.parameters());
        (samples * density + survivors * (2 * density + 3 * colour)) as f64
    }

    /// The samples of rays in occupied cells.
    pub(super) fn march(&self, sightings: &[Sighting], place: StepPlace) -> RayBatch {
        let stretch = sightings.len().div_ceil(self.settings.stretches).max(1);
        let parts: Vec<RayBatch> = sightings
            .par_chunks(stretch)
            .enumerate()
            .map(|(index, sightings)| {
                let stream = (u64::from(place.step) << 16) + index as u64;
                self.march_stretch(sightings, &mut rng(place.seed, "march", stream))
            })
            .collect();
        let mut all = RayBatch::default();
        for part in parts {
            let begin = all.samples.len();
            all.rays.extend(part.rays.into_iter().map(|r| TrainingRay { begin: r.begin + begin, ..r }));
            all.samples.extend(part.samples);
            all.points.extend(part.points);
        }
        all
    }

    fn march_stretch(&self, sightings: &[Sighting], rng: &mut Rng) -> RayBatch {
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
            linear_from: self.settings.linear_from,
        };
        let stretch = batch.rays.len().div_ceil(self.settings.stretches).max(1);
        batch.rays.par_chunks(stretch).map(|rays| pass.stretch(batch, rays)).collect()
    }

    /// Adam on the networks and, level by level, on the tables.
    pub(super) fn descend(&mut self, batch: &RayBatch, sums: &[Sums], place: StepPlace) {
        let rates = self.rates(place);
        let with_decay = AdamRates { decay: self.settings.decay, ..rates };
        let of: [fn(&Sums) -> &Vec<f32>; 2] = [|s| &s.density, |s| &s.colour];
        let networks = self.weights.iter_mut().zip(&mut self.moments).zip(of);
        for ((weights, moments), of) in networks {
            let mut gradient = vec![0.0; weights.len()];
            for part in sums {
                gradient.iter_mut().zip(of(part)).for_each(|(g, p)| *g += p);
            }
            moments.step(weights, &mut gradient, &with_decay);
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

    /// Of the tables; the networks have weight decay besides.
    pub(super) fn rates(&self, place: StepPlace) -> AdamRates {
        let settings = &self.settings;
        let falls = settings.falls.iter().filter(|&&at| place.position >= at).count();
        let rate = settings.learning_rate * settings.fall.powi(falls as i32);
        let rates = settings.adam.rates(rate as f32, place.step + 1);
        AdamRates { average: (place.position >= settings.average_from).then_some(settings.average), ..rates }
    }

    /// Looks at the densities of cells again: of all that count as occupied, as densities decay and
    /// only what is found anew keeps them so, and of some others, which come back in this way.
    fn update_occupancy(&mut self, place: StepPlace) {
        let mut densities = std::mem::take(&mut self.occupancy.density);
        densities.par_chunks_mut(CHUNK).enumerate().for_each(|(index, densities)| {
            let (cells, points) = self.revisited(index, densities, place);
            let mut layers = Activations::default();
            for (cells, points) in cells.chunks(BLOCK).zip(points.chunks(BLOCK)) {
                self.network.densities(&self.grid, &self.weights[0], points, &mut layers);
                for (&i, outputs) in cells.iter().zip(layers.layers[2].chunks_exact(LATENT)) {
                    densities[i] = densities[i].max(density(outputs[0]));
                }
            }
        });
        self.occupancy.set_density(densities);
    }

    /// Lets the densities of chunk `index` of all cells decay; the cells to be looked at, counted
    /// within the chunk, and a place in each.
    pub(super) fn revisited(
        &self,
        index: usize,
        densities: &mut [f32],
        place: StepPlace,
    ) -> (Vec<usize>, Vec<[f32; 3]>) {
        let OccupancySettings { anywhere, kept, .. } = self.settings.occupancy;
        let stream = (u64::from(place.step) << 20) + index as u64;
        let (first, mut rng) = (index * CHUNK, rng(place.seed, "occupancy", stream));
        let mut cells = Vec::new();
        for (i, density) in densities.iter_mut().enumerate().filter(|(_, density)| **density >= 0.0) {
            *density *= kept;
            if rng.random::<f32>() < anywhere || self.occupancy.is_occupied(first + i) {
                cells.push(i);
            }
        }
        let points = cells.iter().map(|i| {
            let jitter = rng.random::<[f32; 3]>().map(|j| j - 0.5);
            self.grid_point(cell_point(first + i, jitter))
        });
        let points = points.collect();
        (cells, points)
    }
}
