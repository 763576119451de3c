//! What changes as training goes on: resolution, step sizes, spherical-harmonic degree. Everything is a function of the
//! position in the schedule, 0 at the start and 1 at the end, so that a schedule of any length ends converged.

use crate::TrainConfig;
use crate::backend::LearningRates;
use crate::checkpoint::State;

/// Part of the schedule after which training runs at full resolution. A step at a quarter of the resolution costs an
/// eighth of a full one.
const FULL_RESOLUTION_FROM: f64 = 0.8;
/// Part of the schedule after which training runs at half the resolution.
const HALF_RESOLUTION_FROM: f64 = 0.4;
/// Part of the schedule in which Gaussians are added.
pub const DENSIFY_UNTIL: f64 = 0.6;
/// From here on the higher degrees of the spherical harmonics come in, one after the other.
const SH_FROM: [f64; 3] = [0.2, 0.35, 0.5];

/// Level (0: full resolution) at a position, with `levels` coarser ones to pass through.
pub fn level(position: f64, levels: u32) -> u32 {
    let passed = if position >= FULL_RESOLUTION_FROM {
        levels
    } else if position >= HALF_RESOLUTION_FROM || levels == 0 {
        levels.saturating_sub(1)
    } else {
        // The levels coarser than a half share what comes before.
        (position / HALF_RESOLUTION_FROM * f64::from(levels - 1)).floor() as u32
    };
    levels - passed
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
}

/// Cost of a step of the next finer level where it was not yet seen.
const FINER: f64 = 2.5;

impl Pace {
    /// How many steps the whole schedule will have, as far as can be told.
    pub fn steps(state: &State, config: &TrainConfig) -> f64 {
        match config.time_limit {
            Some(_) if state.position > 0.0 => f64::from(state.iteration) / state.position,
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
        // Seconds that the rest of the schedule would take with a step for every unit of position.
        let (mut ahead, mut last) = (0.0, spent);
        const PARTS: u32 = 64;
        let width = (1.0 - state.position) / f64::from(PARTS);
        let mut previous = level;
        for part in 0..PARTS {
            let at = state.position + (f64::from(part) + 0.5) * width;
            let next = self::level(at, config.coarse_levels);
            if next != previous {
                let seen = self.cost[next as usize % 8];
                last = if seen > 0.0 { seen } else { last * FINER };
                previous = next;
            } else if part == 0 {
                last = *self.cost.get(next as usize).filter(|c| **c > 0.0).unwrap_or(&spent);
            }
            ahead += last * width;
        }
        (state.position + ahead / left).min(1.0).max(state.position + 1e-7)
    }
}
