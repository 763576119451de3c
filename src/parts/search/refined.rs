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

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use scene::{Camera, CameraModel, Frame, Pose};
    use splat::{AlphaMode, View};

    #[test]
    fn a_part_is_at_rest_in_the_first_frame_and_stands_as_its_joint_puts_it() {
        let normalisation = NormalisedFrame { centre: DVec3::new(1.0, 2.0, 3.0), scale: 0.5 };
        let camera = Camera::centred(1, CameraModel::Pinhole, 4, 4, 4.0);
        let pose = Pose::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, -DVec3::Y);
        let name = |k: usize| format!("{k}.png");
        let view = |k: usize| View {
            name: name(k),
            view: normalisation.view(&camera, &pose),
            levels: Vec::new(),
            held_out: false,
            camera: camera.clone(),
            pose,
        };
        // The second frame has no view.
        let dataset = Dataset {
            views: [0, 2].map(view).to_vec(),
            points: vec![(Vec3::ZERO, [0; 3])],
            normalisation,
            alpha: AlphaMode::Transparent,
            articulation: None,
        };
        let all = (0..3).map(|k| Frame { name: name(k), ..Frame::default() }).collect();
        let frames = FrameSet { frames: all, ..FrameSet::default() };
        let (axis, place) = (DVec3::Z, DVec3::new(0.3, 0.0, 0.1));
        let joint = Joint { axis, place, angles: vec![0.2, 0.6], sigmas: vec![0.1; 2], unsure: [0.1, 0.2] };
        let loose = World(normalisation).normalised(&joint);
        let points = vec![DVec3::new(0.2, -0.1, 0.4)];
        let candidate = PhotoCandidate { joint: loose, points };
        let part = told(&dataset, &frames, &candidate, &joint, 0.5);
        let turned = [0.0, 0.2, 0.4].map(f64::to_degrees);
        assert!(part.angles_deg.iter().zip(turned).all(|(a, b)| (a - b).abs() < 1e-9), "{part:?}");
        for (angle_deg, angle) in part.angles_deg.iter().zip([0.2, 0.4, 0.6]) {
            let world = DVec3::new(0.4, -0.2, 0.8) + normalisation.centre;
            let truth = place + DQuat::from_axis_angle(axis, angle) * (world - place);
            let found = part.pose(*angle_deg).transform(DVec3::from(part.points[0]));
            assert!(found.distance(truth) < 1e-9, "{found} {truth}");
        }
    }
}
