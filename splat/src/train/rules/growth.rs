//! Where and how many Gaussians are added: rounds of densification follow a plan, which ends early
//! where validation views stop gaining by it.

use crate::backend::Round;
use crate::config::TrainConfig;
use crate::error::SplatError;
use crate::train::context::RuleContext;
use crate::train::evidence::LEAST_GAIN;
use crate::train::schedule::GROWTH_END;
use crate::train::setup::TrainingSetup;
use crate::train::state::TrainingState;
use scene::decision::{Choice, Decision, Measurement, Quantity, Remark, Rule, Subject};
use serde::{Deserialize, Serialize};

/// How many Gaussians there are to be, and how that is looked at.
struct GrowthPlan {
    /// Rounds of densification in a schedule that is long enough. Source: chosen by hand, never
    /// measured.
    rounds: f64,
    /// Steps between rounds at least: fewer do not tell where Gaussians are missing. Source: chosen
    /// by hand, never measured.
    least_steps: u32,
    /// Gaussians at the end of growth for each step of the schedule, where there are views enough.
    /// Source: docs/decisions/tried.md: half as many lose 0.2 dB at one minute.
    a_step: f64,
    /// The same for each step and training view. Source: chosen by hand, never measured apart.
    a_step_and_view: f64,
    /// The same for each pair of training views: with few views more of them fit the views that are
    /// there instead of the scene.
    /// Source: docs/decisions/13.
    a_pair: f64,
    /// The same for each point of the sparse cloud, where no views can be spared to judge growth:
    /// the points tell how many places of the scene photos agree on. Source: docs/decisions/13.
    a_point: f64,
    /// Looks at the growth of the number of Gaussians, evenly over growth. Source: chosen by hand,
    /// never measured.
    looks: f64,
    /// Looks in a row without such a gain after which growth ends: validation of a moving target is
    /// noisy.
    /// Source: chosen by hand, never measured.
    patience: u32,
}

/// The values in force.
const PLAN: GrowthPlan = GrowthPlan {
    rounds: 40.0,
    least_steps: 50,
    a_step: 50.0,
    a_step_and_view: 0.45,
    a_pair: 60.0,
    a_point: 3.0,
    looks: 8.0,
    patience: 2,
};

/// What the validation views had at a look.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct GrowthLook {
    /// Level of resolution.
    level: u32,
    /// Their PSNR, dB.
    psnr: f64,
    /// Gaussians.
    gaussians: usize,
}

impl GrowthLook {
    fn score(&self) -> Measurement {
        Measurement::new(Quantity::Psnr, self.psnr)
    }
}

/// State of the rule.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct GrowthRule {
    /// Step of the last round of densification.
    round_step: u32,
    /// Position of that step.
    round_position: f64,
    /// Gaussians removed because hardly any view has them in its picture.
    unseen: usize,
    /// Looks so far.
    looks: u32,
    /// The last one.
    last: Option<GrowthLook>,
    /// The best one at the present resolution.
    best: Option<GrowthLook>,
    /// Looks since then.
    idle_looks: u32,
    /// Number of Gaussians at which growth stopped paying.
    limit: Option<usize>,
}

impl GrowthRule {
    /// A round of densification, where one is due.
    pub(super) fn after_step(&mut self, step: &mut RuleContext) -> Result<(), SplatError> {
        if !self.is_due(step) {
            return Ok(());
        }
        (self.round_step, self.round_position) = (step.state.place.iteration, step.position());
        let (setup, steps) = (step.setup, step.expected_steps());
        let mut last = gaussians_at_end(step.state.first, steps, setup);
        if let Some(limit) = self.limit {
            last = last.min(limit);
        }
        let wanted = gaussians_at(step.position(), step.state.first, last).min(setup.max_gaussians);
        let cameras = step.cameras();
        self.unseen += step.backend.densify(&Round {
            room: wanted.saturating_sub(step.backend.gaussians()),
            seed: setup.config.seed,
            iteration: step.state.place.iteration,
            remove_unseen: setup.dataset.is_transparent().then_some(cameras.as_slice()),
        })?;
        Ok(())
    }

    fn is_due(&self, step: &RuleContext) -> bool {
        step.position() < GROWTH_END
            && step.state.place.iteration >= self.round_step + PLAN.least_steps
            && step.position() >= self.round_position + GROWTH_END / PLAN.rounds
    }

    /// Growth ends where the validation views stop gaining by it.
    pub(super) fn review(&mut self, step: &mut RuleContext) -> Result<(), SplatError> {
        let setup = step.setup;
        let due = GROWTH_END / PLAN.looks * f64::from(self.looks + 1);
        let is_due = (due..GROWTH_END).contains(&step.position());
        if setup.validation.is_empty() || self.limit.is_some() || !is_due {
            return Ok(());
        }
        let (level, gaussians) = (step.level(), step.backend.gaussians());
        let psnr = step.psnr(&setup.validation, level, None)?;
        let now = GrowthLook { level, psnr, gaussians };
        self.looks += 1;
        self.last = Some(now);
        let best = self.best.filter(|best| best.level == level);
        if best.is_none_or(|best| psnr >= best.psnr + LEAST_GAIN) {
            self.best = Some(now);
            self.idle_looks = 0;
            return Ok(());
        }
        self.idle_looks += 1;
        if let Some(best) = best.filter(|b| self.idle_looks >= PLAN.patience && gaussians > b.gaussians) {
            self.limit = Some(gaussians);
            let decision = Decision::new(Subject::GaussianCount, Choice::count(gaussians), Rule::Evidence)
                .remarked(Remark::GrowthStopped)
                .with(Measurement::count(Quantity::ValidationViews, setup.validation.len()))
                .compared(Choice::count(best.gaussians), true, vec![best.score()])
                .compared(Choice::count(gaussians), false, vec![now.score()]);
            step.state.decisions.push(decision);
        }
        Ok(())
    }

    /// Reports growth that went as planned to `gaussians`, and what was removed on the way.
    pub(super) fn conclude(&self, state: &mut TrainingState, gaussians: usize) {
        if let (None, Some(last)) = (self.limit, self.last) {
            let decision = Decision::new(Subject::GaussianCount, Choice::count(gaussians), Rule::Evidence)
                .remarked(Remark::StillImproving)
                .compared(Choice::count(last.gaussians), true, vec![last.score()]);
            state.decisions.push(decision);
        }
        if self.unseen > 0 {
            let removed = Choice::count(self.unseen);
            let decision = Decision::new(Subject::UnobservedGaussians, removed, Rule::Evidence);
            state.decisions.push(decision.remarked(Remark::Unobserved));
        }
    }
}

/// How many Gaussians a schedule of `steps` steps grows to from `first`: more steps can settle more
/// Gaussians, more views and a scene with more to match can determine more.
fn gaussians_at_end(first: usize, steps: f64, setup: &TrainingSetup) -> usize {
    planned(first, steps, setup.views.len(), setup.cloud_points, setup.config)
}

/// The same for so many training views and points of the sparse cloud (`None`: no bound by them).
fn planned(first: usize, steps: f64, views: usize, points: Option<usize>, config: &TrainConfig) -> usize {
    let views = views as f64;
    let a_step = (PLAN.a_step_and_view * views).min(PLAN.a_step);
    let by_points = points.map_or(f64::INFINITY, |n| PLAN.a_point * n as f64);
    let determined = (PLAN.a_pair * 0.5 * views * views).min(by_points);
    ((steps * a_step).min(determined) as usize).min(config.max_gaussians).max(first)
}

/// Gaussians wanted at a position: from `first` evenly to `last` at the end of growth.
fn gaussians_at(position: f64, first: usize, last: usize) -> usize {
    let done = (position / GROWTH_END).clamp(0.0, 1.0);
    first + (last.saturating_sub(first) as f64 * done).round() as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_is_bounded_by_steps_by_views_by_points_and_by_what_is_configured() {
        let config = TrainConfig::default();
        let end = |first, steps, views, points| planned(first, steps, views, points, &config);
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
