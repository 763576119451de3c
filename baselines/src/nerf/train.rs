//! A step of training: rays, both passes, Adam.

use super::Nerf;
use super::gradient::{NerfPass, NerfSums, SightedRay};
use super::settings::NerfSettings;
use crate::field::{StepPlace, StepReport};
use crate::loss::{mean_square, square_error};
use crate::rays::{Draw, PhotoRays};
use rayon::prelude::*;
use scene::rng::rng;

impl Nerf {
    /// See [`crate::RadianceField::train_step`].
    pub(super) fn step(&mut self, photos: &PhotoRays, place: StepPlace) -> StepReport {
        let sightings = photos.sample(self.draw(photos.len(), place), place.seed, place.step);
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

    /// The rays of a step: in the middle of the pictures first, and first those of early times.
    fn draw(&self, photos: usize, place: StepPlace) -> Draw {
        let NerfSettings { cropped, crop, ordered, fewest, .. } = self.settings;
        let share = if self.shape.deformed { place.position / ordered } else { 1.0 };
        Draw {
            count: self.shape.rays,
            crop: if place.position < cropped { crop } else { 1.0 },
            admitted: ((share * photos as f64) as usize).max(fewest),
        }
    }

    /// Gradients by stretch of rays; each ray's loss counts as one of `count`.
    pub(super) fn gradients(&self, rays: &[SightedRay], count: usize, place: StepPlace) -> Vec<NerfSums> {
        let second = self.networks.deformation.as_ref().unwrap_or(&self.networks.radiance);
        let transposed =
            [self.networks.radiance.transposed(&self.weights[0]), second.transposed(&self.weights[1])];
        let pass = NerfPass { field: self, transposed: &transposed, weight: 1.0 / count as f32 };
        let stretch = rays.len().div_ceil(self.settings.stretches).max(1);
        rays.par_chunks(stretch)
            .enumerate()
            .map(|(index, rays)| {
                let stream = (u64::from(place.step) << 16) + index as u64;
                pass.stretch(rays, &mut rng(place.seed, "depths", stream))
            })
            .collect()
    }

    fn descend(&mut self, sums: &[NerfSums], place: StepPlace) {
        let NerfSettings { adam, learning_rate, fall, fall_steps, .. } = self.settings;
        let gone = if self.shape.budget { place.position } else { f64::from(place.step) / fall_steps };
        let rates = adam.rates((learning_rate * fall.powf(gone)) as f32, place.step + 1);
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
