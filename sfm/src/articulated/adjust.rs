//! Cameras, body and joints together: what a moving part shows corrects the focal length and the
//! poses that its motion had bent.

use super::chain::{Chain, ChainLayout, Member, nudged};
use super::joint::{JointMoves, JointPath, JointSigmas};
use super::limits::{ANCHOR, HELD, INTRINSICS, MOVING, SHARED};
use super::normal::{Block, JointEquations, NormalRow};
use super::steadiness::ChainNoise;
use crate::solvers::levenberg::cauchy;
use crate::triangulation::{PointView, linearise};
use glam::DVec3;
use rayon::prelude::*;
use scene::Pose;
use scene::sim3::robust_alignment;

impl Chain {
    /// The chain of least squared error over the tracks (Levenberg–Marquardt, points eliminated),
    /// and the logarithm of the prior's part in its evidence (Laplace): what the tracks say is not
    /// in it. `tolerance`: share of the cost; steps that gain less are the last.
    pub(super) fn adjusted(&self, members: &[Member<'_>], noise: &ChainNoise, tolerance: f64) -> (Self, f64) {
        let layout = self.layout();
        let mut best = self.clone();
        let mut points: Vec<Option<DVec3>> = members.par_iter().map(|m| best.point(m)).collect();
        let before = of_body(members, &points);
        let mut equations = best.equations(self, members, &points, &layout, noise);
        let mut lambda = 1e-5;
        // Most end far earlier, where the error no longer falls.
        for _ in 0..30 {
            let Some((step, moves)) = equations.step(lambda) else { break };
            let trial = best.stepped(&layout, &step);
            let next_points: Vec<Option<DVec3>> =
                points.iter().zip(moves).map(|(p, m)| p.map(|p| p + m)).collect();
            let next = trial.equations(self, members, &next_points, &layout, noise);
            if next.cost < equations.cost {
                let small = equations.cost - next.cost < tolerance * equations.cost;
                (best, points, equations, lambda) = (trial, next_points, next, lambda * 0.1);
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
        best.move_back(&before, &of_body(members, &points));
        best.joints = best.joints.into_iter().map(JointPath::starting_at_zero).collect();
        let evidence = best.evidence(&equations);
        (best, evidence)
    }

    /// Standard deviations of the joints, against the body as the first camera sees it, in sizes of
    /// the object; `None` where something is not determined at all.
    pub(super) fn sigmas(&self, members: &[Member<'_>], noise: &ChainNoise) -> Option<Vec<JointSigmas>> {
        let layout = self.layout();
        let points: Vec<Option<DVec3>> = members.par_iter().map(|m| self.point(m)).collect();
        let mut equations = self.equations(self, members, &points, &layout, noise);
        self.hold_frame(&mut equations, &layout);
        let all = equations.sigmas()?;
        let of_joints = self.joints.iter().zip(&layout.joints).map(|(path, at)| {
            let axis = &all[at.axis..at.axis + SHARED];
            JointSigmas {
                axis: axis[0].hypot(axis[1]),
                place: axis[2].hypot(axis[3]),
                angles: all[at.angles..at.angles + path.angles.len()].to_vec(),
            }
        });
        Some(of_joints.collect())
    }

    /// Holds the first frame's pose, and the distance to the farthest: frame and scale are free.
    fn hold_frame(&self, equations: &mut JointEquations, layout: &ChainLayout) {
        let posed = self.frames.iter().zip(&layout.frames);
        let posed: Vec<(Pose, usize)> = posed.filter_map(|(f, at)| Some((f.as_ref()?.1, (*at)?))).collect();
        let Some((first, at)) = posed.first() else { return };
        (0..6).for_each(|k| equations.add(&[(at + k, 1.0)], 0.0, ANCHOR));
        let centre = first.centre();
        let away = posed.iter().map(|(pose, at)| (pose.centre().distance(centre), pose, at));
        let farthest = away.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|f| f.0 > 0.0);
        let Some((_, pose, at)) = farthest else { return };
        let derivatives = [0, 1, 2, 3, 4, 5].map(|k| {
            let [up, down] = [1e-6, -1e-6].map(|by| nudged(pose, k, by).centre().distance(centre));
            (at + k, (up - down) / 2e-6)
        });
        equations.add(&derivatives, 0.0, ANCHOR);
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

    /// The problem at this state, which began at `start`.
    fn equations(
        &self,
        start: &Self,
        members: &[Member<'_>],
        points: &[Option<DVec3>],
        layout: &ChainLayout,
        noise: &ChainNoise,
    ) -> JointEquations {
        let both = members.par_iter().zip(points);
        let blocks =
            both.map(|(m, x)| x.map_or_else(Block::default, |x| self.block(m, x, layout, noise))).collect();
        let mut all = JointEquations::of(layout.size, blocks);
        self.add_stays(&mut all, start, layout);
        self.add_motions(&mut all, layout, noise);
        all
    }

    /// What a track with the place `x` at rest adds.
    fn block(&self, member: &Member<'_>, x: DVec3, layout: &ChainLayout, noise: &ChainNoise) -> Block {
        let mut rows = Vec::new();
        let mut cost = 0.0;
        let scale = 1.0 / (noise.pixel * noise.pixel);
        for (frame, view, motion) in self.views(member) {
            let Some((residual, by_point)) = linearise(&view, x) else { continue };
            let squared = residual[0] * residual[0] + residual[1] * residual[1];
            let (own, weight) = cauchy(squared, MOVING * noise.pixel);
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
                let first = layout.cameras[camera].0;
                let mut columns: Vec<(usize, f64)> =
                    intrinsics.iter().enumerate().map(|(k, d)| (first + k, d[r])).collect();
                let turn = turned.cross(in_camera);
                let by_pose = [turn.x, turn.y, turn.z, in_camera.x, in_camera.y, in_camera.z];
                columns.extend(by_pose.into_iter().enumerate().map(|(k, d)| (at + k, d)));
                if let Some((at, angle, moves)) = &joint {
                    let in_body = pose.rotation.conjugate() * in_camera;
                    let axis = (0..SHARED).map(|k| (at.axis + k, in_body.dot(moves.0[k])));
                    columns.extend(axis);
                    columns.push((at.angles + angle, at.ratio * in_body.dot(moves.0[SHARED])));
                }
                rows.push(NormalRow { columns, point: by_point, residual, weight: scale * weight });
            }
        }
        Block::of(cost, &rows)
    }

    /// How a projection moves with each free parameter of its camera, by differences.
    fn by_intrinsics(&self, camera: usize, view: &PointView<'_>, x: DVec3, free: &[usize]) -> Vec<[f64; 2]> {
        let camera = &self.cameras[camera];
        let local = view.pose.transform(x);
        let focals = camera.model.num_focals();
        let derivatives = free.iter().map(|&i| {
            let unit = if i < focals { camera.mean_focal() } else { 1.0 };
            let by = 1e-5;
            let [up, down] = [by, -by].map(|by| {
                let mut other = camera.clone();
                other.params[i] += by * unit;
                other.project(local)
            });
            up.zip(down).map_or([0.0; 2], |(up, down)| ((up - down) / (2.0 * by)).to_array())
        });
        derivatives.collect()
    }

    /// Intrinsics, frame and scale stay where nothing says otherwise.
    fn add_stays(&self, equations: &mut JointEquations, start: &Self, layout: &ChainLayout) {
        let [focal, distortion] = INTRINSICS;
        for ((own, was), (at, free)) in self.cameras.iter().zip(&start.cameras).zip(&layout.cameras) {
            let (focals, scale) = (own.model.num_focals(), was.mean_focal());
            for (k, &i) in free.iter().enumerate() {
                let (off, sigma) = if i < focals {
                    ((own.params[i] - was.params[i]) / scale, focal)
                } else {
                    (own.params[i], distortion)
                };
                equations.add(&[(at + k, 1.0)], off, sigma);
            }
        }
        for ((own, was), at) in self.frames.iter().zip(&start.frames).zip(&layout.frames) {
            let (Some((_, own)), Some((_, was)), Some(at)) = (own, was, at) else { continue };
            let turn = (own.rotation * was.rotation.conjugate()).to_scaled_axis();
            let shift = own.translation - was.translation;
            for (k, e) in turn.to_array().into_iter().chain(shift.to_array()).enumerate() {
                equations.add(&[(at + k, 1.0)], e, HELD);
            }
        }
    }

    /// Motions change slowly, and joints turn from zero.
    fn add_motions(&self, equations: &mut JointEquations, layout: &ChainLayout, noise: &ChainNoise) {
        for triple in self.triples() {
            triple.add_to(equations, layout, noise);
        }
        let free = self.ties.iter().map(|t| t.ratio.is_none());
        for ((path, at), _) in self.joints.iter().zip(&layout.joints).zip(free).filter(|j| j.1) {
            equations.add(&[(at.angles, 1.0)], path.angles[0], ANCHOR);
            for (i, (change, by_angle)) in path.changes().enumerate() {
                let terms = [0, 1, 2].map(|k| (at.angles + i + k, by_angle[k]));
                equations.add(&terms, change, path.bend);
            }
        }
    }

    /// Logarithm of the evidence (Laplace) but for the tracks' misfit.
    fn evidence(&self, equations: &JointEquations) -> f64 {
        let Some(half_log) = equations.half_log_determinant() else { return f64::NEG_INFINITY };
        let free = self.joints.iter().zip(&self.ties).filter(|j| j.1.ratio.is_none());
        let bends = free.map(|(j, _)| j.angles.len().saturating_sub(2) as f64 * j.bend.ln() + ANCHOR.ln());
        -0.5 * equations.prior - half_log - bends.sum::<f64>()
    }
}

/// The points of the body alone.
fn of_body(members: &[Member<'_>], points: &[Option<DVec3>]) -> Vec<Option<DVec3>> {
    members.iter().zip(points).map(|(m, x)| x.filter(|_| m.joint.is_none())).collect()
}
