//! Poses of the training views: kept, or moved to where the splat shows what their photos show, by
//! evidence.

mod alignment;
mod linear;
mod motion;
mod photometric;

use crate::config::PoseRefinement;
use crate::error::SplatError;
use crate::train::context::RuleContext;
use crate::train::evidence::{EXPLAINED, LEAST_VIEWS, SAMPLE};
use crate::train::schedule::EVERY;
use crate::train::state::TrainingState;
use glam::Quat;
use motion::{motion_between, moved};
use photometric::{PixelSubset, motion_equations};
use scene::decision::{Decision, Measurement, Quantity, Rule, Subject};
use scene::{Gaussians, Pose};
use serde::{Deserialize, Serialize};

/// When poses are judged and moved.
struct PoseSchedule {
    /// Positions of the schedule at which is asked whether poses are to be refined; both have to
    /// say so. Source: docs/decisions/14.
    looks: [f64; 2],
    /// Position of the schedule from which views are moved when told to. Source: chosen by hand,
    /// never measured.
    from: f64,
    /// Position until which views are moved: the last steps see poses that stand. Source: chosen by
    /// hand, never measured.
    until: f64,
    /// Before anything is known a view is expected to be off by this, radians and normalised units.
    /// Source: chosen by hand (0.3°, about what docs/decisions/14 calls wrong).
    first_spread: [f64; 2],
}

/// The values in force.
const SCHEDULE: PoseSchedule =
    PoseSchedule { looks: [0.2, 0.3], from: 0.1, until: 0.96, first_spread: [0.005; 2] };

/// State of the rule; the poses in force are in the training's state.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct PoseRule {
    /// Places of the schedule that were passed.
    places: u32,
    /// What the looks that judge found explained.
    explained: Vec<f64>,
    /// Whether views are moved.
    refined: bool,
    /// Root mean square of what views were moved by at first: rotation (radians) and translation
    /// (normalised), by coordinate.
    spread: Option<[f64; 2]>,
}

impl PoseRule {
    /// Looks whether poses are to be refined, and refines them, at their places in the schedule.
    pub(super) fn review(&mut self, step: &mut RuleContext) -> Result<(), SplatError> {
        let (asked, position) = (step.setup.config.refine_poses, step.position());
        // Joints lie in the frame of the poses as they were given.
        let moving = step.setup.dataset.articulation.is_some();
        if asked == PoseRefinement::Off || step.setup.views.len() < LEAST_VIEWS || moving {
            return Ok(());
        }
        if self.refined || asked == PoseRefinement::On {
            let due = SCHEDULE.from + EVERY * f64::from(self.places);
            return if position >= due && due <= SCHEDULE.until { self.refine(step) } else { Ok(()) };
        }
        let judged = self.explained.len();
        let settled = self.explained.iter().any(|e| *e < EXPLAINED);
        if settled || SCHEDULE.looks.get(judged).is_none_or(|&at| position < at) {
            return Ok(());
        }
        let explained = explained_by_motions(step)?;
        self.explained.push(explained);
        let on = explained >= EXPLAINED;
        if on && judged + 1 < SCHEDULE.looks.len() {
            return Ok(());
        }
        // Refining goes on at the places that are left from here.
        self.refined = on;
        self.places = ((position - SCHEDULE.from) / EVERY).max(0.0) as u32;
        let decision = Decision::new(Subject::TrainingPoses, on, Rule::Evidence)
            .measured(Quantity::ExplainedError, explained)
            .measured(Quantity::NeededExplanation, EXPLAINED);
        step.state.decisions.push(decision);
        Ok(())
    }

    /// Moves all training views once.
    fn refine(&mut self, step: &mut RuleContext) -> Result<(), SplatError> {
        self.places += 1;
        let setup = step.setup;
        let spread = self.spread.unwrap_or(SCHEDULE.first_spread);
        let (mut poses, mut squares) = (Vec::with_capacity(setup.views.len()), [0.0f64; 2]);
        for &v in &setup.views {
            let (given, view) = (setup.dataset.views[v].view, step.camera(v));
            let equations = motion_equations(step, v, &view, PixelSubset::All)?;
            let view = moved(&view, &equations.motion(&motion_between(&given, &view), spread));
            for (k, x) in motion_between(&given, &view).iter().enumerate() {
                squares[k / 3] += x * x / 3.0;
            }
            let (q, t) = (Quat::from_mat3(&view.rotation), view.translation);
            poses.push([q.x, q.y, q.z, q.w, t.x, t.y, t.z]);
        }
        let n = setup.views.len() as f64;
        self.refined = true;
        self.spread = self.spread.or(Some(squares.map(|s| (s / n).sqrt())));
        step.state.corrections.poses = poses;
        Ok(())
    }

    /// Takes Gaussians that were trained on refined poses to the frame of the poses as given: root
    /// mean square distance of the refined views from these, pixels, and their names and poses
    /// (world frame). `None` where no pose was refined.
    pub(super) fn align(
        &self,
        step: &RuleContext,
        gaussians: &mut Gaussians,
    ) -> Option<(f64, Vec<(String, Pose)>)> {
        alignment::align(step, gaussians)
    }

    /// Reports how far apart the refined poses show the scene from where the poses as given do,
    /// pixels.
    pub(super) fn conclude(&self, state: &mut TrainingState, displacement: f64) {
        let displacement = Measurement::new(Quantity::Displacement, displacement);
        state.decisions.push(Decision::new(Subject::RefinedPoses, displacement, Rule::Evidence));
    }
}

/// Part of the squared error that goes where views are moved by what the other half of their pixels
/// says.
fn explained_by_motions(step: &mut RuleContext) -> Result<f64, SplatError> {
    let setup = step.setup;
    let (mut before, mut after) = (0.0, 0.0);
    for &v in setup.views.iter().step_by(setup.views.len().div_ceil(SAMPLE)) {
        let view = step.camera(v);
        let equations = motion_equations(step, v, &view, PixelSubset::Blocks(0))?;
        let view = moved(&view, &equations.motion(&[0.0; 6], SCHEDULE.first_spread));
        before += equations.outside;
        after += motion_equations(step, v, &view, PixelSubset::Blocks(0))?.outside;
    }
    Ok(if before > 0.0 { 1.0 - after / before } else { 0.0 })
}

#[cfg(test)]
mod tests;
