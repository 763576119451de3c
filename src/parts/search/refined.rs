//! A joint that pieces told of, after a short training of its part.

use super::loose::between;
use anyhow::{Context as _, Result};
use glam::{DQuat, DVec3};
use scene::{FrameSet, Progress};
use sfm::{LooseJoint, MovingPart};
use splat::{Dataset, Joint, MovingParts, NormalisedFrame, TrainConfig};

/// Deviation of an angle before the training, degrees. Source: chosen by hand: as far as training
/// looks for angles at most.
const UNKNOWN_DEG: f64 = 5.0;

/// A joint, and points that may be its part's, in the frame of the Gaussians.
pub(super) struct PhotoCandidate {
    pub(super) joint: LooseJoint,
    pub(super) points: Vec<DVec3>,
}

/// Turns a candidate's joint and finds its angles, without a look at `judges`. `times`: of the
/// views.
pub(super) fn refined(
    dataset: &Dataset,
    judges: &[usize],
    times: &[f64],
    candidate: &PhotoCandidate,
    config: &TrainConfig,
    progress: &Progress,
) -> Result<Joint> {
    let mut dataset = dataset.clone();
    judges.iter().for_each(|&view| dataset.views[view].held_out = true);
    let world = World(dataset.normalisation);
    let LooseJoint { axis, place, angles, sigmas, .. } = &candidate.joint;
    let given = Joint {
        axis: *axis,
        place: world.place(*place),
        angles: angles.clone(),
        sigmas: vec![UNKNOWN_DEG.to_radians(); angles.len()],
        unsure: [sigmas[0], sigmas[1] / world.0.scale],
    };
    let moving = MovingParts { joints: vec![given], times: times.to_vec(), ..MovingParts::default() };
    dataset.articulate(moving, &[candidate.points.iter().map(|&x| world.place(x)).collect()]);
    let moving = splat::train(&dataset, config, None, progress)?.moving;
    moving.and_then(|mut m| m.joints.pop()).context("training had no room for the part")
}

/// What is told of a candidate whose joint is this now.
pub(super) fn told(
    dataset: &Dataset,
    frames: &FrameSet,
    candidate: &PhotoCandidate,
    joint: &Joint,
    gain_db: f64,
) -> MovingPart {
    let world = World(dataset.normalisation);
    let angles = by_frame(&joint.angles, dataset, frames);
    let first = angles.first().copied().unwrap_or(0.0);
    // Angles count from the first frame: there the part is at rest.
    let turn = DQuat::from_axis_angle(joint.axis, first.to_radians());
    let points = candidate.points.iter().map(|&x| joint.place + turn * (world.place(x) - joint.place));
    MovingPart {
        axis: joint.axis.to_array(),
        place: joint.place.to_array(),
        axis_sigma_deg: joint.unsure[0].to_degrees(),
        place_sigma: joint.unsure[1],
        angles_deg: angles.iter().map(|a| a - first).collect(),
        angle_sigmas_deg: by_frame(&joint.sigmas, dataset, frames),
        points: points.map(|x| x.to_array()).collect(),
        gain_db: Some(gain_db),
        ..MovingPart::default()
    }
}

/// From the frame of the Gaussians, and to it.
pub(super) struct World(pub(super) NormalisedFrame);

impl World {
    fn place(&self, x: DVec3) -> DVec3 {
        x / self.0.scale + self.0.centre
    }

    /// A joint in the frame of the Gaussians.
    pub(super) fn normalised(&self, joint: &Joint) -> LooseJoint {
        LooseJoint {
            axis: joint.axis,
            place: (joint.place - self.0.centre) * self.0.scale,
            angles: joint.angles.clone(),
            sigmas: [joint.unsure[0], joint.unsure[1] * self.0.scale],
            explained: 0.0,
        }
    }
}

/// What views have, radians, by frame, degrees.
fn by_frame(of_views: &[f64], dataset: &Dataset, frames: &FrameSet) -> Vec<f64> {
    let numbers = frames.frames.iter().map(|f| dataset.views.iter().position(|v| v.name == f.name));
    let known: Vec<(f64, f64)> =
        numbers.enumerate().filter_map(|(k, view)| Some((k as f64, of_views[view?].to_degrees()))).collect();
    (0..frames.frames.len()).map(|k| between(&known, k as f64)).collect()
}
