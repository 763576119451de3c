//! How slowly the body's motion changes from frame to frame.

use super::chain::{Chain, ChainLayout, nudged};
use super::limits::BENDS;
use super::normal::JointEquations;
use glam::DVec3;
use scene::Pose;

/// What the observations and the motion are worth.
#[derive(Clone, Debug)]
pub(super) struct ChainNoise {
    /// Standard deviation of an observation, pixels.
    pub pixel: f64,
    /// That of the change of the body's motion from frame to frame, rotation (radians) and
    /// translation (sizes).
    body: [f64; 2],
}

/// Frames that follow each other.
#[derive(Clone, Copy)]
pub(super) struct Triple {
    frames: [usize; 3],
    poses: [Pose; 3],
    times: [f64; 3],
}

impl ChainNoise {
    /// How unsteady the motions are, they say themselves. `pixel`: standard deviation of an
    /// observation.
    pub(super) fn of(chain: &Chain, pixel: f64) -> Self {
        let mut sums = [0.0; 2];
        let mut count = 0.0;
        for triple in chain.triples() {
            let e = triple.unsteadiness();
            sums[0] += e[..3].iter().map(|v| v * v).sum::<f64>() / 3.0;
            sums[1] += e[3..].iter().map(|v| v * v).sum::<f64>() / 3.0;
            count += 1.0;
        }
        let body = sums.map(|s: f64| (s / f64::max(count, 1.0)).sqrt().max(BENDS[0]));
        Self { pixel, body }
    }
}

impl Chain {
    /// Frames that follow each other, three at a time.
    pub(super) fn triples(&self) -> impl Iterator<Item = Triple> + '_ {
        (2..self.frames.len()).filter_map(|k| {
            let frames = [k - 2, k - 1, k];
            let [a, b, c] = frames.map(|k| self.frames[k].map(|f| f.1));
            Some(Triple { frames, poses: [a?, b?, c?], times: frames.map(|k| self.times[k]) })
        })
    }
}

impl Triple {
    /// The body's motion in a frame's time from one of the frames to the next.
    fn rate(&self, from: usize) -> [DVec3; 2] {
        let by = 1.0 / (self.times[from + 1] - self.times[from]);
        twist(&self.poses[from + 1].compose(&self.poses[from].inverse())).map(|part| part * by)
    }

    /// How the body's motion in a frame's time changes: rotation vector, translation.
    fn unsteadiness(&self) -> [f64; 6] {
        let (first, second) = (self.rate(0), self.rate(1));
        let [turn, shift] = [0, 1].map(|k| second[k] - first[k]);
        [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z]
    }

    /// The same after a small step of one number of one of the poses.
    fn unsteadiness_after(&self, pose: usize, number: usize, by: f64) -> [f64; 6] {
        let mut other = *self;
        other.poses[pose] = nudged(&self.poses[pose], number, by);
        other.unsteadiness()
    }

    /// Its residuals and their derivatives, by differences.
    pub(super) fn add_to(&self, equations: &mut JointEquations, layout: &ChainLayout, noise: &ChainNoise) {
        let here = self.unsteadiness();
        let mut terms: [Vec<(usize, f64)>; 6] = Default::default();
        for i in 0..3 {
            let Some(at) = layout.frames[self.frames[i]] else { return };
            for k in 0..6 {
                let by = 1e-6;
                let (up, down) = (self.unsteadiness_after(i, k, by), self.unsteadiness_after(i, k, -by));
                for (terms, (up, down)) in terms.iter_mut().zip(up.into_iter().zip(down)) {
                    terms.push((at + k, (up - down) / (2.0 * by)));
                }
            }
        }
        for (k, (terms, e)) in terms.iter().zip(here).enumerate() {
            equations.add(terms, e, noise.body[k / 3]);
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
