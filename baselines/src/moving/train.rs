//! A step of training: one photo, Gaussians moved to its time; densification; the schedule.

use super::Moving;
use super::settings::{MovingSettings, TimeOpening};
use super::shape::Moved;
use crate::FieldError;
use crate::adam::AdamRates;
use crate::field::{StepPlace, StepReport};
use crate::rays::PhotoRays;
use rand::Rng as _;
use rand::seq::SliceRandom as _;
use scene::rng::rng;
use splat::backend::{Round, StepInput, Target};
use splat::moved::MovedGaussians;
use splat::{PinholeView, RenderOptions};

impl Moving {
    /// See [`crate::RadianceField::train_step`].
    pub(super) fn step(&mut self, photos: &PhotoRays, place: StepPlace) -> Result<StepReport, FieldError> {
        let settings = &self.settings;
        let index = next_photo(photos.len(), settings.open(place.position), place);
        let (view, time) = photos.photo(index);
        let level = settings.level(&view.view, place.position).min(view.levels.len() - 1);
        let pixels = &view.levels[level];
        let transparent = photos.transparent();
        let mut rng = rng(place.seed, "background", u64::from(place.step));
        let background = if transparent { rng.random() } else { [0.0; 3] };
        let steps = if place.step > 0 { f64::from(place.step) / place.position } else { settings.steps };
        let input = StepInput {
            view: &view.view.at_level(level as u32),
            target: Target { rgb: &pixels.rgb, mask: pixels.mask.as_deref(), transparent, photo: None },
            options: RenderOptions { background, ..RenderOptions::default() },
            rates: MovedGaussians::rates(self.shape.pixel, place.position, steps),
            lambda_dssim: settings.lambda_dssim,
        };
        let (rest, count) = (self.gaussians.model().geometry.clone(), self.gaussians.model().len);
        let moves = place.position >= settings.at_rest;
        let mut moved =
            if moves { self.deformation.moved(&rest, count, time)? } else { Moved::rest(&rest, count) };
        let seen = self.gaussians.step(&input, &mut moved.geometry, &mut moved.tint)?;
        if moves {
            let gradient = self.deformation.gradient(&rest, count, time, &moved)?;
            let [planes, weights] = settings.rates_at(place, steps);
            self.deformation.step(gradient, &planes, &weights);
        }
        self.densify(photos, place)?;
        Ok(StepReport {
            loss: f64::from(seen.loss),
            square_error: f64::from(seen.mse),
            rays: input.view.width * input.view.height,
            samples: seen.pairs,
            // Forward twice, back to the inputs, back to the weights.
            operations: if moves { (4 * count * self.deformation.stack.operations()) as f64 } else { 0.0 },
        })
    }

    /// A round of densification, and a higher degree of the harmonics, where they are due.
    fn densify(&mut self, photos: &PhotoRays, place: StepPlace) -> Result<(), FieldError> {
        let MovingSettings { rounds, growth_end, degrees, .. } = self.settings;
        let due = (place.position / growth_end * f64::from(rounds)) as u32;
        if due <= self.rounds || self.rounds >= rounds {
            return Ok(());
        }
        self.rounds = due.min(rounds);
        let count = self.gaussians.model().len;
        let room = self.settings.room(self.shape.gaussians, self.rounds, count);
        let cameras: Vec<PinholeView> = (0..photos.len()).map(|i| photos.photo(i).0.view).collect();
        let remove_unseen = photos.transparent().then_some(&cameras[..]);
        let round = Round { room, seed: place.seed, iteration: place.step, remove_unseen };
        self.gaussians.densify(&round)?;
        let degree = degrees.iter().filter(|&&d| self.rounds >= d).count() as u32;
        self.gaussians.set_sh_degree(degree)?;
        Ok(())
    }
}

/// The photo of a step: of those nearest in time to the middle, a share `open` of all, in a new
/// order each time round.
fn next_photo(photos: usize, open: f64, place: StepPlace) -> usize {
    let (round, at) = (place.step as usize / photos, place.step as usize % photos);
    let shut = ((1.0 - open) / 2.0 * (photos - 1) as f64) as usize;
    let mut order: Vec<usize> = (shut..photos - shut).collect();
    order.shuffle(&mut rng(place.seed, "photos", round as u64));
    order[at % order.len()]
}

impl MovingSettings {
    /// Share of the photos that are seen at a position: what moves is followed from the middle of
    /// the time to both ends.
    fn open(&self, position: f64) -> f64 {
        let TimeOpening { first, until } = self.opening;
        first + (1.0 - first) * (position / until).min(1.0)
    }

    /// Halvings of a view at a position.
    fn level(&self, view: &PinholeView, position: f64) -> usize {
        let wanted = self.resolutions.iter().filter(|&&from| position < from).count();
        let side = view.width.min(view.height);
        (0..=wanted).rev().find(|&l| l == 0 || side >> l >= self.smallest).unwrap_or(0)
    }

    /// How many Gaussians a round may add to `count`: as if none had been removed before, which are
    /// more the longer the schedule is; each may become two. The last round reaches the `most`.
    fn room(&self, most: usize, round: u32, count: usize) -> usize {
        let left = f64::from(self.rounds.saturating_sub(round));
        let wanted = (most as f64 / (1.0 + self.growth).powf(left)) as usize;
        wanted.saturating_sub(count).min(count)
    }

    /// Step sizes of planes and of the perceptron, in a schedule of so many steps.
    fn rates_at(&self, place: StepPlace, steps: f64) -> [AdamRates; 2] {
        let factor = (self.steps / steps).clamp(1.0, self.largest_factor);
        let fall = self.fall.powf((place.position - self.at_rest) / (1.0 - self.at_rest));
        self.rates.map(|rate| self.adam.rates((rate * factor * fall) as f32, place.step + 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_opened_from_the_middle() {
        let settings = MovingSettings::default();
        let seen = |position: f64| {
            let place = |step| StepPlace { step, position, seed: 1 };
            let open = settings.open(position);
            (0..2_000).map(|s| next_photo(101, open, place(s))).collect::<std::collections::BTreeSet<_>>()
        };
        let (first, late) = (seen(0.0), seen(settings.opening.until));
        assert!(first.len() < 20 && first.contains(&50) && !first.contains(&30), "{first:?}");
        assert_eq!(late.len(), 101);
        assert!((1..4).all(|photos| next_photo(
            photos,
            settings.opening.first,
            StepPlace { step: 7, position: 0.0, seed: 1 }
        ) < photos));
    }

    #[test]
    fn densification_makes_up_for_what_was_removed() {
        let settings = MovingSettings::default();
        let room = |round, count| settings.room(30_000, round, count);
        assert_eq!(room(settings.rounds, 26_000), 4_000, "the last round reaches the most");
        assert_eq!(room(settings.rounds, 2_000), 2_000, "each becomes two at most");
        assert_eq!(room(1, 20_000), 0, "a round does not run ahead of the schedule");
    }
}
