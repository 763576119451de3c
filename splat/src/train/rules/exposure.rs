//! Gains by view and channel, where the residuals ask for them: a camera that meters each picture
//! anew.

use crate::error::SplatError;
use crate::train::context::RuleContext;
use crate::train::evidence::{EXPLAINED, LEAST_VIEWS, SAMPLE};
use scene::decision::{Decision, Measurement, Quantity, Remark, Rule, Subject};
use serde::{Deserialize, Serialize};

/// Positions of the schedule at which gains are looked for (the first two: what the first look
/// suspects has to explain the pictures of the second) and measured again. Source: the first two,
/// docs/decisions/12; the others chosen by hand.
pub(crate) const LOOKS: [f64; 5] = [0.25, 0.4, 0.55, 0.7, 0.85];
/// Gains stay within this and its inverse, a ratio: one stop. Source: chosen by hand, never
/// measured.
const LARGEST: f64 = 2.0;

/// State of the rule; the gains in force are in the training's state.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct ExposureRule {
    /// Looks so far.
    pub(crate) looks: usize,
    /// Gains of the training views that the first look found, until the second has judged them.
    pub(crate) suspected: Vec<[f32; 3]>,
}

/// What a view's pixels say, by channel: Σ r t, Σ r², Σ t² of rendering r and photo t.
type Products = [[f64; 3]; 3];

/// Least-squares gain of a channel of a view.
fn raw_gain(p: &Products, c: usize) -> f64 {
    let gain = if p[1][c] > 0.0 { p[0][c] / p[1][c] } else { 1.0 };
    if gain.is_finite() { gain.clamp(1.0 / LARGEST, LARGEST) } else { 1.0 }
}

/// Least-squares gains by view and channel, their geometric mean over the views 1 in every channel
/// (the colours of the scene carry the mean), and the part of the squared error that they explain.
fn gains(views: &[Products]) -> (Vec<[f32; 3]>, f64) {
    let n = views.len().max(1) as f64;
    let mean: [f64; 3] =
        std::array::from_fn(|c| (views.iter().map(|p| raw_gain(p, c).ln()).sum::<f64>() / n).exp());
    let own = views.iter().map(|p| std::array::from_fn(|c| (raw_gain(p, c) / mean[c]) as f32));
    let all: Vec<[f32; 3]> = own.collect();
    let explained = explained_by(views, &all);
    (all, explained)
}

/// The part of the squared error that given gains explain.
fn explained_by(views: &[Products], gains: &[[f32; 3]]) -> f64 {
    let (mut before, mut after) = (0.0, 0.0);
    for (p, gains) in views.iter().zip(gains) {
        for (c, g) in gains.iter().map(|g| f64::from(*g)).enumerate() {
            let [rt, rr, tt] = [p[0][c], p[1][c], p[2][c]];
            before += tt - 2.0 * rt + rr;
            after += tt - 2.0 * g * rt + g * g * rr;
        }
    }
    if before > 0.0 { 1.0 - after / before } else { 0.0 }
}

impl ExposureRule {
    /// Looks for gains at their places in the schedule.
    pub(crate) fn review(&mut self, step: &mut RuleContext) -> Result<(), SplatError> {
        let due = LOOKS.get(self.looks).is_some_and(|&at| step.position() >= at);
        let settled = self.looks > 0 && step.state.corrections.gains.is_empty() && self.suspected.is_empty();
        if !due || settled {
            return Ok(());
        }
        self.looks += 1;
        if step.setup.views.len() < LEAST_VIEWS {
            return Ok(());
        }
        if self.looks == 1 {
            return self.suspect_gains(step);
        }
        let products = products_of_views(step, 1)?;
        let (found, _) = gains(&products);
        let suspected = std::mem::take(&mut self.suspected);
        if !suspected.is_empty() {
            // A scene that is not yet learnt has views that are too dark or too bright as a whole,
            // other ones each time.
            let explained = explained_by(&products, &suspected);
            let decision = decision(&suspected, explained).remarked(Remark::GainsConfirmed);
            let on = decision.is_taken();
            step.state.decisions.push(decision);
            if !on {
                return Ok(());
            }
        }
        step.state.corrections.gains = found;
        Ok(())
    }

    /// The first look. It judges by some of the views.
    fn suspect_gains(&mut self, step: &mut RuleContext) -> Result<(), SplatError> {
        let every = step.setup.views.len().div_ceil(SAMPLE);
        let (mut found, explained) = gains(&products_of_views(step, every)?);
        if explained < EXPLAINED {
            step.state.decisions.push(decision(&found, explained));
            return Ok(());
        }
        if every > 1 {
            found = gains(&products_of_views(step, 1)?).0;
        }
        self.suspected = found;
        Ok(())
    }
}

/// Gains are modelled where they explain enough.
fn decision(found: &[[f32; 3]], explained: f64) -> Decision {
    let all = || found.iter().flatten().copied();
    let [least, largest] = [all().fold(f32::INFINITY, f32::min), all().fold(0.0, f32::max)];
    Decision::new(Subject::Exposure, explained >= EXPLAINED, Rule::Evidence).with_all([
        Measurement::new(Quantity::LeastGain, f64::from(least)),
        Measurement::new(Quantity::LargestGain, f64::from(largest)),
        Measurement::new(Quantity::ExplainedError, explained),
        Measurement::new(Quantity::NeededExplanation, EXPLAINED),
    ])
}

/// What each `every`-th training view says at the resolution in use.
fn products_of_views(step: &mut RuleContext, every: usize) -> Result<Vec<Products>, SplatError> {
    let (setup, level, options) = (step.setup, step.level(), step.options());
    let some = setup.views.iter().step_by(every);
    some.map(|&v| {
        let (camera, target) = step.photo(v, level);
        step.backend.products(&camera, &target, &options)
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_are_found_up_to_their_mean_and_none_where_there_are_none() {
        let truth = [0.8, 1.0, 1.25];
        let view = |g: f64| -> Products { [[10.0 * g; 3], [10.0; 3], [10.0 * g * g; 3]] };
        let (found, explained) = gains(&truth.map(view));
        for (f, t) in found.iter().zip(truth) {
            assert!(f.iter().all(|v| (f64::from(*v) - t).abs() < 1e-6), "{found:?}");
        }
        assert!((explained - 1.0).abs() < 1e-9);
        let found_for_others: Vec<[f32; 3]> = found.iter().rev().copied().collect();
        assert!(explained_by(&truth.map(view), &found) > 0.99);
        assert!(explained_by(&truth.map(view), &found_for_others) < 0.0);
        let noise: Products = [[10.0; 3], [10.0; 3], [11.0; 3]];
        assert!(gains(&[noise; 4]).1.abs() < 1e-9);
        let black: Products = [[0.0; 3]; 3];
        assert_eq!(gains(&[black; 3]), (vec![[1.0; 3]; 3], 0.0));
    }
}
