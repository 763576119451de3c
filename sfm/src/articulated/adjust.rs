//! Cameras, body and joints together: what a moving part shows corrects the focal length and the
//! poses that its motion had bent.

use super::joint::{ANCHOR, JointMoves, JointPath, JointSigmas, SHARED};
use super::normal::{Block, Normal, Row};
use crate::klt::KltTrack;
use crate::solvers::levenberg::cauchy;
use crate::triangulation::{PointView, linearise, nearest_to_rays, refine_point};
use glam::{DQuat, DVec3};
use rayon::prelude::*;
use scene::sim3::robust_alignment;
use scene::{Camera, Pose};
use std::sync::Arc;

/// Residuals count less and less from so many standard deviations on. Source: three is rare.
const ROBUST: f64 = 3.0;
/// Rounds at most.
const ROUNDS: usize = 20;
/// What a focal length may differ from what it was, as a share of it. Source: chosen by hand: weak.
const FOCAL: f64 = 0.3;
/// Terms of distortion, beforehand. Source: of lenses that are no fisheyes.
const DISTORTION: f64 = 0.1;
/// A pose is held so loosely (radians, object sizes) that only what nothing else determines, frame
/// and scale, stays. Source: chosen by hand.
const HELD: f64 = 1.0;
/// The body's motion from frame to frame changes at least by so much, radians or sizes. Source:
/// as of joints.
const LEAST_BEND: f64 = 3e-5;

/// Everything that is estimated beside points.
#[derive(Clone, Debug)]
pub(super) struct Chain {
    pub cameras: Vec<Camera>,
    /// By frame: its camera, and the camera from the body.
    pub frames: Vec<Option<(usize, Pose)>>,
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
    pub track: &'t KltTrack,
    pub joint: Option<usize>,
}

/// What the observations and the motion are worth.
#[derive(Clone, Debug)]
pub(super) struct ChainNoise {
    /// Standard deviation of an observation, pixels.
    pub pixel: f64,
    /// That of the change of the body's motion from frame to frame, rotation (radians) and
    /// translation (sizes).
    body: [f64; 2],
}

/// Where each unknown stands.
struct Layout {
    /// By camera: first unknown, and which parameters are free.
    cameras: Vec<(usize, Vec<usize>)>,
    frames: Vec<Option<usize>>,
    joints: Vec<JointColumns>,
    size: usize,
}

/// Where a joint's unknowns stand, and what its angle is as a multiple of the unknown.
#[derive(Clone, Copy)]
struct JointColumns {
    axis: usize,
    angles: usize,
    ratio: f64,
}

impl ChainNoise {
    /// How unsteady the motions are, they say themselves.
    pub(super) fn of(chain: &Chain, pixel: f64) -> Self {
        let mut sums = [0.0; 2];
        let mut count = 0.0;
        for triple in chain.triples() {
            let e = triple.unsteadiness();
            sums[0] += e[..3].iter().map(|v| v * v).sum::<f64>() / 3.0;
            sums[1] += e[3..].iter().map(|v| v * v).sum::<f64>() / 3.0;
            count += 1.0;
        }
        let body = sums.map(|s: f64| (s / f64::max(count, 1.0)).sqrt().max(LEAST_BEND));
        Self { pixel, body }
    }
}

/// Frames that follow each other.
#[derive(Clone, Copy)]
struct Triple {
    frames: [usize; 3],
    poses: [Pose; 3],
    times: [f64; 3],
}

impl Triple {
    /// How the body's motion in a frame's time changes: rotation vector, translation.
    fn unsteadiness(&self) -> [f64; 6] {
        let rate = |i: usize| {
            let by = 1.0 / (self.times[i + 1] - self.times[i]);
            twist(&self.poses[i + 1].compose(&self.poses[i].inverse())).map(|part| part * by)
        };
        let (first, second) = (rate(0), rate(1));
        let [turn, shift] = [0, 1].map(|k| second[k] - first[k]);
        [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z]
    }

    /// Its residuals and their derivatives.
    fn add_to(&self, normal: &mut Normal, layout: &Layout, noise: &ChainNoise) {
        let here = self.unsteadiness();
        let mut terms: [Vec<(usize, f64)>; 6] = Default::default();
        for i in 0..3 {
            let Some(at) = layout.frames[self.frames[i]] else { return };
            for k in 0..6 {
                let by = 1e-6;
                let other = |sign: f64| {
                    let mut step = [0.0; 6];
                    step[k] = sign * by;
                    let mut all = *self;
                    all.poses[i] = moved(&self.poses[i], &step);
                    all.unsteadiness()
                };
                let (up, down) = (other(1.0), other(-1.0));
                for (terms, (up, down)) in terms.iter_mut().zip(up.into_iter().zip(down)) {
                    terms.push((at + k, (up - down) / (2.0 * by)));
                }
            }
        }
        for (k, (terms, e)) in terms.iter().zip(here).enumerate() {
            normal.add(terms, e, noise.body[k / 3]);
        }
    }
}

/// The logarithm of a motion: half of it is the motion of half the time (Murray et al. 1994, 2.3).
fn twist(motion: &Pose) -> [DVec3; 2] {
    let rotation = if motion.rotation.w < 0.0 { -motion.rotation } else { motion.rotation };
    let turn = rotation.to_scaled_axis();
    let angle = turn.length();
    let squared = if angle > 1e-4 {
        let (s, c) = angle.sin_cos();
        (1.0 - angle * s / (2.0 * (1.0 - c))) / (angle * angle)
    } else {
        1.0 / 12.0
    };
    let t = motion.translation;
    let across = turn.cross(t);
    [turn, t - across * 0.5 + turn.cross(across) * squared]
}

/// A pose after a small rotation of the camera (radians) and shift.
fn moved(pose: &Pose, step: &[f64]) -> Pose {
    let turn = DQuat::from_scaled_axis(DVec3::new(step[0], step[1], step[2]));
    Pose::new(turn * pose.rotation, pose.translation + DVec3::new(step[3], step[4], step[5]))
}

impl Chain {
    /// Frames that follow each other, three at a time.
    fn triples(&self) -> impl Iterator<Item = Triple> + '_ {
        (2..self.frames.len()).filter_map(|k| {
            let of = |k: usize| self.frames[k].map(|f| f.1);
            let frames = [k - 2, k - 1, k];
            let times = frames.map(|k| self.times[k]);
            Some(Triple { frames, poses: [of(k - 2)?, of(k - 1)?, of(k)?], times })
        })
    }

    fn layout(&self) -> Layout {
        let mut size = 0;
        let mut take = |n: usize| {
            size += n;
            size - n
        };
        let free = |c: &Camera| {
            let focals = c.model.num_focals();
            let distorted = (focals + 2..c.params.len()).filter(|&i| c.params[i] != 0.0);
            (0..focals).chain(distorted).collect::<Vec<usize>>()
        };
        let cameras = self.cameras.iter().map(free).map(|f| (take(f.len()), f)).collect();
        let frames = self.frames.iter().map(|f| f.map(|_| take(6))).collect();
        let mut joints: Vec<JointColumns> = Vec::new();
        for (path, tie) in self.joints.iter().zip(&self.ties) {
            let leader = tie.axis_of.map(|j| joints[j]);
            let axis = leader.map_or_else(|| take(SHARED), |l| l.axis);
            let (angles, ratio) = match (leader, tie.ratio) {
                (Some(l), Some(ratio)) => (l.angles, ratio * l.ratio),
                _ => (take(path.angles.len()), 1.0),
            };
            joints.push(JointColumns { axis, angles, ratio });
        }
        Layout { cameras, frames, joints, size }
    }

    fn stepped(&self, layout: &Layout, step: &[f64]) -> Self {
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

    /// Views of a track as its own rigid part at rest sees them.
    fn views<'a>(&'a self, member: &Member<'_>) -> Vec<(usize, PointView<'a>, Pose)> {
        let seen = member.track.positions.iter().enumerate();
        let view = |(k, pixel): (usize, &glam::DVec2)| {
            let frame = member.track.first + k;
            let (camera, pose) = (*self.frames.get(frame)?)?;
            let motion = member.joint.map_or(Some(Pose::IDENTITY), |j| self.joints[j].pose(frame))?;
            Some((frame, PointView::new(&pose.compose(&motion), &self.cameras[camera], *pixel), motion))
        };
        seen.filter_map(view).collect()
    }

    fn point(&self, member: &Member<'_>) -> Option<DVec3> {
        let views: Vec<PointView<'_>> = self.views(member).into_iter().map(|v| v.1).collect();
        let start = nearest_to_rays(views.iter())?;
        let x = refine_point(start, views.iter(), 8);
        (views.len() >= super::posed::LEAST_VIEWS && x.is_finite()).then_some(x)
    }

    /// The same with the last joint tied to another.
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

    /// The chain of least squared error over the tracks (Levenberg–Marquardt, points eliminated), and
    /// the logarithm of its evidence (Laplace; up to what all chains for these tracks have in common).
    pub(super) fn adjusted(&self, members: &[Member<'_>], noise: &ChainNoise) -> (Self, f64) {
        let layout = self.layout();
        let mut best = self.clone();
        let mut points: Vec<Option<DVec3>> = members.par_iter().map(|m| best.point(m)).collect();
        let body = |points: &[Option<DVec3>]| -> Vec<Option<DVec3>> {
            members.iter().zip(points).map(|(m, x)| x.filter(|_| m.joint.is_none())).collect()
        };
        let before = body(&points);
        let mut normal = best.normal(self, members, &points, &layout, noise);
        let mut lambda = 1e-4;
        for _ in 0..ROUNDS {
            let Some((step, moves)) = normal.step(lambda) else { break };
            let trial = best.stepped(&layout, &step);
            let next_points: Vec<Option<DVec3>> =
                points.iter().zip(moves).map(|(p, m)| p.map(|p| p + m)).collect();
            let next = trial.normal(self, members, &next_points, &layout, noise);
            if next.cost < normal.cost {
                let small = normal.cost - next.cost < 1e-5 * normal.cost;
                (best, points, normal, lambda) = (trial, next_points, next, lambda * 0.1);
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
        best.move_back(&before, &body(&points));
        for joint in &mut best.joints {
            let start = joint.angles[0];
            joint.angles.iter_mut().for_each(|a| *a -= start);
        }
        let evidence = best.evidence(&normal);
        (best, evidence)
    }

    /// Standard deviations of the joints, against the body as the first camera sees it, in sizes of
    /// the object; `None` where something is not determined at all.
    pub(super) fn sigmas(&self, members: &[Member<'_>], noise: &ChainNoise) -> Option<Vec<JointSigmas>> {
        let layout = self.layout();
        let points: Vec<Option<DVec3>> = members.par_iter().map(|m| self.point(m)).collect();
        let mut normal = self.normal(self, members, &points, &layout, noise);
        self.hold_frame(&mut normal, &layout);
        let all = normal.sigmas()?;
        let of_joint = |(path, at): (&JointPath, &JointColumns)| {
            let axis = &all[at.axis..at.axis + SHARED];
            JointSigmas {
                axis: axis[0].hypot(axis[1]),
                place: axis[2].hypot(axis[3]),
                angles: all[at.angles..at.angles + path.angles.len()].to_vec(),
            }
        };
        Some(self.joints.iter().zip(&layout.joints).map(of_joint).collect())
    }

    /// Holds the first frame's pose, and the distance to the farthest: frame and scale are free.
    fn hold_frame(&self, normal: &mut Normal, layout: &Layout) {
        let posed =
            || self.frames.iter().zip(&layout.frames).filter_map(|(f, at)| Some((f.as_ref()?.1, (*at)?)));
        let Some((first, at)) = posed().next() else { return };
        (0..6).for_each(|k| normal.add(&[(at + k, 1.0)], 0.0, ANCHOR));
        let centre = first.centre();
        let away = |pose: &Pose| pose.centre().distance(centre);
        let farthest = posed().max_by(|a, b| away(&a.0).total_cmp(&away(&b.0)));
        let Some((pose, at)) = farthest.filter(|f| away(&f.0) > 0.0) else { return };
        let derivative = |k: usize| {
            let mut step = [0.0; 6];
            step[k] = 1e-6;
            let up = away(&moved(&pose, &step));
            step[k] = -1e-6;
            (at + k, (up - away(&moved(&pose, &step))) / 2e-6)
        };
        normal.add(&[0, 1, 2, 3, 4, 5].map(derivative), 0.0, ANCHOR);
    }

    /// Back to where the body's points were: its frame is free in the adjustment.
    fn move_back(&mut self, before: &[Option<DVec3>], after: &[Option<DVec3>]) {
        let both: Vec<(DVec3, DVec3)> = after.iter().zip(before).filter_map(|(a, b)| a.zip(*b)).collect();
        let (from, to): (Vec<DVec3>, Vec<DVec3>) = both.into_iter().unzip();
        let Some((sim, _)) = robust_alignment(&from, &to) else { return };
        for (_, pose) in self.frames.iter_mut().flatten() {
            *pose = sim.transform_pose(pose);
        }
        for joint in &mut self.joints {
            joint.axis = sim.rotation * joint.axis;
            joint.place = sim.transform(joint.place);
        }
    }

    fn normal(
        &self,
        start: &Self,
        members: &[Member<'_>],
        points: &[Option<DVec3>],
        layout: &Layout,
        noise: &ChainNoise,
    ) -> Normal {
        let block = |(m, x): (&Member<'_>, &Option<DVec3>)| {
            x.map_or_else(Block::default, |x| self.block(m, x, layout, noise))
        };
        let blocks = members.par_iter().zip(points).map(block).collect();
        let mut all = Normal::of(layout.size, blocks);
        self.add_priors(&mut all, start, layout, noise);
        all
    }

    fn block(&self, member: &Member<'_>, x: DVec3, layout: &Layout, noise: &ChainNoise) -> Block {
        let mut rows = Vec::new();
        let mut cost = 0.0;
        let scale = 1.0 / (noise.pixel * noise.pixel);
        for (frame, view, motion) in self.views(member) {
            let Some((residual, by_point)) = linearise(&view, x) else { continue };
            let squared = residual[0] * residual[0] + residual[1] * residual[1];
            let (own, weight) = cauchy(squared, ROBUST * noise.pixel);
            cost += scale * own;
            let (Some((camera, pose)), Some(at)) = (self.frames[frame], layout.frames[frame]) else {
                continue;
            };
            let turned = pose.rotation * motion.transform(x);
            let intrinsics = self.by_intrinsics(camera, &view, x, &layout.cameras[camera].1);
            let joint = member.joint.map(|j| {
                let path = &self.joints[j];
                (layout.joints[j], frame - path.first, JointMoves::of(path, &motion, x, path.across()))
            });
            for (r, (residual, by_point)) in residual.into_iter().zip(by_point).enumerate() {
                // `by_point` is by the place in the part at rest.
                let in_camera = view.pose.rotation * by_point;
                let mut columns: Vec<(usize, f64)> = intrinsics
                    .iter()
                    .enumerate()
                    .map(|(k, d)| (layout.cameras[camera].0 + k, d[r]))
                    .collect();
                let turn = turned.cross(in_camera);
                let by_pose = [turn.x, turn.y, turn.z, in_camera.x, in_camera.y, in_camera.z];
                columns.extend(by_pose.into_iter().enumerate().map(|(k, d)| (at + k, d)));
                if let Some((at, angle, moves)) = &joint {
                    let in_body = pose.rotation.conjugate() * in_camera;
                    let axis = (0..SHARED).map(|k| (at.axis + k, in_body.dot(moves.0[k])));
                    columns.extend(axis);
                    columns.push((at.angles + angle, at.ratio * in_body.dot(moves.0[SHARED])));
                }
                rows.push(Row { columns, point: by_point, residual, weight: scale * weight });
            }
        }
        Block::of(cost, &rows)
    }

    /// How a projection moves with each free parameter of its camera, by differences.
    fn by_intrinsics(&self, camera: usize, view: &PointView<'_>, x: DVec3, free: &[usize]) -> Vec<[f64; 2]> {
        let camera = &self.cameras[camera];
        let local = view.pose.transform(x);
        let at = |i: usize, by: f64| {
            let mut other = camera.clone();
            other.params[i] += by;
            other.project(local)
        };
        let focals = camera.model.num_focals();
        let derivative = |&i: &usize| {
            let unit = if i < focals { camera.mean_focal() } else { 1.0 };
            let by = 1e-5;
            let (Some(up), Some(down)) = (at(i, by * unit), at(i, -by * unit)) else { return [0.0; 2] };
            ((up - down) / (2.0 * by)).to_array()
        };
        free.iter().map(derivative).collect()
    }

    /// Motions change slowly; intrinsics, frame and scale stay where nothing says otherwise.
    fn add_priors(&self, normal: &mut Normal, start: &Self, layout: &Layout, noise: &ChainNoise) {
        for ((own, was), (at, free)) in self.cameras.iter().zip(&start.cameras).zip(&layout.cameras) {
            let (focals, scale) = (own.model.num_focals(), was.mean_focal());
            for (k, &i) in free.iter().enumerate() {
                let (off, sigma) = if i < focals {
                    ((own.params[i] - was.params[i]) / scale, FOCAL)
                } else {
                    (own.params[i], DISTORTION)
                };
                normal.add(&[(at + k, 1.0)], off, sigma);
            }
        }
        for ((own, was), at) in self.frames.iter().zip(&start.frames).zip(&layout.frames) {
            let (Some((_, own)), Some((_, was)), Some(at)) = (own, was, at) else { continue };
            let turn = (own.rotation * was.rotation.conjugate()).to_scaled_axis();
            let shift = own.translation - was.translation;
            for (k, e) in turn.to_array().into_iter().chain(shift.to_array()).enumerate() {
                normal.add(&[(at + k, 1.0)], e, HELD);
            }
        }
        for triple in self.triples() {
            triple.add_to(normal, layout, noise);
        }
        let free = self.ties.iter().map(|t| t.ratio.is_none());
        for ((path, at), _) in self.joints.iter().zip(&layout.joints).zip(free).filter(|j| j.1) {
            normal.add(&[(at.angles, 1.0)], path.angles[0], ANCHOR);
            for (i, (change, by_angle)) in path.changes().enumerate() {
                let terms = [0, 1, 2].map(|k| (at.angles + i + k, by_angle[k]));
                normal.add(&terms, change, path.bend);
            }
        }
    }

    /// Logarithm of the evidence (Laplace).
    fn evidence(&self, normal: &Normal) -> f64 {
        let Some(half_log) = normal.half_log_determinant() else { return f64::NEG_INFINITY };
        let free = self.joints.iter().zip(&self.ties).filter(|j| j.1.ratio.is_none());
        let bends = free.map(|(j, _)| j.angles.len().saturating_sub(2) as f64 * j.bend.ln() + ANCHOR.ln());
        -0.5 * normal.cost - half_log - bends.sum::<f64>()
    }
}
