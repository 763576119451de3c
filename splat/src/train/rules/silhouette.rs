//! Once growth has ended: Gaussians go whose places the mattes show to be empty. By the host, so
//! not in every round.

use crate::error::SplatError;
use crate::model::Model;
use crate::train::context::RuleContext;
use crate::train::schedule::GROWTH_END;
use crate::train::state::TrainingState;
use scene::decision::{Choice, Decision, Remark, Rule, Subject};
use serde::{Deserialize, Serialize};

/// State of the rule.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct SilhouetteRule {
    /// Whether it was applied after growth.
    applied: bool,
    /// Gaussians removed.
    removed: usize,
}

impl SilhouetteRule {
    /// Removes what the visual hull excludes, once.
    pub(super) fn review(&mut self, step: &mut RuleContext) -> Result<(), SplatError> {
        let due = step.position() >= GROWTH_END && !self.applied;
        let Some(hull) = step.setup.hull.as_ref().filter(|_| due) else { return Ok(()) };
        self.applied = true;
        step.backend.edit(&mut |model, statistics| {
            self.removed += hull.prune(model);
            statistics.reset(model.len);
        })
    }

    /// Removes what has wandered off since.
    pub(super) fn after_training(&mut self, step: &RuleContext, model: &mut Model) {
        self.removed += step.setup.hull.as_ref().map_or(0, |hull| hull.prune(model));
    }

    /// Reports how many were removed.
    pub(super) fn conclude(&self, state: &mut TrainingState) {
        if self.removed > 0 {
            let removed = Choice::count(self.removed);
            let decision = Decision::new(Subject::OutsideSilhouettes, removed, Rule::Evidence);
            state.decisions.push(decision.remarked(Remark::OutsideHull));
        }
    }
}
