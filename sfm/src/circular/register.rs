//! Growing a turn along a video: each frame has one unknown, its angle.

use super::model::{AxisModel, CircularContext};
use super::motion::pose_at;
use crate::SfmError;
use crate::incremental::resection::visible;
use glam::{DVec2, DVec3};
use scene::{Camera, Pose};

/// Fewest samples of a search over angles.
const SAMPLES: i32 = 40;
/// Golden section steps after it.
const GOLDEN: usize = 18;
/// Residuals count at most so many pixels.
const LIMIT_PX: f64 = 4.0;
/// Most observations that are asked for an angle.
const MOST: usize = 400;
/// Points with which an angle is found, at least: it is one unknown, where a pose has six.
const LEAST_OBSERVATIONS: usize = 8;
/// Turn after which the model is adjusted again, radians.
const ADJUST_EVERY: f64 = 0.35;
/// Frames in a row that may be given the angle that the rate says.
const MOST_WEAK: usize = 12;
/// Range of angles from which on distortion is solved for, and the focal length, radians.
const RANGE_FOR: [f64; 2] = [2.0, 1.0];

/// An angle, and the observations that agree with it of those that were asked.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Resected {
    /// Radians.
    pub angle: f64,
    /// Observations within the limit.
    pub inliers: usize,
    /// Observations asked.
    pub asked: usize,
}

/// The angle within `span` of `start` at which known points fall on their pixels.
pub(crate) fn resect_angle(
    camera: &Camera,
    axis: &Pose,
    seen: &[(DVec2, DVec3)],
    start: f64,
    span: f64,
) -> Resected {
    let step = seen.len().div_ceil(MOST).max(1);
    let errors = |angle: f64| {
        let pose = pose_at(axis, angle);
        seen.iter().step_by(step).map(move |(pixel, x)| {
            camera.project(pose.transform(*x)).map_or(f64::INFINITY, |p| p.distance_squared(*pixel))
        })
    };
    let limit = LIMIT_PX * LIMIT_PX;
    let cost = |angle: f64| errors(angle).map(|e| e.min(limit)).sum::<f64>();
    // Points of an object that fills a good part of the image are off by the limit after two degrees.
    let samples = SAMPLES.max((span / 0.01) as i32);
    let grid = (-samples / 2..=samples / 2).map(|k| start + span * f64::from(k) / f64::from(samples / 2));
    let best = grid.map(|a| (cost(a), a)).min_by(|a, b| a.0.total_cmp(&b.0)).map_or(start, |b| b.1);
    let width = 2.0 * span / f64::from(samples);
    let (mut low, mut high) = (best - width, best + width);
    let ratio = 0.5 * (5f64.sqrt() - 1.0);
    let (mut a, mut b) = (high - ratio * (high - low), low + ratio * (high - low));
    let (mut ca, mut cb) = (cost(a), cost(b));
    for _ in 0..GOLDEN {
        if ca < cb {
            (high, b, cb) = (b, a, ca);
            a = high - ratio * (high - low);
            ca = cost(a);
        } else {
            (low, a, ca) = (a, b, cb);
            b = low + ratio * (high - low);
            cb = cost(b);
        }
    }
    let angle = 0.5 * (low + high);
    let inliers = errors(angle).filter(|e| *e < limit).count();
    Resected { angle, inliers, asked: errors(angle).count() }
}

/// Points of the model that a frame sees, by its tracks.
pub(crate) fn observed_points(
    model: &AxisModel,
    context: &CircularContext<'_>,
    frame: usize,
) -> Vec<(DVec2, DVec3)> {
    let pixels = &context.input.keypoints[frame];
    let place = |(feature, point): (u32, u32)| {
        let position = model.state.points[point as usize].as_ref()?.position;
        Some((pixels[feature as usize], position))
    };
    visible(&model.state, context.input, frame).into_iter().filter_map(place).collect()
}

impl AxisModel {
    /// Which intrinsics are solved for: the number of images that stands for it in the general solver.
    pub(crate) fn freedom_by_range(&self) -> usize {
        let known = || self.turn.angles.iter().flatten().copied();
        let range = known().fold(f64::MIN, f64::max) - known().fold(f64::MAX, f64::min);
        match range {
            r if r > RANGE_FOR[0] => usize::MAX,
            r if r > RANGE_FOR[1] => 5,
            _ => 2,
        }
    }

    /// Registers the frames after the last and before the first, as far as they see enough of the model. `times`: when
    /// each frame was taken, ascending.
    pub fn extend(&mut self, context: &CircularContext<'_>, times: &[f64]) -> Result<(), SfmError> {
        let known: Vec<usize> = (0..times.len()).filter(|&f| self.turn.angles[f].is_some()).collect();
        let (Some(&first), Some(&last)) = (known.first(), known.last()) else { return Ok(()) };
        self.walk(context, times, &(last + 1..times.len()).collect::<Vec<_>>(), last, first)?;
        self.walk(context, times, &(0..first).rev().collect::<Vec<_>>(), first, last)
    }

    /// Goes through `frames` from `from`; the rate is read off `from` and a frame some way back, at most to `limit`.
    fn walk(
        &mut self,
        context: &CircularContext<'_>,
        times: &[f64],
        frames: &[usize],
        from: usize,
        limit: usize,
    ) -> Result<(), SfmError> {
        let mut last = from;
        let mut turned_since = 0.0;
        let mut passed: Vec<usize> = vec![from];
        let mut back = limit;
        let mut placed_weakly = 0;
        for &frame in frames {
            context.progress.check()?;
            let angle = |f: usize| self.turn.angles[f].unwrap_or(0.0);
            if passed.len() > 6 {
                back = passed[passed.len() - 7];
            }
            let newest = passed[passed.len() - 1];
            let rate = (angle(newest) - angle(back)) / (times[newest] - times[back]);
            let expected = rate * (times[frame] - times[last]);
            let expected = if expected.is_finite() { expected } else { 0.0 };
            let seen = observed_points(self, context, frame);
            let least = context.input.config.min_observations.min(LEAST_OBSERVATIONS);
            let start = angle(last) + expected;
            if seen.len() < least {
                if placed_weakly < MOST_WEAK {
                    placed_weakly += 1;
                    self.place_weakly(context, frame, start);
                    last = frame;
                }
                continue;
            }
            let span = (0.7 * expected.abs()).max(0.02);
            let camera = &self.state.cameras[context.input.camera_of[frame]];
            let found = resect_angle(camera, &self.turn.axis, &seen, start, span);
            if found.inliers < least || found.inliers * 4 < found.asked {
                if placed_weakly < MOST_WEAK {
                    placed_weakly += 1;
                    self.place_weakly(context, frame, start);
                    last = frame;
                }
                continue;
            }
            placed_weakly = 0;
            turned_since += (found.angle - angle(last)).abs();
            self.register(frame, found.angle);
            self.state.grow_image(context.input, frame);
            passed.push(frame);
            last = frame;
            if turned_since > ADJUST_EVERY {
                turned_since = 0.0;
                if !self.adjust_rough(context)? {
                    return Ok(());
                }
            }
        }
        self.adjust_rough(context)?;
        Ok(())
    }

    /// Gives a frame that sees too little of the model the angle that the rate says; what it sees with its neighbours
    /// goes on from there.
    fn place_weakly(&mut self, context: &CircularContext<'_>, frame: usize, angle: f64) {
        self.register(frame, angle);
        self.state.grow_image(context.input, frame);
    }

    /// Gives a frame its angle.
    pub fn register(&mut self, frame: usize, angle: f64) {
        self.turn.angles[frame] = Some(angle);
        if let Some(pose) = self.turn.pose(frame) {
            self.state.register(frame, pose);
        }
    }

    fn adjust_rough(&mut self, context: &CircularContext<'_>) -> Result<bool, SfmError> {
        self.settle_with(context, 1, 50, self.freedom_by_range())
    }
}
