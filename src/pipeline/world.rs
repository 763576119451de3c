//! The world frame of a run: where its model is moved before anything is written.

use crate::args::PipelineArgs;
use anyhow::{Result, bail};
use glam::{DMat3, DVec3};
use scene::decision::{MotionModel, ScaleEvidence, UpEvidence};
use scene::sim3::Sim3;
use scene::up::{StatedUp, stated_up};
use scene::{Decision, FrameSet, MetricScale, Progress, Reconstruction, RingSequence, WorldFrame};
use sfm::{PoseDeviation, SfmResult};
use std::collections::BTreeMap;

/// Where the world of a solved model lies, with the scale that was found; with `--keep-frame`, what
/// is up in the solver's frame. Vertical lines are asked last: an object that leans has lines that
/// lean with it.
pub(super) fn find(
    result: &SfmResult,
    frames: &FrameSet,
    args: &PipelineArgs,
    scale: Option<MetricScale>,
    progress: &Progress,
) -> Result<Option<WorldFrame>> {
    let Some(model) = &result.reconstruction else { return Ok(None) };
    let motion = result.decisions.iter().filter_map(Decision::motion).next_back();
    let is_turn = motion == Some(MotionModel::SingleAxis);
    let tumbles = result.motion.as_ref().filter(|m| m.tumble.is_some());
    let sequence = RingSequence::of(model, frames).filter(|_| tumbles.is_none());
    let ring = sequence.as_ref().map(|s| &s.ring);
    let axis = match tumbles {
        Some(report) => Some(DVec3::from_array(report.axis_body)),
        None => ring.filter(|_| is_turn).map(|r| r.axis),
    };
    // Only a turn about one axis is scaled by a known distance.
    let known = is_turn && args.sfm.motion.known_distance.is_some();
    let by_distance = MetricScale {
        evidence: ScaleEvidence::KnownDistance,
        metres_per_unit: 1.0,
        relative_deviation: None,
    };
    let scale = if known { Some(by_distance) } else { scale };
    let Some(mut world) = WorldFrame::of(model, ring, axis, scale) else { return Ok(None) };
    if world.up_evidence == UpEvidence::LevelCameras
        && let Some(stated) = stated(model, frames)
    {
        world = world.by_metadata(model, &stated);
    } else if world.up_evidence == UpEvidence::LevelCameras
        && let Some(found) = sfm::vertical_direction(model, frames, progress)?
    {
        world = world.by_lines(model, found.up, [found.agreeing, found.lines]);
    }
    Ok(Some(if args.keep_frame { world.kept(Sim3::IDENTITY) } else { world }))
}

/// What the metadata of the frames say.
fn stated(model: &Reconstruction, frames: &FrameSet) -> Option<StatedUp> {
    let ups: BTreeMap<&str, [f64; 3]> =
        frames.frames.iter().filter_map(|f| Some((f.name.as_str(), f.up?))).collect();
    let mut said = Vec::new();
    for image in model.images.values() {
        said.extend(ups.get(image.name.as_str()).map(|up| (image.pose, DVec3::from_array(*up))));
    }
    stated_up(&said)
}

/// Moves all that was solved.
pub(super) fn place(result: &mut SfmResult, world_from_solver: &Sim3) {
    let turn = DMat3::from_quat(world_from_solver.rotation);
    let resized = turn * world_from_solver.scale;
    let moved = |d: &mut PoseDeviation| d.centre = resized * d.centre * resized.transpose();
    if let Some(model) = &mut result.reconstruction {
        *model = world_from_solver.transform_reconstruction(model);
    }
    if let Some(uncertainty) = &mut result.uncertainty {
        uncertainty.images.values_mut().for_each(moved);
    }
    for frame in &mut result.frames {
        frame.pose = world_from_solver.transform_pose(&frame.pose);
        moved(&mut frame.deviation);
    }
    if let Some(motion) = &mut result.motion {
        motion.axis_body = (turn * DVec3::from_array(motion.axis_body)).to_array();
    }
}

/// Refuses a known length for poses whose frame stays as it is.
pub(super) fn refuse_scale(args: &PipelineArgs) -> Result<()> {
    if args.sfm.scale.known_length.is_some() || args.sfm.scale.tag_size.is_some() {
        bail!(
            "the poses of {} keep their frame and scale: add --ignore-poses for --known-length and --tag-size",
            args.input.display()
        );
    }
    Ok(())
}

/// What is up in a model that came with the input, whose frame stays as it is. `turn`: from the
/// frame of its file.
pub(super) fn given(model: &Reconstruction, frames: &FrameSet, turn: Sim3) -> Option<WorldFrame> {
    let sequence = RingSequence::of(model, frames);
    Some(WorldFrame::of(model, sequence.as_ref().map(|s| &s.ring), None, None)?.kept(turn))
}
