//! A joint: an axis in the body, a place on it, and an angle for each frame.

use super::limits::SHARED;
use crate::triangulation::PointView;
use glam::{DQuat, DVec3};
use scene::Pose;
use std::sync::Arc;

/// How a part turns: a place `x` of it at rest is at `p + R(a, θ) (x − p)` of the body.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct JointPath {
    /// Unit.
    pub axis: DVec3,
    /// On the axis.
    pub place: DVec3,
    /// The first frame.
    pub first: usize,
    /// In it and those after, radians; 0 in the first.
    pub angles: Vec<f64>,
    /// Standard deviation of the change of rate (radians a frame) from frame to frame: how unsteady
    /// it is.
    pub bend: f64,
    /// When all frames of the video were taken; the usual time between two is 1.
    pub times: Arc<[f64]>,
}

/// Standard deviations.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct JointSigmas {
    /// Radians.
    pub axis: f64,
    /// Across the axis.
    pub place: f64,
    /// Radians, by frame.
    pub angles: Vec<f64>,
}

/// How a point moves with each unknown: axis (two), place (two), angle.
pub(super) struct JointMoves(pub [DVec3; SHARED + 1]);

impl JointPath {
    /// The body's frame from the part's at rest.
    pub(super) fn pose(&self, frame: usize) -> Option<Pose> {
        let angle = *self.angles.get(frame.checked_sub(self.first)?)?;
        let rotation = DQuat::from_axis_angle(self.axis, angle);
        Some(Pose::new(rotation, self.place - rotation * self.place))
    }

    /// When the frame was taken that is so many after the first.
    fn time(&self, after: usize) -> f64 {
        self.times[self.first + after]
    }

    /// The rate from one angle to another, radians; 0 where both are the same.
    fn rate(&self, from: usize, to: usize) -> f64 {
        if from == to {
            return 0.0;
        }
        (self.angles[to] - self.angles[from]) / (self.time(to) - self.time(from))
    }

    /// More frames at either end (never before `0` or from `frames` on), at the rate of those that
    /// are there; zero in the first one.
    pub(super) fn extended(&self, by: usize, frames: usize) -> Self {
        let n = self.angles.len();
        let over = (n - 1).min(6);
        let (begin, end) = (self.rate(0, over), self.rate(n - 1 - over, n - 1));
        let (before, after) = (by.min(self.first), by.min(frames - self.first - n));
        let start = self.times[self.first - before];
        let mut angles: Vec<f64> =
            (0..before).map(|k| begin * (self.times[self.first - before + k] - start)).collect();
        let start = begin * (self.time(0) - start);
        angles.extend(self.angles.iter().map(|a| start + a));
        let last = start + self.angles[n - 1];
        angles.extend((0..after).map(|k| last + end * (self.time(n + k) - self.time(n - 1))));
        Self { first: self.first - before, angles, ..self.clone() }
    }

    /// With angles from zero in the first frame: an adjustment does not hold it exactly.
    pub(super) fn starting_at_zero(mut self) -> Self {
        let start = self.angles[0];
        self.angles.iter_mut().for_each(|a| *a -= start);
        self
    }

    /// How the rate changes from frame to frame, with the derivatives by the three angles.
    pub(super) fn changes(&self) -> impl Iterator<Item = (f64, [f64; 3])> + '_ {
        self.angles.windows(3).enumerate().map(|(i, w)| {
            let [a, b, c] = [0, 1, 2].map(|k| self.times[self.first + i + k]);
            let (before, after) = (1.0 / (b - a), 1.0 / (c - b));
            let by_angle = [before, -before - after, after];
            ((w[2] - w[1]) * after - (w[1] - w[0]) * before, by_angle)
        })
    }

    /// Two unit vectors across the axis.
    pub(super) fn across(&self) -> [DVec3; 2] {
        let first = self.axis.any_orthonormal_vector();
        [first, self.axis.cross(first)]
    }

    /// After a step of its unknowns: axis (two), place (two), angles.
    pub(super) fn stepped(&self, step: &[f64]) -> Self {
        let [u, v] = self.across();
        let axis = (self.axis + u * step[0] + v * step[1]).normalize();
        let place = self.place + u * step[2] + v * step[3];
        let angles = self.angles.iter().zip(&step[SHARED..]).map(|(a, s)| a + s).collect();
        Self { axis, place, angles, ..self.clone() }
    }
}

impl JointMoves {
    /// Of the place `x` at rest, in a frame with this motion; `across` is the joint's.
    pub(super) fn of(path: &JointPath, motion: &Pose, x: DVec3, across: [DVec3; 2]) -> Self {
        let (arm, rotation) = (x - path.place, motion.rotation);
        let turned = rotation * arm;
        let [tilt_u, tilt_v] = across.map(|to| {
            let about = path.axis.cross(to);
            about.cross(turned) - rotation * about.cross(arm)
        });
        let [shift_u, shift_v] = across.map(|by| by - rotation * by);
        Self([tilt_u, tilt_v, shift_u, shift_v, path.axis.cross(turned)])
    }
}

/// A view of the part at rest: the camera as the part sees it.
pub(super) fn at_rest<'a>(view: &PointView<'a>, motion: &Pose) -> PointView<'a> {
    PointView::new(&view.pose.compose(motion), view.camera, view.pixel)
}
