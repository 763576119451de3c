//! What changes as training goes on: resolution, step sizes, spherical-harmonic degree. Everything is a function of the
//! position in the schedule, 0 at the start and 1 at the end, so that a schedule of any length ends converged.

use crate::backend::LearningRates;
use crate::checkpoint::State;
use crate::config::{Recipe, TrainConfig};

/// From here on the higher degrees of the spherical harmonics come in, one after the other.
pub const SH_FROM: [f64; 3] = [0.2, 0.35, 0.5];

/// Level (0: full resolution) at a position, with `levels` coarser ones to pass through.
pub fn level(position: f64, levels: u32, recipe: &Recipe) -> u32 {
    let half = recipe.half_resolution_from;
    let passed = if position >= recipe.full_resolution_from {
        levels
    } else if position >= half || levels == 0 {
        levels.saturating_sub(1)
    } else {
        // The levels coarser than a half share what comes before.
        (position / half * f64::from(levels - 1)).floor() as u32
    };
    levels - passed
}

/// How many Gaussians a schedule of `steps` steps grows to from `first`: more steps can settle more Gaussians.
pub fn gaussians_at_end(first: usize, steps: f64, config: &TrainConfig) -> usize {
    ((steps * config.recipe.gaussians_a_step) as usize).min(config.max_gaussians).max(first)
}

/// Gaussians wanted at a position: from `first` evenly to `last` at the end of densification.
pub fn gaussians(position: f64, first: usize, last: usize, recipe: &Recipe) -> usize {
    let done = (position / recipe.densify_until).clamp(0.0, 1.0);
    first + (last.saturating_sub(first) as f64 * done).round() as usize
}

/// Rounds of densification in a schedule that is long enough.
const ROUNDS: f64 = 40.0;
/// Steps between rounds at least: fewer do not tell where Gaussians are missing.
const LEAST_STEPS: u32 = 50;

/// Whether a round of densification is due, `last` being step and position of the one before.
pub fn is_round(iteration: u32, position: f64, last: (u32, f64), recipe: &Recipe) -> bool {
    if position >= recipe.densify_until {
        return false;
    }
    if !recipe.planned_growth {
        return iteration.is_multiple_of(100);
    }
    iteration >= last.0 + LEAST_STEPS && position >= last.1 + recipe.densify_until / ROUNDS
}

/// Degree in use at a position.
pub fn sh_degree(position: f64, highest: u32) -> u32 {
    (SH_FROM.iter().filter(|&&from| position >= from).count() as u32).min(highest)
}

/// Steps for which the step sizes were measured; the last ones are lowered where there are more.
const TUNED_STEPS: f32 = 500.0;

/// Step sizes at a position of a schedule of `steps` steps (normalised scene units for the means).
///
/// Far above 3DGS (Kerbl et al. 2023: 1.6e-4, 5e-3, 1e-3, 5e-2, 2.5e-3, 1.25e-4 for 30,000 steps): these schedules have
/// hundreds to thousands of steps, and on `fox` each of these factors was worth 0.2 to 1 dB after 500.
pub fn rates(position: f64, steps: f64, config: &TrainConfig) -> LearningRates {
    let shorter = (TUNED_STEPS / steps.max(1.0) as f32).min(1.0);
    let decay = |first: f32, last: f32, power: f32| {
        first * (last * shorter.powf(power) / first).powf(position as f32) * config.learning_rate
    };
    LearningRates {
        mean: decay(4e-3, 2e-4, 1.5),
        log_scale: decay(8e-2, 1e-2, 0.7),
        rotation: decay(2e-2, 5e-3, 0.5),
        opacity: decay(0.12, 0.03, 0.5),
        sh0: decay(5e-2, 7e-3, 0.9),
        sh_rest: decay(5e-3, 1e-3, 0.5),
    }
}

/// Turns steps into positions: evenly with --iterations; with --time-limit so that the steps still to come, at the cost
/// measured so far, end when the time does.
#[derive(Clone, Debug, Default)]
pub struct Pace {
    /// Mean seconds of a step at each level, 0 where not yet seen.
    cost: [f64; 8],
    /// What the last step added to the position.
    stride: f64,
}

/// Cost of a step of the next finer level where it was not yet seen.
const FINER: f64 = 2.5;

impl Pace {
    /// How many steps the whole schedule will have, as far as can be told.
    pub fn steps(&self, state: &State, config: &TrainConfig) -> f64 {
        match config.time_limit {
            Some(_) if self.stride > 0.0 => f64::from(state.iteration) + (1.0 - state.position) / self.stride,
            Some(_) => f64::from(TUNED_STEPS),
            None => f64::from(config.iterations),
        }
    }

    /// The position after a step at `level` that took `spent` seconds.
    pub fn advance(&mut self, state: &State, config: &TrainConfig, level: u32, spent: f64) -> f64 {
        let Some(limit) = config.time_limit else {
            return f64::from(state.iteration) / f64::from(config.iterations.max(1));
        };
        let slot = &mut self.cost[level as usize % 8];
        *slot = if *slot > 0.0 { *slot + 0.05 * (spent - *slot) } else { spent };
        let left = limit - state.seconds;
        if left <= 0.0 {
            return 1.0;
        }
        let next = state.position + self.ahead(state.position, config, level) / left;
        let next = next.min(1.0).max(state.position + 1e-7);
        self.stride = next - state.position;
        next
    }

    /// Seconds that the rest of the schedule would take with a step for every unit of position.
    fn ahead(&self, position: f64, config: &TrainConfig, level: u32) -> f64 {
        const PARTS: u32 = 64;
        let width = (1.0 - position) / f64::from(PARTS);
        let (mut sum, mut last, mut previous) = (0.0, self.cost[level as usize % 8], level);
        for part in 0..PARTS {
            let at = position + (f64::from(part) + 0.5) * width;
            let next = self::level(at, config.coarse_levels, &config.recipe);
            if next != previous {
                let seen = self.cost[next as usize % 8];
                last = if seen > 0.0 { seen } else { last * FINER };
                previous = next;
            }
            sum += last * width;
        }
        sum
    }
}
