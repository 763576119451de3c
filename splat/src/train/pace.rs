//! Turns steps into positions of the schedule: evenly with --iterations; with --time-limit so that
//! the steps still to come, at the cost measured so far, end when the time does. Reads no clock:
//! what is spent is told.

use crate::config::{MAX_COARSE_LEVELS, TrainConfig};
use crate::train::schedule::{Place, TUNED_STEPS, level};
use serde::{Deserialize, Serialize};

/// The pace of a training. Part of its checkpoint, so that a resumed one knows what steps cost.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Pace {
    /// Mean seconds of a step at each level, 0 where not yet seen.
    cost: [f64; MAX_COARSE_LEVELS as usize + 1],
    /// What the last step added to the position.
    stride: f64,
}

/// How what steps cost is told.
struct CostRules {
    /// Cost of a step at the next finer level where none was seen yet, in steps of the level
    /// before. Source: chosen by hand, never measured; replaced by what is measured as soon as a
    /// step is seen.
    finer: f64,
    /// Weight of a new step in the mean cost, a share: a mean over about twenty steps.
    /// Source: chosen by hand; limits are kept to 1 % by the tests' machines.
    new: f64,
    /// A step that took longer than this many mean ones says something of the machine, not of the
    /// steps to come. Source: docs/decisions/12.
    stall: f64,
    /// Parts in which the rest of the schedule is summed. Source: a level's share of the schedule
    /// is told to 2 %.
    parts: u32,
}

/// See [`CostRules`].
const RULES: CostRules = CostRules { finer: 2.5, new: 0.05, stall: 4.0, parts: 64 };

impl Pace {
    /// How many steps the whole schedule will have, as far as can be told.
    pub(crate) fn steps(&self, place: &Place, config: &TrainConfig) -> f64 {
        match config.time_limit {
            Some(_) if self.stride > 0.0 => f64::from(place.iteration) + (1.0 - place.position) / self.stride,
            Some(_) => f64::from(TUNED_STEPS),
            None => f64::from(config.iterations),
        }
    }

    /// The position after a step at `level` that took `spent` seconds; `place.seconds` are gone of
    /// the limit. A schedule has `most` steps at most, even if the limit leaves time for more.
    pub(crate) fn advance(
        &mut self,
        place: &Place,
        config: &TrainConfig,
        level: u32,
        spent: f64,
        most: f64,
    ) -> f64 {
        let Some(limit) = config.time_limit else {
            return f64::from(place.iteration) / f64::from(config.iterations.max(1));
        };
        let slot = &mut self.cost[level as usize];
        *slot = match *slot {
            mean if mean > 0.0 => mean + RULES.new * (spent.min(RULES.stall * mean) - mean),
            _ => spent,
        };
        let left = limit - place.seconds;
        if left <= 0.0 {
            return 1.0;
        }
        let stride = self.ahead(place, config, level) / left;
        let next = place.position + stride.max(1.0 / most.max(1.0));
        let next = next.min(1.0).max(place.position.next_up());
        self.stride = next - place.position;
        next
    }

    /// Seconds that the rest of the schedule would take with a step for every unit of position.
    fn ahead(&self, place: &Place, config: &TrainConfig, now: u32) -> f64 {
        let (position, early) = (place.position, place.early.unwrap_or(false));
        let width = (1.0 - position) / f64::from(RULES.parts);
        let (mut sum, mut last, mut previous) = (0.0, self.cost[now as usize], now);
        for part in 0..RULES.parts {
            let at = position + (f64::from(part) + 0.5) * width;
            let next = level(at, config.coarse_levels, early);
            if next != previous {
                let seen = self.cost[next as usize];
                last = if seen > 0.0 { seen } else { last * RULES.finer };
                previous = next;
            }
            sum += last * width;
        }
        sum
    }
}

/// What a step costs, where a device reports several at a time: those that were only begun seem to
/// cost nothing and the last one everything, so that the mean over a report counts.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct StepCost {
    /// Seconds since steps were last reported.
    spent: f64,
    /// Steps since then.
    steps: u32,
    /// Mean seconds of a step in the report before that; 0 before the first.
    mean: f64,
}

impl StepCost {
    /// The cost of a step that took `spent` seconds; whether it brought a report.
    pub(crate) fn of_step(&mut self, spent: f64, reported: bool) -> f64 {
        self.spent += spent;
        self.steps += 1;
        if reported {
            *self = Self { mean: self.spent / f64::from(self.steps), ..Self::default() };
            return self.mean;
        }
        if self.mean > 0.0 { self.mean } else { spent }
    }

    /// Notes a wait of `spent` seconds for the steps under way; whether it brought a report.
    pub(crate) fn note_wait(&mut self, spent: f64, reported: bool) {
        self.spent += spent;
        if reported {
            *self = Self { mean: self.spent / f64::from(self.steps.max(1)), ..Self::default() };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;

    /// A machine whose clock this is: a step costs what `cost(level, position, seconds gone)` says.
    struct PacedRun {
        seconds: f64,
        steps: u32,
        /// Steps at full resolution.
        full: u32,
        /// Greatest step of the position after the first tenth of the schedule.
        stride: f64,
        /// Position when the last step began.
        last: f64,
    }

    fn run(limit: f64, cost: impl FnMut(u32, f64, f64) -> f64) -> PacedRun {
        run_at_most(f64::INFINITY, limit, cost)
    }

    fn run_at_most(most: f64, limit: f64, mut cost: impl FnMut(u32, f64, f64) -> f64) -> PacedRun {
        let config = TrainConfig { time_limit: Some(limit), ..TrainConfig::default() };
        let (mut pace, mut place) = (Pace::default(), Place::default());
        let mut out = PacedRun { seconds: 0.0, steps: 0, full: 0, stride: 0.0, last: 0.0 };
        while place.position < 1.0 {
            place.decide_early(pace.steps(&place, &config));
            let now = place.level(config.coarse_levels);
            let spent = cost(now, place.position, place.seconds);
            place.iteration += 1;
            place.seconds += spent;
            let next = pace.advance(&place, &config, now, spent, most);
            assert!(next > place.position, "the position must move");
            if place.position > 0.1 {
                out.stride = out.stride.max(next - place.position);
            }
            out.last = place.position;
            place.position = next;
            out.full += u32::from(now == 0);
            out.steps += 1;
        }
        out.seconds = place.seconds;
        out
    }

    /// Four times the pixels cost 2.5 times as much, and the Gaussians grow threefold on the way.
    fn idle(level: u32, position: f64) -> f64 {
        0.03 * 0.4f64.powi(level as i32) * (1.0 + 2.0 * position.min(0.7))
    }

    fn check(what: &str, limit: f64, out: &PacedRun) {
        let PacedRun { seconds, steps, full, stride, last } = out;
        let said = format!(
            "{what}: {seconds:.2} of {limit} s, {steps} steps, {full} at full size, stride {stride:.4}"
        );
        assert!((seconds / limit - 1.0).abs() < 0.01, "{said}");
        // Full resolution has a fifth of the schedule; no part of the schedule is jumped over,
        // least of all its end.
        assert!(*full * 20 > *steps && *last > 0.99, "{said}, last {last:.4}");
        assert!(*stride < 12.0 / f64::from(*steps), "{said}");
    }

    #[test]
    fn the_schedule_fits_into_any_limit_on_an_idle_machine() {
        for limit in [10.0, 30.0, 60.0, 300.0] {
            check("idle", limit, &run(limit, |level, position, _| idle(level, position)));
        }
    }

    #[test]
    fn the_schedule_contracts_when_the_machine_gets_busy_and_stretches_when_it_is_free_again() {
        let limit = 60.0;
        let quiet = run(limit, |level, position, _| idle(level, position));
        let busy = |from: f64, to: f64, factor: f64| {
            run(limit, |level, position, gone| {
                idle(level, position) * if (from..to).contains(&gone) { factor } else { 1.0 }
            })
        };
        for (what, out) in [
            ("three times slower from the middle", busy(30.0, 1e9, 3.0)),
            ("three times slower up to the middle", busy(0.0, 30.0, 3.0)),
            ("eight times slower for ten seconds", busy(20.0, 30.0, 8.0)),
        ] {
            check(what, limit, &out);
            assert!(out.steps < quiet.steps, "{what}: {} steps, {} when idle", out.steps, quiet.steps);
        }
    }

    #[test]
    fn steps_of_uneven_cost_and_a_machine_that_stalls_do_not_break_the_schedule() {
        let limit = 60.0;
        let mut rng = scene::rng::rng(1, "uneven steps", 0);
        let noisy = run(limit, |level, position, _| idle(level, position) * rng.random_range(0.3..3.0));
        check("uneven", limit, &noisy);
        let mut stalls = 0;
        let stalled = run(limit, |level, position, gone| {
            let stall = gone > 15.0 * f64::from(stalls + 1) && stalls < 3;
            stalls += i32::from(stall);
            idle(level, position) + if stall { 5.0 } else { 0.0 }
        });
        assert_eq!(stalls, 3);
        check("three stalls of five seconds", limit, &stalled);
    }

    #[test]
    fn a_schedule_with_time_for_more_steps_than_it_may_have_ends_early_and_whole() {
        let out = run_at_most(1_000.0, 300.0, |level, position, _| idle(level, position));
        assert!((990..=1_001).contains(&out.steps), "{}", out.steps);
        assert!(out.seconds < 100.0 && out.last > 0.99 && out.full * 20 > out.steps * 3);
        let short = run_at_most(1_000.0, 10.0, |level, position, _| idle(level, position));
        check("too short to reach it", 10.0, &short);
    }

    #[test]
    fn iterations_are_walked_evenly() {
        let config = TrainConfig { iterations: 4, ..TrainConfig::default() };
        let mut pace = Pace::default();
        let at = |iteration| Place { iteration, ..Place::default() };
        let walked: Vec<f64> = (1..=4).map(|i| pace.advance(&at(i), &config, 0, 1.0, 2.0)).collect();
        assert_eq!(walked, [0.25, 0.5, 0.75, 1.0]);
        assert_eq!(pace.steps(&at(2), &config), 4.0);
    }
}
