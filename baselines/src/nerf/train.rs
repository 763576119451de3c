//! A step of training: rays, both passes, Adam.

use super::Nerf;
use super::gradient::{NerfPass, NerfSums, SightedRay};
use crate::adam::AdamRates;
use crate::field::{StepPlace, StepReport};
use crate::loss::{mean_square, square_error};
use crate::rays::{Draw, PhotoRays};
use rayon::prelude::*;
use scene::rng::rng;

/// Learning rate. Source: Mildenhall et al. 2020, section 5.3.
const LEARNING_RATE: f64 = 5e-4;
/// What it falls to. Source: as above (5e-5).
const FALL: f64 = 0.1;
/// Steps in which it falls by that. Source: the authors' program (`lrate_decay` 500).
const FALL_STEPS: f64 = 500_000.0;
/// Decay of the second moment. Source: Mildenhall et al. 2020, section 5.3.
const BETA2: f32 = 0.999;
/// Against division by nothing. Source: Mildenhall et al. 2020, section 5.3 (1e-7).
const EPSILON: f32 = 1e-7;
/// Share of the schedule in which only the middle of the pictures is seen.
/// Source: D-NeRF's program: 500 steps, of 50,000.
const CROPPED: f64 = 0.01;
/// Share of a side that is the middle. Source: D-NeRF's program.
const CROP: f32 = 0.5;
/// Share of the schedule in which times are admitted in order.
/// Source: Pumarola et al. 2021's settings: 10,000 steps, of 50,000.
const ORDERED: f64 = 0.2;
/// Stretches of rays whose gradients are added up apart. Source: chosen by hand; part of the
/// result, as sums have a fixed order; each holds all gradients once.
const STRETCHES: usize = 16;

impl Nerf {
    /// See [`crate::RadianceField::train_step`].
    pub(super) fn step(&mut self, photos: &PhotoRays, place: StepPlace) -> StepReport {
        let draw = Draw {
            count: self.shape.rays,
            crop: if place.position < CROPPED { CROP } else { 1.0 },
            admitted: if self.shape.deformed { place.position / ORDERED } else { 1.0 },
        };
        let sightings = photos.sample(draw, place.seed, place.step);
        let (mut rays, mut loss, mut error) = (Vec::new(), 0.0, 0.0);
        for sighting in &sightings {
            match self.local(&sighting.ray) {
                Some((ray, reach)) => rays.push(SightedRay { ray, reach, sighting: *sighting }),
                None => {
                    // Both passes show the background.
                    loss += 2.0 * f64::from(mean_square(sighting.background, sighting.colour).0);
                    error += square_error(sighting.background, sighting.colour);
                }
            }
        }
        let count = sightings.len().max(1);
        let sums = self.gradients(&rays, count, place);
        self.descend(&sums, place);
        let [coarse, fine] = self.shape.samples;
        StepReport {
            loss: (loss + sums.iter().map(|s| s.loss).sum::<f64>()) / count as f64,
            square_error: (error + sums.iter().map(|s| s.square_error).sum::<f64>()) / count as f64,
            rays: sightings.len(),
            samples: rays.len() * (2 * coarse + fine),
            // Forward, back to the inputs, back to the weights.
            operations: (3 * rays.len() * (2 * coarse + fine) * self.networks.operations()) as f64,
        }
    }

    /// Gradients by stretch of rays; each ray's loss counts as one of `count`.
    pub(super) fn gradients(&self, rays: &[SightedRay], count: usize, place: StepPlace) -> Vec<NerfSums> {
        let second = self.networks.deformation.as_ref().unwrap_or(&self.networks.radiance);
        let transposed =
            [self.networks.radiance.transposed(&self.weights[0]), second.transposed(&self.weights[1])];
        let pass = NerfPass { field: self, transposed: &transposed, weight: 1.0 / count as f32 };
        let stretch = rays.len().div_ceil(STRETCHES).max(1);
        let part = |(index, rays): (usize, &[SightedRay])| {
            let mut rng = rng(place.seed, "depths", (u64::from(place.step) << 16) + index as u64);
            pass.stretch(rays, &mut rng)
        };
        rays.par_chunks(stretch).enumerate().map(part).collect()
    }

    fn descend(&mut self, sums: &[NerfSums], place: StepPlace) {
        let gone = f64::from(place.step) / FALL_STEPS;
        let gone = if self.shape.budget { place.position } else { gone };
        let rate = LEARNING_RATE * FALL.powf(gone);
        let rates = AdamRates::new(rate as f32, BETA2, EPSILON, place.step + 1);
        let parts = self.weights.iter_mut().zip(&mut self.moments).enumerate();
        parts.for_each(|(part, (weights, moments))| {
            let mut gradient = vec![0.0f32; weights.len()];
            for sum in sums {
                gradient.iter_mut().zip(&sum.gradients[part]).for_each(|(g, s)| *g += s);
            }
            moments.step(weights, &mut gradient, &rates);
        });
    }
}
