//! A step of training: rays, both passes, Adam.

use super::Nerf;
use super::gradient::{NerfPass, NerfSums, SightedRay};
use super::settings::{GROUP, NerfSettings};
use crate::adam::AdamRates;
use crate::field::{StepPlace, StepReport};
use crate::loss::{mean_square, square_error};
use crate::rays::{Draw, PhotoRays};
#[cfg(feature = "gpu")]
use rand::Rng as _;
use rayon::prelude::*;
use scene::rng::{Rng, rng};

/// Rays of a step, and what those say that miss the field.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MissedRays {
    /// Of all rays.
    pub(super) count: usize,
    pub(super) loss: f64,
    pub(super) square_error: f64,
}

impl Nerf {
    /// See [`crate::RadianceField::train_step`].
    pub(super) fn step(&mut self, photos: &PhotoRays, place: StepPlace) -> StepReport {
        let (rays, missed) = self.sighted(photos, place);
        let sums = self.gradients(&rays, missed.count.max(1), place);
        self.descend(&sums, place);
        let sums = [sums.iter().map(|s| s.loss).sum(), sums.iter().map(|s| s.square_error).sum()];
        self.report(rays.len(), &missed, sums)
    }

    /// The rays of a step that meet the field, and what the others say.
    pub(super) fn sighted(&self, photos: &PhotoRays, place: StepPlace) -> (Vec<SightedRay>, MissedRays) {
        let sightings = photos.sample(self.draw(photos.len(), place), place.seed, place.step);
        let mut missed = MissedRays { count: sightings.len(), ..MissedRays::default() };
        let mut rays = Vec::new();
        for sighting in &sightings {
            match self.local(&sighting.ray) {
                Some((ray, reach)) => rays.push(SightedRay { ray, reach, sighting: *sighting }),
                None => {
                    // Both passes show the background.
                    missed.loss += 2.0 * f64::from(mean_square(sighting.background, sighting.colour).0);
                    missed.square_error += square_error(sighting.background, sighting.colour);
                }
            }
        }
        (rays, missed)
    }

    /// What a step with so many rays in the field saw, from the sums of their losses and squared
    /// errors.
    pub(super) fn report(
        &self,
        rays: usize,
        missed: &MissedRays,
        [loss, square_error]: [f64; 2],
    ) -> StepReport {
        let ([coarse, fine], count) = (self.shape.samples, missed.count.max(1) as f64);
        StepReport {
            loss: (missed.loss + loss) / count,
            square_error: (missed.square_error + square_error) / count,
            rays: missed.count,
            samples: rays * (2 * coarse + fine),
            // Forward, back to the inputs, back to the weights.
            operations: (3 * rays * (2 * coarse + fine) * self.networks.operations()) as f64,
        }
    }

    /// Depths as [`NerfPass::stretch`] draws them.
    #[cfg(feature = "gpu")]
    pub(super) fn drawn(&self, rays: &[SightedRay], place: StepPlace) -> super::device::DrawnDepths {
        let [coarse, fine] = self.shape.samples;
        let mut all = super::device::DrawnDepths::default();
        for (index, rays) in rays.chunks(self.stretch(rays.len())).enumerate() {
            let mut rng = self.depths_rng(place, index);
            for group in rays.chunks(self.group()) {
                let mut offset = || rng.random::<f32>();
                group.iter().for_each(|r| r.reach.stratified(coarse, &mut offset, &mut all.coarse));
                all.offsets.extend((0..group.len() * fine).map(|_| offset()));
            }
        }
        all
    }

    /// Rays of a stretch.
    fn stretch(&self, rays: usize) -> usize {
        rays.div_ceil(self.settings.stretches).max(1)
    }

    /// Rays of a group.
    pub(super) fn group(&self) -> usize {
        (GROUP / self.shape.samples.iter().sum::<usize>()).max(1)
    }

    /// What the depths of a stretch are drawn by.
    fn depths_rng(&self, place: StepPlace, stretch: usize) -> Rng {
        rng(place.seed, "depths", (u64::from(place.step) << 16) + stretch as u64)
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
        rays.par_chunks(self.stretch(rays.len()))
            .enumerate()
            .map(|(index, rays)| pass.stretch(rays, &mut self.depths_rng(place, index)))
            .collect()
    }

    pub(super) fn rates(&self, place: StepPlace) -> AdamRates {
        let NerfSettings { adam, learning_rate, fall, fall_steps, .. } = self.settings;
        let gone = if self.shape.budget { place.position } else { f64::from(place.step) / fall_steps };
        adam.rates((learning_rate * fall.powf(gone)) as f32, place.step + 1)
    }

    pub(super) fn descend(&mut self, sums: &[NerfSums], place: StepPlace) {
        let rates = self.rates(place);
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
