//! A joint: an axis in the body, a place on it, and an angle for each frame.

use super::normal::{Block, Normal, Row};
use super::posed::PosedTrack;
use crate::solvers::levenberg::cauchy;
use crate::triangulation::{PointView, linearise};
use glam::{DQuat, DVec3};
use rayon::prelude::*;
use scene::Pose;
use std::sync::Arc;

/// Unknowns beside the angles: two of the axis, two of the place.
pub(super) const SHARED: usize = 4;
/// Residuals count less and less from so many standard deviations on. Source: three is rare.
const ROBUST: f64 = 3.0;
/// Standard deviation of the first angle, radians: it is zero by definition. Source: far less than
/// any angle is known to.
pub(super) const ANCHOR: f64 = 1e-6;

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

impl JointPath {
    /// The body's frame from the part's at rest.
    pub(super) fn pose(&self, frame: usize) -> Option<Pose> {
        let angle = *self.angles.get(frame.checked_sub(self.first)?)?;
        let rotation = DQuat::from_axis_angle(self.axis, angle);
        Some(Pose::new(rotation, self.place - rotation * self.place))
    }

    /// More frames at either end (never before `0` or from `frames` on), at the rate of those that
    /// are there; zero in the first one.
    pub(super) fn extended(&self, by: usize, frames: usize) -> Self {
        let n = self.angles.len();
        let over = (n - 1).min(6);
        let time = |i: usize| self.times[self.first + i];
        let rate = |i: usize, j: usize| {
            if i == j { 0.0 } else { (self.angles[j] - self.angles[i]) / (time(j) - time(i)) }
        };
        let (begin, end) = (rate(0, over), rate(n - 1 - over, n - 1));
        let (before, after) = (by.min(self.first), by.min(frames - self.first - n));
        let start = self.times[self.first - before];
        let mut angles: Vec<f64> =
            (0..before).map(|k| begin * (self.times[self.first - before + k] - start)).collect();
        let start = begin * (time(0) - start);
        angles.extend(self.angles.iter().map(|a| start + a));
        let last = start + self.angles[n - 1];
        angles.extend((0..after).map(|k| last + end * (time(n + k) - time(n - 1))));
        Self { first: self.first - before, angles, ..self.clone() }
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

    pub(super) fn stepped(&self, step: &[f64]) -> Self {
        let [u, v] = self.across();
        let axis = (self.axis + u * step[0] + v * step[1]).normalize();
        let place = self.place + u * step[2] + v * step[3];
        let angles = self.angles.iter().zip(&step[SHARED..]).map(|(a, s)| a + s).collect();
        Self { axis, place, angles, ..self.clone() }
    }

    /// The joint of least squared error over the tracks (Levenberg–Marquardt; points are
    /// eliminated), with the points at rest of those that have one.
    pub(super) fn refined(&self, tracks: &[&PosedTrack<'_>], pixel: f64, rounds: usize) -> Self {
        let mut best = self.clone();
        let mut points = points(&best, tracks);
        let mut normal = best.normal(tracks, &points, pixel);
        let mut lambda = 1e-4;
        for _ in 0..rounds {
            let Some((step, moves)) = normal.step(lambda) else { break };
            let trial = best.stepped(&step);
            let moved: Vec<Option<DVec3>> = points.iter().zip(moves).map(|(p, m)| p.map(|p| p + m)).collect();
            let next = trial.normal(tracks, &moved, pixel);
            if next.cost < normal.cost {
                let small = normal.cost - next.cost < 1e-6 * normal.cost;
                (best, points, normal, lambda) = (trial, moved, next, lambda * 0.1);
                if small {
                    break;
                }
            } else {
                lambda *= 10.0;
                if lambda > 1e6 {
                    break;
                }
            }
        }
        // The first angle is not held exactly by its prior.
        let start = best.angles[0];
        best.angles.iter_mut().for_each(|a| *a -= start);
        best
    }

    /// Logarithm of the evidence of what the tracks show for a joint so unsteady (Laplace), up to a
    /// constant of the tracks.
    pub(super) fn evidence(&self, tracks: &[&PosedTrack<'_>], pixel: f64) -> f64 {
        let normal = self.normal(tracks, &points(self, tracks), pixel);
        let Some(half_log) = normal.half_log_determinant() else { return f64::NEG_INFINITY };
        let bends = self.angles.len().saturating_sub(2);
        -0.5 * normal.cost - half_log - bends as f64 * self.bend.ln()
    }
}

/// The points at rest that the tracks see under the joint.
fn points(path: &JointPath, tracks: &[&PosedTrack<'_>]) -> Vec<Option<DVec3>> {
    tracks.par_iter().map(|t| t.point(path).map(|p| p.0)).collect()
}

impl JointPath {
    fn normal(&self, tracks: &[&PosedTrack<'_>], points: &[Option<DVec3>], pixel: f64) -> Normal {
        let block = |(t, x): (&&PosedTrack<'_>, &Option<DVec3>)| {
            x.map_or_else(Block::default, |x| self.block(t, x, pixel))
        };
        let blocks = tracks.par_iter().zip(points).map(block).collect();
        let mut all = Normal::of(SHARED + self.angles.len(), blocks);
        // The first angle is zero, and rates change slowly.
        all.add(&[(SHARED, 1.0)], self.angles[0], ANCHOR);
        for (i, (change, by_angle)) in self.changes().enumerate() {
            all.add(&[0, 1, 2].map(|k| (SHARED + i + k, by_angle[k])), change, self.bend);
        }
        all
    }

    fn block(&self, track: &PosedTrack<'_>, x: DVec3, pixel: f64) -> Block {
        let across = self.across();
        let scale = 1.0 / (pixel * pixel);
        let (mut cost, mut rows) = (0.0, Vec::new());
        for (frame, view) in &track.views {
            let Some(motion) = self.pose(*frame) else { continue };
            let Some((residual, derivative)) = linearise(view, motion.transform(x)) else { continue };
            let squared = residual[0] * residual[0] + residual[1] * residual[1];
            let (own, weight) = cauchy(squared, ROBUST * pixel);
            cost += scale * own;
            let moves = JointMoves::of(self, &motion, x, across);
            let numbers = [0, 1, 2, 3, SHARED + frame - self.first];
            for (residual, row) in residual.into_iter().zip(derivative) {
                let columns = numbers.into_iter().zip(moves.0.map(|m| row.dot(m))).collect();
                let point = motion.rotation.conjugate() * row;
                rows.push(Row { columns, point, residual, weight: scale * weight });
            }
        }
        Block::of(cost, &rows)
    }
}

/// How a point moves with each unknown: axis (two), place (two), angle.
pub(super) struct JointMoves(pub [DVec3; SHARED + 1]);

impl JointMoves {
    pub(super) fn of(path: &JointPath, motion: &Pose, x: DVec3, across: [DVec3; 2]) -> Self {
        let (arm, rotation) = (x - path.place, motion.rotation);
        let turned = rotation * arm;
        let tilt = |to: DVec3| {
            let about = path.axis.cross(to);
            about.cross(turned) - rotation * about.cross(arm)
        };
        let shift = |by: DVec3| by - rotation * by;
        let [u, v] = across;
        Self([tilt(u), tilt(v), shift(u), shift(v), path.axis.cross(turned)])
    }
}

/// A view of the part at rest: the camera as the part sees it.
pub(super) fn at_rest<'a>(view: &PointView<'a>, motion: &Pose) -> PointView<'a> {
    PointView::new(&view.pose.compose(motion), view.camera, view.pixel)
}
