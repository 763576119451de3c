//! What changes as training goes on: resolution and step sizes. Everything is a function of the
//! position in the schedule, 0 at the start and 1 at the end, so that a schedule of any length ends
//! converged.

use crate::backend::LearningRates;
use crate::config::TrainConfig;
use serde::{Deserialize, Serialize};

/// How far training has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Place {
    /// Steps done.
    pub(crate) iteration: u32,
    /// Position in the schedule, [0, 1].
    pub(crate) position: f64,
    /// Seconds spent so far.
    pub(crate) seconds: f64,
    /// Whether full resolution begins early, once that is decided.
    pub(crate) early: Option<bool>,
}

/// Position at which Gaussians stop being added.
/// Source: chosen by hand, never measured.
pub(crate) const GROWTH_END: f64 = 0.7;

/// Parts of the schedule between the places at which poses are moved and scales are held, a share.
/// Source: docs/decisions/13 (scales twenty times in a schedule); for poses chosen by hand.
pub(crate) const EVERY: f64 = 0.05;

/// Steps of a schedule from which full resolution begins early: a shorter one needs steps more than
/// pixels.
/// Source: docs/decisions/12.
pub(crate) const EARLY_FROM_STEPS: f64 = 2000.0;

/// When the resolution changes, as positions in the schedule. Source: docs/decisions/12.
struct ResolutionPlan {
    /// Half the resolution from here on (0.4 against 0.2 and 0.1 on seven captures).
    half_from: f64,
    /// Full resolution from here on; in schedules of [`EARLY_FROM_STEPS`] and more the second.
    full_from: [f64; 2],
    /// Here that is decided, near the second of those: what steps cost at half the resolution is
    /// known by then.
    early_decided: f64,
}

/// See [`ResolutionPlan`].
const PLAN: ResolutionPlan = ResolutionPlan { half_from: 0.4, full_from: [0.8, 0.6], early_decided: 0.55 };

/// Decided before either begins, so that no step sees a coarser picture than the one before.
const _: () = assert!(
    PLAN.half_from < PLAN.early_decided
        && PLAN.early_decided < PLAN.full_from[1]
        && PLAN.full_from[1] < PLAN.full_from[0]
);

impl Place {
    /// Decides, once the place for it is reached, whether a schedule of `steps` steps sees full
    /// resolution early.
    pub(crate) fn decide_early(&mut self, steps: f64) {
        if self.early.is_none() && self.position >= PLAN.early_decided {
            self.early = Some(steps >= EARLY_FROM_STEPS);
        }
    }

    /// Level in use (0: full resolution), with `levels` coarser ones to pass through.
    pub(crate) fn level(&self, levels: u32) -> u32 {
        level(self.position, levels, self.early.unwrap_or(false))
    }
}

/// Level (0: full resolution) at a position, with `levels` coarser ones to pass through; `early`:
/// see [`Place::decide_early`].
pub(crate) fn level(position: f64, levels: u32, early: bool) -> u32 {
    let passed = if position >= PLAN.full_from[usize::from(early)] {
        levels
    } else if position >= PLAN.half_from || levels == 0 {
        levels.saturating_sub(1)
    } else {
        // The levels coarser than a half share what comes before.
        (position / PLAN.half_from * f64::from(levels - 1)).floor() as u32
    };
    levels - passed
}

/// Steps for which the step sizes were measured; the last ones are lowered where there are more.
/// Source: docs/decisions/12 (its schedules have 500 to 1,000 steps).
pub(crate) const TUNED_STEPS: f32 = 500.0;

/// A step size that falls exponentially over the schedule.
struct Decay {
    /// At the start.
    first: f32,
    /// At the end of [`TUNED_STEPS`].
    last: f32,
    /// The end's fall with the number of steps: `last · (TUNED_STEPS / steps)^power`.
    power: f32,
}

/// Step sizes of means (pixels), log-scales, quaternions, opacity logits, constant colours and
/// higher harmonics.
/// Source: docs/decisions/12. From twice the first of the log-scales on, dark and noisy pictures
/// are not learnt at all.
const RATES: [Decay; 6] = [
    Decay { first: 1.0, last: 0.06, power: 1.5 },
    Decay { first: 8e-2, last: 2e-2, power: 0.7 },
    Decay { first: 2e-2, last: 5e-3, power: 0.5 },
    Decay { first: 0.12, last: 0.06, power: 0.5 },
    Decay { first: 1.25e-2, last: 7e-3, power: 0.9 },
    Decay { first: 3.75e-3, last: 2e-3, power: 0.5 },
];

impl Decay {
    /// The step size at a position, `unit` times the table's, where schedules are `shorter` than
    /// [`TUNED_STEPS`] (a ratio, at most 1).
    fn at(&self, position: f64, unit: f32, shorter: f32, factor: f32) -> f32 {
        let (first, last) = (self.first * unit, self.last * unit);
        first * (last * shorter.powf(self.power) / first).powf(position as f32) * factor
    }
}

/// Step sizes at a position of a schedule of `steps` steps (normalised scene units for the means),
/// where a pixel is `pixel` units wide.
///
/// Far above those of 3DGS (Kerbl et al. 2023: 1.6e-4, 5e-3, 1e-3, 5e-2, 2.5e-3, 1.25e-4 for 30,000
/// steps): these schedules have hundreds to thousands of steps.
pub(crate) fn rates(position: f64, steps: f64, pixel: f32, config: &TrainConfig) -> LearningRates {
    let shorter = (TUNED_STEPS / steps.max(1.0) as f32).min(1.0);
    let units = [pixel, 1.0, 1.0, 1.0, 1.0, 1.0];
    let [mean, log_scale, rotation, opacity, sh0, sh_rest] =
        std::array::from_fn(|k| RATES[k].at(position, units[k], shorter, config.learning_rate));
    LearningRates { mean, log_scale, rotation, opacity, sh0, sh_rest }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_schedules_see_full_resolution_earlier_and_none_goes_back() {
        for (steps, early, full) in [(1_500.0, false, 0.8), (4_000.0, true, 0.6)] {
            let mut place = Place { position: 0.54, ..Place::default() };
            place.decide_early(steps);
            assert_eq!(place.early, None);
            place.position = 0.55;
            place.decide_early(steps);
            assert_eq!(place.early, Some(early));
            let levels: Vec<u32> = (0..=100).map(|p| level(f64::from(p) / 100.0, 2, early)).collect();
            assert!(levels.is_sorted_by(|a, b| a >= b), "{levels:?}");
            assert_eq!(levels.iter().position(|l| *l == 0), Some((100.0 * full) as usize), "{levels:?}");
            assert_eq!((levels[0], levels[39], levels[40]), (2, 2, 1));
            assert!((0..=100).all(|p| level(f64::from(p) / 100.0, 0, early) == 0));
        }
    }
}
