//! Poses of a torque-free body: its attitude, and its centre of mass on a straight line.

use super::fit::{Attitude, TorqueFreeFit};
use crate::solvers::levenberg::{Normal, cauchy, minimise};
use crate::statistics::{MEDIAN_LENGTH, median};
use glam::{DQuat, DVec3};
use scene::Pose;

/// Unknowns of a place: centre of mass, its place at time 0 and its velocity.
/// Source: derived.
const UNKNOWNS: usize = 9;

/// The centre of mass of a body before a camera that keeps its station or drifts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CentreOfMass {
    /// World frame (that of the body), scene units.
    pub centre: DVec3,
    /// Where it is at the epoch, camera frame.
    pub place: DVec3,
    /// How it moves on, camera frame, a second.
    pub velocity: DVec3,
    /// Standard deviation of a coordinate of the residual, scene units.
    pub sigma: f64,
}

/// The motion of a body on which nothing acts.
#[derive(Clone, Debug)]
pub(super) struct TorqueFreeMotion {
    pub turn: TorqueFreeFit,
    pub mass: CentreOfMass,
}

impl TorqueFreeMotion {
    /// The motion nearest to some poses; `None` where there are too few or nothing turns.
    pub(super) fn of_poses(poses: &[Pose], times: &[f64]) -> Option<Self> {
        let attitude = |(pose, time): (&Pose, &f64)| Attitude { time: *time, rotation: pose.rotation };
        let turn = TorqueFreeFit::of(&poses.iter().zip(times).map(attitude).collect::<Vec<_>>())?;
        let times: Vec<f64> = times.iter().map(|t| t - turn.epoch).collect();
        let mass = CentreOfMass::of(poses, &times);
        Some(Self { turn, mass })
    }

    /// Expected poses at some times, seconds.
    pub(super) fn poses(&self, times: &[f64]) -> Vec<Pose> {
        let turns = self.turn.attitudes(times);
        let pose = |(rotation, time): (DQuat, &f64)| {
            let place = self.mass.place + self.mass.velocity * (time - self.turn.epoch);
            Pose::new(rotation, place - rotation * self.mass.centre)
        };
        turns.into_iter().zip(times).map(pose).collect()
    }

    /// Distance of the centre of mass from the camera, scene units.
    pub(super) fn distance(&self) -> f64 {
        self.mass.place.length()
    }
}

impl CentreOfMass {
    /// `R_i c + t_i = p + v τ_i` for all poses, robustly.
    fn of(poses: &[Pose], times: &[f64]) -> Self {
        let span = times.iter().map(|t| t.abs()).fold(1e-9, f64::max);
        let scale = median(poses.iter().map(|p| p.translation.length()).collect()).max(f64::MIN_POSITIVE);
        let residuals = |x: &[f64; UNKNOWNS]| -> Vec<DVec3> {
            let [centre, place, velocity] = [0, 3, 6].map(|k| DVec3::from_slice(&x[k..]));
            let of = |(pose, time): (&Pose, &f64)| {
                pose.rotation * centre + pose.translation / scale - place - velocity * (time / span)
            };
            poses.iter().zip(times).map(of).collect()
        };
        let noise = |x: &[f64; UNKNOWNS]| {
            (median(residuals(x).iter().map(|r| r.length()).collect()) / MEDIAN_LENGTH).max(1e-9)
        };
        let mut x = [0.0; UNKNOWNS];
        let mean = poses.iter().map(|p| p.translation / scale).sum::<DVec3>() / poses.len() as f64;
        x[3..6].copy_from_slice(&mean.to_array());
        let mut sigma = noise(&x);
        for _ in 0..4 {
            let evaluate = |x: &[f64; UNKNOWNS]| {
                let mut normal = Normal::new();
                for ((r, pose), time) in residuals(x).into_iter().zip(poses).zip(times) {
                    let (cost, weight) = cauchy(r.length_squared() / (sigma * sigma), 2.0 * 3f64.sqrt());
                    normal.add_cost(cost);
                    let rotation = pose.matrix();
                    for axis in 0..3 {
                        let mut gradient = [0.0; UNKNOWNS];
                        gradient[..3].copy_from_slice(&(rotation.row(axis) / sigma).to_array());
                        gradient[3 + axis] = -1.0 / sigma;
                        gradient[6 + axis] = -time / span / sigma;
                        normal.add(r[axis] / sigma, &gradient, weight);
                    }
                }
                Some(normal)
            };
            x = minimise(x, 30, evaluate, |x, step| std::array::from_fn(|i| x[i] + step[i]));
            sigma = noise(&x);
        }
        let [centre, place, velocity] = [0, 3, 6].map(|k| DVec3::from_slice(&x[k..]) * scale);
        Self { centre, place, velocity: velocity / span, sigma: sigma * scale }
    }
}

#[cfg(test)]
mod tests;
