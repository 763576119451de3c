//! The world frame of a run: where its model is moved before anything is written.

use crate::args::PipelineArgs;
use crate::record::PoseSummary;
use scene::decision::{MotionModel, Rule};
use scene::sim3::Sim3;
use scene::{Decision, FrameSet, Reconstruction, RingSequence, WorldFrame};
use sfm::Uncertainty;

/// The solved model in its world frame; `summary` gets the frame, what says so, and the standard
/// deviations in it. With `--keep-frame` the model stays where the solver left it.
pub(super) fn place(
    model: &Reconstruction,
    uncertainty: Option<&Uncertainty>,
    frames: &FrameSet,
    args: &PipelineArgs,
    summary: &mut PoseSummary,
) -> Reconstruction {
    let motions = summary.decisions.iter().filter_map(Decision::motion);
    let is_turn = motions.last() == Some(MotionModel::SingleAxis);
    // Only a turn about one axis is scaled by it.
    let metric = is_turn && args.sfm.motion.known_distance.is_some();
    let rule = if args.keep_frame { Rule::Requested } else { Rule::Evidence };
    let found = found(model, frames, is_turn, metric);
    let world = if args.keep_frame { found.map(|w| w.kept(Sim3::IDENTITY)) } else { found };
    let move_by = world.as_ref().map_or(Sim3::IDENTITY, WorldFrame::sim3);
    let moved = if args.keep_frame { model.clone() } else { move_by.transform_reconstruction(model) };
    let deviations = uncertainty.map(|u| crate::record::Deviations::of(u, model, &move_by));
    summary.deviations = deviations;
    summary.decisions.extend(world.as_ref().map(|w| w.decision(rule)));
    summary.world = world;
    moved
}

/// What is up in a model that came with the input, whose frame stays as it is. `turn`: from the
/// frame of its file.
pub(super) fn given(model: &Reconstruction, frames: &FrameSet, turn: Sim3) -> Option<WorldFrame> {
    Some(found(model, frames, false, false)?.kept(turn))
}

fn found(model: &Reconstruction, frames: &FrameSet, is_turn: bool, metric: bool) -> Option<WorldFrame> {
    let sequence = RingSequence::of(model, frames);
    WorldFrame::of(model, sequence.as_ref().map(|s| &s.ring), is_turn, metric)
}
