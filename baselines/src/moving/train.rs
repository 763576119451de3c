//! A step of training: one photo, Gaussians moved to its time; densification; the schedule.

use super::Moving;
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

/// Share of the schedule in which nothing moves. Source: docs/decisions/19 (Wu et al. 2024: 3,000 of
/// 20,000 steps).
const AT_REST: f64 = 0.08;
/// Positions from which pictures have half, and full resolution; a quarter before.
/// Source: docs/decisions/13, about as for splats that stand still.
const RESOLUTIONS: [f64; 2] = [0.2, 0.5];
/// Smallest side of a photo that is halved, pixels. Source: chosen by hand.
const SMALLEST: usize = 64;
/// Rounds of densification, evenly until [`GROWTH_END`]. Source: chosen by hand.
const ROUNDS: u32 = 12;
/// Position at which the number of Gaussians stays. Source: Wu et al. 2024 (half of the steps).
const GROWTH_END: f64 = 0.6;
/// Share of the Gaussians that a round adds. Source: the first become the most in all rounds.
const GROWTH: f64 = 0.15;
/// Rounds with which degrees of the harmonics begin. Source: chosen by hand.
const DEGREES: [u32; 3] = [4, 6, 8];
/// Weight of D-SSIM. Source: Wu et al. 2024's settings (L1 alone).
const LAMBDA_DSSIM: f32 = 0.0;
/// Step sizes of planes and of the perceptron at the start. Source: Wu et al. 2024's settings.
const RATES: [f64; 2] = [1.6e-3, 1.6e-4];
/// What they fall to. Source: as above.
const FALL: f64 = 0.01;
/// Steps of the authors' schedule: shorter ones have larger steps. Source: as above.
const STEPS: f64 = 20_000.0;
/// Largest factor for that. Source: docs/decisions/19.
const LARGEST_FACTOR: f64 = 10.0;
/// Decay of the second moment. Source: Kingma and Ba 2015.
const BETA2: f32 = 0.999;
/// Against division by nothing. Source: Wu et al. 2024's program.
const EPSILON: f32 = 1e-15;

impl Moving {
    /// See [`crate::RadianceField::train_step`].
    pub(super) fn step(&mut self, photos: &PhotoRays, place: StepPlace) -> Result<StepReport, FieldError> {
        let index = next_photo(photos.len(), place);
        let (view, time) = photos.photo(index);
        let level = level(&view.view, place.position).min(view.levels.len() - 1);
        let pixels = &view.levels[level];
        let transparent = photos.transparent();
        let mut rng = rng(place.seed, "background", u64::from(place.step));
        let background = if transparent { rng.random() } else { [0.0; 3] };
        let steps = if place.step > 0 { f64::from(place.step) / place.position } else { STEPS };
        let input = StepInput {
            view: &view.view.at_level(level as u32),
            target: Target { rgb: &pixels.rgb, mask: pixels.mask.as_deref(), transparent, photo: None },
            options: RenderOptions { background, ..RenderOptions::default() },
            rates: MovedGaussians::rates(self.shape.pixel, place.position, steps),
            lambda_dssim: LAMBDA_DSSIM,
        };
        let (rest, count) = (self.gaussians.model().geometry.clone(), self.gaussians.model().len);
        let moves = place.position >= AT_REST;
        let mut moved = if moves { self.deformation.moved(&rest, count, time) } else { rest.clone() };
        let seen = self.gaussians.step(&input, &mut moved)?;
        if moves {
            let gradient = self.deformation.gradient(&rest, count, time, &moved);
            let factor = (STEPS / steps).clamp(1.0, LARGEST_FACTOR);
            let fall = FALL.powf((place.position - AT_REST) / (1.0 - AT_REST));
            let [planes, weights] = RATES
                .map(|rate| AdamRates::new((rate * factor * fall) as f32, BETA2, EPSILON, place.step + 1));
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
        let due = (place.position / GROWTH_END * f64::from(ROUNDS)) as u32;
        if due <= self.rounds || self.rounds >= ROUNDS {
            return Ok(());
        }
        self.rounds = due.min(ROUNDS);
        let count = self.gaussians.model().len;
        let most = self.shape.gaussians.saturating_sub(count);
        let room = ((count as f64 * GROWTH) as usize).min(most);
        let cameras: Vec<PinholeView> = (0..photos.len()).map(|i| photos.photo(i).0.view).collect();
        let remove_unseen = photos.transparent().then_some(&cameras[..]);
        let round = Round { room, seed: place.seed, iteration: place.step, remove_unseen };
        self.gaussians.densify(&round)?;
        let degree = DEGREES.iter().filter(|&&d| self.rounds >= d).count() as u32;
        self.gaussians.set_sh_degree(degree)?;
        Ok(())
    }
}

/// The photo of a step: all of them in a new order each time round.
fn next_photo(photos: usize, place: StepPlace) -> usize {
    let (round, at) = (place.step as usize / photos, place.step as usize % photos);
    let mut order: Vec<usize> = (0..photos).collect();
    order.shuffle(&mut rng(place.seed, "photos", round as u64));
    order[at]
}

/// Halvings of a view at a position.
fn level(view: &PinholeView, position: f64) -> usize {
    let wanted = RESOLUTIONS.iter().filter(|&&from| position < from).count();
    let side = view.width.min(view.height);
    (0..=wanted).rev().find(|&l| l == 0 || side >> l >= SMALLEST).unwrap_or(0)
}
