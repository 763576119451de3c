//! Everything that is estimated beside points, and where each unknown stands.

use super::joint::JointPath;
use super::limits::{LEAST_VIEWS, SHARED};
use super::posed::PosedFrame;
use crate::klt::KltTrack;
use crate::triangulation::{PointView, nearest_to_rays, refine_point};
use glam::{DQuat, DVec3};
use scene::{Camera, Pose};
use std::sync::Arc;

/// Cameras, the body's motion, and the joints of its parts.
#[derive(Clone, Debug)]
pub(super) struct Chain {
    /// What the frames were taken with.
    pub cameras: Vec<Camera>,
    /// By frame: its camera, and the camera from the body.
    pub frames: Vec<Option<(usize, Pose)>>,
    /// One for each part.
    pub joints: Vec<JointPath>,
    /// By joint: what it has in common with one before it.
    pub ties: Vec<Tie>,
    /// When the frames were taken; the usual time between two is 1.
    pub times: Arc<[f64]>,
}

/// What a joint has in common with another.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Tie {
    /// The joint on whose axis it turns, with the same direction.
    pub axis_of: Option<usize>,
    /// Its angle is so many times that joint's: 1 or -1.
    pub ratio: Option<f64>,
}

/// A track and the joint of the part that it belongs to, none for the body.
#[derive(Clone, Copy)]
pub(super) struct Member<'t> {
    /// Where it was seen.
    pub track: &'t KltTrack,
    /// The number of the joint.
    pub joint: Option<usize>,
}

/// Where each unknown stands.
pub(super) struct ChainLayout {
    /// By camera: first unknown, and which parameters are free.
    pub cameras: Vec<(usize, Vec<usize>)>,
    /// By frame: the first of six, rotation and translation.
    pub frames: Vec<Option<usize>>,
    /// By joint.
    pub joints: Vec<JointColumns>,
    /// Unknowns in all.
    pub size: usize,
}

/// Where a joint's unknowns stand, and what its angle is as a multiple of the unknown.
#[derive(Clone, Copy, PartialEq)]
pub(super) struct JointColumns {
    /// The first of axis and place.
    pub axis: usize,
    /// That of the first angle.
    pub angles: usize,
    /// 1 or -1.
    pub ratio: f64,
}

impl ChainLayout {
    /// Room for so many unknowns more: the first of them.
    fn take(&mut self, count: usize) -> usize {
        self.size += count;
        self.size - count
    }
}

impl Chain {
    /// The frames that have a pose, with their cameras.
    pub(super) fn posed(&self) -> Vec<Option<PosedFrame<'_>>> {
        let posed = self.frames.iter();
        posed.map(|f| f.map(|(c, pose)| PosedFrame { pose, camera: &self.cameras[c] })).collect()
    }

    /// Where each unknown stands: focal lengths and terms of distortion, poses, joints as far as
    /// they are not tied.
    pub(super) fn layout(&self) -> ChainLayout {
        let mut all = ChainLayout { cameras: Vec::new(), frames: Vec::new(), joints: Vec::new(), size: 0 };
        for camera in &self.cameras {
            let free = free_parameters(camera);
            let at = all.take(free.len());
            all.cameras.push((at, free));
        }
        for frame in &self.frames {
            let at = frame.map(|_| all.take(6));
            all.frames.push(at);
        }
        for (path, tie) in self.joints.iter().zip(&self.ties) {
            let leader = tie.axis_of.map(|j| all.joints[j]);
            let axis = leader.map_or_else(|| all.take(SHARED), |l| l.axis);
            let (angles, ratio) = match (leader, tie.ratio) {
                (Some(l), Some(ratio)) => (l.angles, ratio * l.ratio),
                _ => (all.take(path.angles.len()), 1.0),
            };
            all.joints.push(JointColumns { axis, angles, ratio });
        }
        all
    }

    /// The chain after a step of its unknowns.
    pub(super) fn stepped(&self, layout: &ChainLayout, step: &[f64]) -> Self {
        let mut next = self.clone();
        for (camera, (at, free)) in next.cameras.iter_mut().zip(&layout.cameras) {
            let scale = camera.mean_focal();
            let focals = camera.model.num_focals();
            for (k, &i) in free.iter().enumerate() {
                camera.params[i] += step[at + k] * if i < focals { scale } else { 1.0 };
            }
        }
        for (frame, at) in next.frames.iter_mut().zip(&layout.frames) {
            if let (Some((_, pose)), Some(at)) = (frame, at) {
                *pose = moved(pose, &step[*at..at + 6]);
            }
        }
        for (joint, at) in next.joints.iter_mut().zip(&layout.joints) {
            let angles = step[at.angles..].iter().take(joint.angles.len()).map(|s| s * at.ratio);
            let own: Vec<f64> = step[at.axis..at.axis + SHARED].iter().copied().chain(angles).collect();
            *joint = joint.stepped(&own);
        }
        next
    }

    /// Views of a track as its own rigid part at rest sees them: frame, view, motion of the part.
    pub(super) fn views<'a>(&'a self, member: &Member<'_>) -> Vec<(usize, PointView<'a>, Pose)> {
        let seen = member.track.positions.iter().enumerate();
        let views = seen.filter_map(|(k, pixel)| {
            let frame = member.track.first + k;
            let (camera, pose) = (*self.frames.get(frame)?)?;
            let motion = member.joint.map_or(Some(Pose::IDENTITY), |j| self.joints[j].pose(frame))?;
            Some((frame, PointView::new(&pose.compose(&motion), &self.cameras[camera], *pixel), motion))
        });
        views.collect()
    }

    /// Where the point of a track is at rest; `None` where too few views say so.
    pub(super) fn point(&self, member: &Member<'_>) -> Option<DVec3> {
        let views: Vec<PointView<'_>> = self.views(member).into_iter().map(|v| v.1).collect();
        let start = nearest_to_rays(views.iter())?;
        let x = refine_point(start, views.iter(), 8);
        (views.len() >= LEAST_VIEWS && x.is_finite()).then_some(x)
    }

    /// The same with a joint tied to one before it.
    pub(super) fn tied(&self, joint: usize, tie: Tie) -> Self {
        let mut next = self.clone();
        let Some(leader) = tie.axis_of.map(|j| self.joints[j].clone()) else { return next };
        let own = &mut next.joints[joint];
        if own.axis.dot(leader.axis) < 0.0 {
            own.angles.iter_mut().for_each(|a| *a = -*a);
        }
        (own.axis, own.place) = (leader.axis, leader.place);
        if let Some(ratio) = tie.ratio {
            own.angles = leader.angles.iter().map(|a| ratio * a).collect();
            own.bend = leader.bend;
        }
        next.ties[joint] = tie;
        next
    }

    /// The same where a joint before it turns as this one does, times 1 or -1.
    pub(super) fn led_by(&self, joint: usize, leader: usize, ratio: f64) -> Self {
        let mut next = self.clone();
        let own = &self.joints[joint];
        let ratio = ratio * own.axis.dot(self.joints[leader].axis).signum();
        next.joints[leader].angles = own.angles.iter().map(|a| ratio * a).collect();
        next.joints[leader].bend = own.bend;
        next
    }

    /// The same without a joint; what was tied to it is free.
    pub(super) fn without(&self, joint: usize) -> Self {
        let mut next = self.clone();
        next.joints.remove(joint);
        next.ties.remove(joint);
        for tie in &mut next.ties {
            match tie.axis_of {
                Some(leader) if leader == joint => *tie = Tie::default(),
                Some(leader) if leader > joint => tie.axis_of = Some(leader - 1),
                _ => {}
            }
        }
        next
    }

    /// Without joints that have all unknowns of one before them: their parts move as one.
    pub(super) fn without_repeats(&self) -> Self {
        let columns = self.layout().joints;
        let firsts: Vec<usize> =
            columns.iter().map(|own| columns.iter().position(|c| c == own).unwrap_or(0)).collect();
        let kept: Vec<usize> = (0..firsts.len()).filter(|&j| firsts[j] == j).collect();
        let joints = kept.iter().map(|&j| self.joints[j].clone()).collect();
        let ties = kept.iter().map(|&j| {
            let Tie { axis_of, ratio } = self.ties[j];
            Tie { axis_of: axis_of.and_then(|leader| kept.binary_search(&firsts[leader]).ok()), ratio }
        });
        Self { joints, ties: ties.collect(), ..self.clone() }
    }
}

/// Which parameters of a camera are estimated: focal lengths, and distortion where it has some.
fn free_parameters(camera: &Camera) -> Vec<usize> {
    let focals = camera.model.num_focals();
    let distorted = (focals + 2..camera.params.len()).filter(|&i| camera.params[i] != 0.0);
    (0..focals).chain(distorted).collect()
}

/// A pose after a small rotation of the camera (radians) and shift.
pub(super) fn moved(pose: &Pose, step: &[f64]) -> Pose {
    let turn = DQuat::from_scaled_axis(DVec3::new(step[0], step[1], step[2]));
    Pose::new(turn * pose.rotation, pose.translation + DVec3::new(step[3], step[4], step[5]))
}

/// The same where one of the six numbers alone is not zero.
pub(super) fn nudged(pose: &Pose, number: usize, by: f64) -> Pose {
    let mut step = [0.0; 6];
    step[number] = by;
    moved(pose, &step)
}
