//! A joint refined over the tracks that follow it, and how well it explains them.

use super::joint::{JointMoves, JointPath};
use super::limits::{ANCHOR, MOVING, SHARED};
use super::normal::{Block, JointEquations, NormalRow};
use super::posed::PosedTrack;
use crate::solvers::levenberg::cauchy;
use crate::triangulation::linearise;
use glam::DVec3;
use rayon::prelude::*;

impl JointPath {
    /// The joint of least squared error over the tracks (Levenberg–Marquardt; points are
    /// eliminated). `pixel`: standard deviation of an observation.
    pub(super) fn refined(&self, tracks: &[&PosedTrack<'_>], pixel: f64, rounds: usize) -> Self {
        let mut best = self.clone();
        let mut points = points(&best, tracks);
        let mut equations = best.equations(tracks, &points, pixel);
        let mut lambda = 1e-4;
        for _ in 0..rounds {
            let Some((step, moves)) = equations.step(lambda) else { break };
            let trial = best.stepped(&step);
            let moved: Vec<Option<DVec3>> = points.iter().zip(moves).map(|(p, m)| p.map(|p| p + m)).collect();
            let next = trial.equations(tracks, &moved, pixel);
            if next.cost < equations.cost {
                let small = equations.cost - next.cost < 1e-6 * equations.cost;
                (best, points, equations, lambda) = (trial, moved, next, lambda * 0.1);
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
        best.starting_at_zero()
    }

    /// Logarithm of the evidence of what the tracks show for a joint so unsteady (Laplace), up to a
    /// constant of the tracks.
    pub(super) fn evidence(&self, tracks: &[&PosedTrack<'_>], pixel: f64) -> f64 {
        let equations = self.equations(tracks, &points(self, tracks), pixel);
        let Some(half_log) = equations.half_log_determinant() else { return f64::NEG_INFINITY };
        let bends = self.angles.len().saturating_sub(2);
        -0.5 * equations.cost - half_log - bends as f64 * self.bend.ln()
    }

    fn equations(&self, tracks: &[&PosedTrack<'_>], points: &[Option<DVec3>], pixel: f64) -> JointEquations {
        let both = tracks.par_iter().zip(points);
        let blocks = both.map(|(t, x)| x.map_or_else(Block::default, |x| self.block(t, x, pixel))).collect();
        let mut all = JointEquations::of(SHARED + self.angles.len(), blocks);
        // The first angle is zero, and rates change slowly.
        all.add(&[(SHARED, 1.0)], self.angles[0], ANCHOR);
        for (i, (change, by_angle)) in self.changes().enumerate() {
            all.add(&[0, 1, 2].map(|k| (SHARED + i + k, by_angle[k])), change, self.bend);
        }
        all
    }

    /// What a track with the place `x` at rest adds.
    fn block(&self, track: &PosedTrack<'_>, x: DVec3, pixel: f64) -> Block {
        let across = self.across();
        let scale = 1.0 / (pixel * pixel);
        let (mut cost, mut rows) = (0.0, Vec::new());
        for (frame, view) in &track.views {
            let Some(motion) = self.pose(*frame) else { continue };
            let Some((residual, derivative)) = linearise(view, motion.transform(x)) else { continue };
            let squared = residual[0] * residual[0] + residual[1] * residual[1];
            let (own, weight) = cauchy(squared, MOVING * pixel);
            cost += scale * own;
            let moves = JointMoves::of(self, &motion, x, across);
            let numbers = [0, 1, 2, 3, SHARED + frame - self.first];
            for (residual, row) in residual.into_iter().zip(derivative) {
                let columns = numbers.into_iter().zip(moves.0.map(|m| row.dot(m))).collect();
                let point = motion.rotation.conjugate() * row;
                rows.push(NormalRow { columns, point, residual, weight: scale * weight });
            }
        }
        Block::of(cost, &rows)
    }
}

/// The points at rest that the tracks see under the joint.
fn points(path: &JointPath, tracks: &[&PosedTrack<'_>]) -> Vec<Option<DVec3>> {
    tracks.par_iter().map(|t| t.point(path).map(|p| p.0)).collect()
}
