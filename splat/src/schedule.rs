//! What changes as training goes on: resolution, step sizes, spherical-harmonic degree. Everything is a function of the
//! position in the schedule, 0 at the start and 1 at the end, so that a schedule of any length ends converged.

use crate::backend::LearningRates;
use crate::config::{Recipe, TrainConfig};

/// From here on the higher degrees of the spherical harmonics come in, one after the other.
pub const SH_FROM: [f64; 3] = [0.2, 0.35, 0.5];

/// Position at which is decided when full resolution begins: what steps cost at half of it is known by then.
pub const EARLY_DECIDED: f64 = 0.55;

/// Whether a schedule of so many steps goes to full resolution early: a short one needs steps more than pixels.
pub fn is_early(steps: f64, recipe: &Recipe) -> bool {
    steps >= recipe.early_from_steps
}

/// Level (0: full resolution) at a position, with `levels` coarser ones to pass through; `early`: see [`is_early`].
pub fn level(position: f64, levels: u32, recipe: &Recipe, early: bool) -> u32 {
    let half = recipe.half_resolution_from;
    let full = if early {
        recipe.full_resolution_early.min(recipe.full_resolution_from).max(half)
    } else {
        recipe.full_resolution_from
    };
    let passed = if position >= full {
        levels
    } else if position >= half || levels == 0 {
        levels.saturating_sub(1)
    } else {
        // The levels coarser than a half share what comes before.
        (position / half * f64::from(levels - 1)).floor() as u32
    };
    levels - passed
}

/// Gaussians at the end of growth for each step and training view, up to `Recipe::gaussians_a_step` for each step.
const GAUSSIANS_A_STEP_AND_VIEW: f64 = 0.45;
/// Gaussians at the end of growth for each pair of training views: with few views more of them fit the views that are
/// there instead of the scene.
const GAUSSIANS_A_PAIR: f64 = 60.0;
/// The same for each point of the sparse cloud, where no views can be spared to judge growth: the points tell how many places of the
/// scene photos agree on (docs/decisions/0023).
const GAUSSIANS_A_POINT: f64 = 3.0;

/// What a capture has to determine Gaussians by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Capture {
    /// Training views.
    pub views: usize,
    /// Points of the sparse cloud; none: there is no cloud, or there are views enough to judge growth.
    pub points: Option<usize>,
}

/// How many Gaussians a schedule of `steps` steps grows to from `first`: more steps can settle more Gaussians, more
/// views and a scene with more to match can determine more.
pub fn gaussians_at_end(first: usize, steps: f64, capture: Capture, config: &TrainConfig) -> usize {
    let views = capture.views as f64;
    let a_step = (GAUSSIANS_A_STEP_AND_VIEW * views).min(config.recipe.gaussians_a_step);
    let by_points = capture.points.map_or(f64::INFINITY, |n| GAUSSIANS_A_POINT * n as f64);
    let determined = (GAUSSIANS_A_PAIR * 0.5 * views * views).min(by_points);
    ((steps * a_step).min(determined) as usize).min(config.max_gaussians).max(first)
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
    iteration >= last.0 + LEAST_STEPS && position >= last.1 + recipe.densify_until / ROUNDS
}

/// Degree in use at a position.
pub fn sh_degree(position: f64, highest: u32) -> u32 {
    (SH_FROM.iter().filter(|&&from| position >= from).count() as u32).min(highest)
}

/// Steps for which the step sizes were measured; the last ones are lowered where there are more.
pub const TUNED_STEPS: f32 = 500.0;

/// Steps of the means at the start and the end, pixels: with steps measured by the extent of the cameras, those that suit one
/// scene are five times too large for another (docs/decisions/0022).
const MEAN_PIXELS: (f32, f32) = (1.0, 0.06);

/// Step sizes at a position of a schedule of `steps` steps (normalised scene units for the means), where a pixel is `pixel` units wide.
///
/// Far above 3DGS (Kerbl et al. 2023: 1.6e-4, 5e-3, 1e-3, 5e-2, 2.5e-3, 1.25e-4 for 30,000 steps): these schedules have
/// hundreds to thousands of steps. Chosen together on four captures (docs/decisions/0022).
pub fn rates(position: f64, steps: f64, pixel: f32, config: &TrainConfig) -> LearningRates {
    let shorter = (TUNED_STEPS / steps.max(1.0) as f32).min(1.0);
    let decay = |first: f32, last: f32, power: f32| {
        first * (last * shorter.powf(power) / first).powf(position as f32) * config.learning_rate
    };
    LearningRates {
        mean: decay(MEAN_PIXELS.0 * pixel, MEAN_PIXELS.1 * pixel, 1.5),
        // From twice the first on, dark and noisy pictures (the test bed's case 1) are not learnt at all.
        log_scale: decay(8e-2, 2e-2, 0.7),
        rotation: decay(2e-2, 5e-3, 0.5),
        opacity: decay(0.12, 0.06, 0.5),
        sh0: decay(1.25e-2, 7e-3, 0.9),
        sh_rest: decay(7.5e-3, 2e-3, 0.5),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_schedules_see_full_resolution_earlier_and_none_goes_back() {
        let recipe = Recipe::default();
        assert!(is_early(4_000.0, &recipe) && !is_early(1_500.0, &recipe));
        for (early, full) in [(false, 0.8), (true, 0.6)] {
            let levels: Vec<u32> =
                (0..=100).map(|p| level(f64::from(p) / 100.0, 2, &recipe, early)).collect();
            assert!(levels.is_sorted_by(|a, b| a >= b), "{levels:?}");
            assert_eq!(levels.iter().position(|l| *l == 0), Some((100.0 * full) as usize), "{levels:?}");
            assert_eq!((levels[0], levels[39], levels[40]), (2, 2, 1));
            assert!((0..=100).all(|p| level(f64::from(p) / 100.0, 0, &recipe, early) == 0));
        }
        let sooner = Recipe { full_resolution_from: 0.5, ..recipe.clone() };
        assert_eq!([level(0.56, 2, &sooner, false), level(0.56, 2, &sooner, true)], [0, 0]);
        // Decided before either begins, so that no step sees a coarser picture than the one before.
        assert!(EARLY_DECIDED < recipe.full_resolution_early);
    }

    #[test]
    fn growth_is_bounded_by_steps_by_views_by_points_and_by_what_is_configured() {
        let config = TrainConfig::default();
        let end =
            |first, steps, views, points| gaussians_at_end(first, steps, Capture { views, points }, &config);
        assert_eq!(end(1_000, 1_000.0, 40, Some(5_000)), 15_000, "three a point");
        assert_eq!(end(1_000, 1_000.0, 40, Some(50_000)), 18_000, "0.45 a step and view");
        assert_eq!(end(1_000, 1e6, 40, Some(50_000)), 48_000, "sixty a pair of views");
        assert_eq!(end(1_000, 1e6, 40, None), 48_000, "no cloud bounds nothing");
        assert_eq!(end(1_000, 1_000.0, 1_000, None), 50_000, "fifty a step");
        assert_eq!(end(1_000, 1e9, 1_000, None), config.max_gaussians);
        assert_eq!(end(9_000, 10.0, 2, Some(16)), 9_000, "none of the first ones is taken away");
        assert_eq!(end(0, 0.0, 0, Some(0)), 0);
    }
}
