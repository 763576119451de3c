//! A joint: an axis in the body, a place on it, and an angle for each frame.

use super::posed::PosedTrack;
use crate::solvers::cholesky::{cholesky, solved, whiten};
use crate::solvers::levenberg::cauchy;
use crate::triangulation::{PointView, linearise};
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;
use scene::Pose;
use std::ops::Range;
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
    /// The frames it knows of.
    pub(super) fn frames(&self) -> Range<usize> {
        self.first..self.first + self.angles.len()
    }

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
        let mut normal = JointNormal::of(&best, tracks, &points, pixel);
        let mut lambda = 1e-4;
        for _ in 0..rounds {
            let Some((step, moves)) = normal.step(lambda) else { break };
            let trial = best.stepped(&step);
            let moved: Vec<Option<DVec3>> =
                points.iter().zip(moves).map(|(p, m)| p.map(|p| p + m)).collect();
            let next = JointNormal::of(&trial, tracks, &moved, pixel);
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
        let normal = JointNormal::of(self, tracks, &points(self, tracks), pixel);
        let (n, bends) = (normal.gradient.len(), self.angles.len().saturating_sub(2));
        let Some(l) = cholesky(normal.matrix, n) else { return f64::NEG_INFINITY };
        let half_log: f64 = (0..n).map(|i| l[i * n + i].ln()).sum();
        -0.5 * normal.cost - half_log - bends as f64 * self.bend.ln()
    }

    /// Standard deviations of what was refined; `None` where something is not determined at all.
    pub(super) fn sigmas(&self, tracks: &[&PosedTrack<'_>], pixel: f64) -> Option<JointSigmas> {
        let normal = JointNormal::of(self, tracks, &points(self, tracks), pixel);
        let n = normal.gradient.len();
        let l = cholesky(normal.matrix, n)?;
        let sigma = |k: usize| {
            let mut unit = vec![0.0; n];
            unit[k] = 1.0;
            whiten(&l, &unit).iter().map(|v| v * v).sum::<f64>().sqrt()
        };
        let (axis, place) = (sigma(0).hypot(sigma(1)), sigma(2).hypot(sigma(3)));
        let angles = (SHARED..n).into_par_iter().map(sigma).collect();
        Some(JointSigmas { axis, place, angles })
    }
}

/// The points at rest that the tracks see under the joint.
fn points(path: &JointPath, tracks: &[&PosedTrack<'_>]) -> Vec<Option<DVec3>> {
    tracks.par_iter().map(|t| t.point(path).map(|p| p.0)).collect()
}

/// The problem at some state: cost, and the normal equations of the joint after the points were
/// eliminated.
struct JointNormal {
    cost: f64,
    /// [n × n], full.
    matrix: Vec<f64>,
    gradient: Vec<f64>,
    tracks: Vec<TrackNormal>,
}

/// The part of one track.
#[derive(Default)]
struct TrackNormal {
    cost: f64,
    point: DMat3,
    point_gradient: DVec3,
    /// By unknown that the track touches: its number, its gradient, and the mixed derivatives.
    columns: Vec<(usize, f64, DVec3)>,
    /// [columns × columns].
    matrix: Vec<f64>,
}

impl JointNormal {
    fn of(
        path: &JointPath,
        tracks: &[&PosedTrack<'_>],
        points: &[Option<DVec3>],
        pixel: f64,
    ) -> Self {
        let n = SHARED + path.angles.len();
        let parts: Vec<TrackNormal> = tracks
            .par_iter()
            .zip(points)
            .map(|(t, x)| x.map_or_else(TrackNormal::default, |x| TrackNormal::of(path, t, x, pixel)))
            .collect();
        let mut all = Self { cost: 0.0, matrix: vec![0.0; n * n], gradient: vec![0.0; n], tracks: parts };
        all.add_priors(path);
        for track in &all.tracks {
            all.cost += track.cost;
            let eliminated = inverse(track.point);
            let k = track.columns.len();
            for (i, (row, gradient, mixed)) in track.columns.iter().enumerate() {
                let through = eliminated * *mixed;
                all.gradient[*row] += gradient - through.dot(track.point_gradient);
                for (j, (column, _, other)) in track.columns.iter().enumerate() {
                    all.matrix[row * n + column] += track.matrix[i * k + j] - through.dot(*other);
                }
            }
        }
        all
    }

    /// The first angle is zero, and rates change slowly.
    fn add_priors(&mut self, path: &JointPath) {
        let n = self.gradient.len();
        let mut add = |terms: &[(usize, f64)], residual: f64, sigma: f64| {
            let weight = 1.0 / (sigma * sigma);
            self.cost += weight * residual * residual;
            for &(row, a) in terms {
                self.gradient[row] += weight * a * residual;
                for &(column, b) in terms {
                    self.matrix[row * n + column] += weight * a * b;
                }
            }
        };
        add(&[(SHARED, 1.0)], path.angles[0], ANCHOR);
        for (i, (change, by_angle)) in path.changes().enumerate() {
            let at = SHARED + i;
            let terms = [0, 1, 2].map(|k| (at + k, by_angle[k]));
            add(&terms, change, path.bend);
        }
    }

    /// A step of the joint and of each point.
    fn step(&self, lambda: f64) -> Option<(Vec<f64>, Vec<DVec3>)> {
        let n = self.gradient.len();
        let mut damped = self.matrix.clone();
        (0..n).for_each(|i| damped[i * n + i] *= 1.0 + lambda);
        let l = cholesky(damped, n)?;
        let step = solved(&l, &self.gradient.iter().map(|g| -g).collect::<Vec<f64>>());
        let moves = self.tracks.iter().map(|t| {
            let pulled: DVec3 = t.columns.iter().map(|(c, _, mixed)| *mixed * step[*c]).sum();
            inverse(t.point) * -(t.point_gradient + pulled)
        });
        let moves = moves.collect();
        step.iter().all(|s| s.is_finite()).then_some((step, moves))
    }
}

/// Zero where nothing holds the point.
pub(super) fn inverse(m: DMat3) -> DMat3 {
    if m.determinant() > 0.0 { m.inverse() } else { DMat3::ZERO }
}

impl TrackNormal {
    fn of(path: &JointPath, track: &PosedTrack<'_>, x: DVec3, pixel: f64) -> Self {
        let across = path.across();
        let mut sum = Self::default();
        let seen = track.views.iter().filter(|(frame, _)| path.frames().contains(frame));
        let mut rows: Vec<([f64; SHARED + 1], usize, DVec3, f64, f64)> = Vec::new();
        for (frame, view) in seen {
            let Some(motion) = path.pose(*frame) else { continue };
            let at = motion.transform(x);
            let Some((residual, derivative)) = linearise(view, at) else { continue };
            let squared = residual[0] * residual[0] + residual[1] * residual[1];
            let (cost, weight) = cauchy(squared, ROBUST * pixel);
            let scale = 1.0 / (pixel * pixel);
            sum.cost += scale * cost;
            let moved = JointMoves::of(path, &motion, x, across);
            for (r, row) in residual.into_iter().zip(derivative) {
                let own = moved.0.map(|m| row.dot(m));
                rows.push((own, SHARED + frame - path.first, motion.rotation.conjugate() * row, r, scale * weight));
            }
        }
        sum.add(&rows);
        sum
    }

    /// Adds rows: derivatives by the shared unknowns and the frame's angle, the angle's number, the
    /// derivative by the point, residual and weight.
    fn add(&mut self, rows: &[([f64; SHARED + 1], usize, DVec3, f64, f64)]) {
        let mut numbers: Vec<usize> = (0..SHARED).chain(rows.iter().map(|r| r.1)).collect();
        numbers.dedup();
        let k = numbers.len();
        self.columns = numbers.into_iter().map(|n| (n, 0.0, DVec3::ZERO)).collect();
        self.matrix = vec![0.0; k * k];
        for (own, angle, point, residual, weight) in rows {
            self.point += DMat3::from_cols(*point * point.x, *point * point.y, *point * point.z) * *weight;
            self.point_gradient += *point * (*residual * weight);
            let place = self.columns.iter().position(|c| c.0 == *angle).unwrap_or(SHARED);
            let places = [0, 1, 2, 3, place];
            for (a, &i) in own.iter().zip(&places) {
                self.columns[i].1 += a * residual * weight;
                self.columns[i].2 += *point * (a * weight);
                for (b, &j) in own.iter().zip(&places) {
                    self.matrix[i * k + j] += a * b * weight;
                }
            }
        }
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
