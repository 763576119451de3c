//! Growing a turn along a video: each frame has one unknown, its angle.

use super::limits::{COMPARABLE, INLIER_PX, LEAST_OBSERVATIONS};
use super::model::{AxisModel, CircularContext};
use super::motion::pose_at;
use crate::error::SfmError;
use crate::incremental::resection::visible;
use glam::{DVec2, DVec3};
use scene::{Camera, Pose};

/// Largest step of a search over angles, radians: points of an object that fills a good part of the
/// image are off by [`INLIER_PX`] after twice as much.
/// Source: derivation in this comment, for images of some 500 pixels.
const SEARCH_STEP: f64 = 0.01;
/// Fewest samples of such a search.
/// Source: chosen by hand, never measured.
const SAMPLES: i32 = 40;
/// Golden section steps after it.
/// Source: derivation: they narrow a sample to less than 0.0002 of its width.
const GOLDEN: usize = 18;
/// Frames that may be given the angle that the rate says, until one is resected again.
/// Source: chosen by hand, never measured.
const MOST_EXTRAPOLATED: usize = 12;

/// An angle, and the observations that agree with it of those that were asked.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Resected {
    /// Radians.
    pub angle: f64,
    /// Observations within [`INLIER_PX`].
    pub inliers: usize,
    /// Observations asked.
    pub asked: usize,
}

/// Known points and their pixels in one frame.
struct AngleSearch<'a> {
    camera: &'a Camera,
    axis: &'a Pose,
    seen: &'a [(DVec2, DVec3)],
}

impl AngleSearch<'_> {
    /// Squared reprojection errors at an angle, pixels².
    fn errors(&self, angle: f64) -> impl Iterator<Item = f64> {
        let pose = pose_at(self.axis, angle);
        self.seen.iter().map(move |(pixel, x)| {
            self.camera.project(pose.transform(*x)).map_or(f64::INFINITY, |p| p.distance_squared(*pixel))
        })
    }

    /// Their sum, each truncated.
    fn cost(&self, angle: f64) -> f64 {
        self.errors(angle).map(|e| e.min(INLIER_PX * INLIER_PX)).sum::<f64>()
    }

    /// Where the cost is least between two angles (golden section search, Kiefer 1953).
    fn minimise(&self, mut low: f64, mut high: f64) -> f64 {
        let ratio = 0.5 * (5f64.sqrt() - 1.0);
        let (mut a, mut b) = (high - ratio * (high - low), low + ratio * (high - low));
        let (mut ca, mut cb) = (self.cost(a), self.cost(b));
        for _ in 0..GOLDEN {
            if ca < cb {
                (high, b, cb) = (b, a, ca);
                a = high - ratio * (high - low);
                ca = self.cost(a);
            } else {
                (low, a, ca) = (a, b, cb);
                b = low + ratio * (high - low);
                cb = self.cost(b);
            }
        }
        0.5 * (low + high)
    }
}

/// The angle within `span` of `start` at which known points fall on their pixels.
pub(crate) fn resect_angle(
    camera: &Camera,
    axis: &Pose,
    seen: &[(DVec2, DVec3)],
    start: f64,
    span: f64,
) -> Resected {
    let search = AngleSearch { camera, axis, seen };
    let samples = SAMPLES.max((span / SEARCH_STEP) as i32);
    let grid = (-samples / 2..=samples / 2).map(|k| start + span * f64::from(k) / f64::from(samples / 2));
    let costs = grid.map(|a| (search.cost(a), a));
    let best = costs.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(start, |b| b.1);
    let width = 2.0 * span / f64::from(samples);
    let angle = search.minimise(best - width, best + width);
    let inliers = search.errors(angle).filter(|e| *e < INLIER_PX * INLIER_PX).count();
    Resected { angle, inliers, asked: search.errors(angle).count() }
}

/// Points of the model that a frame sees, by its tracks.
pub(crate) fn observed_points(
    model: &AxisModel,
    context: &CircularContext<'_>,
    frame: usize,
) -> Vec<(DVec2, DVec3)> {
    let pixels = &context.input.keypoints[frame];
    let mut seen = Vec::new();
    for (feature, point) in visible(&model.state, context.input, frame) {
        if let Some(point) = &model.state.points[point as usize] {
            seen.push((pixels[feature as usize], point.position));
        }
    }
    seen
}

impl AxisModel {
    /// Smallest and largest angle, radians.
    pub(crate) fn extent(&self) -> [f64; 2] {
        let known = self.turn.angles.iter().flatten();
        known.fold([f64::MAX, f64::MIN], |[low, high], a| [low.min(*a), high.max(*a)])
    }

    /// Which intrinsics are solved for: the number of images that stands for it in the general
    /// solver. The focal length from one radian on, distortion from two.
    pub(crate) fn freedom_by_range(&self) -> usize {
        let [low, high] = self.extent();
        match high - low {
            r if r > 2.0 => usize::MAX,
            r if r > 1.0 => 5,
            _ => 2,
        }
    }

    /// Registers the frames after the last and before the first, as far as they see enough of the
    /// model. `times`: when each frame was taken, ascending.
    pub(crate) fn extend(&mut self, context: &CircularContext<'_>, times: &[f64]) -> Result<(), SfmError> {
        let mut known = (0..times.len()).filter(|&f| self.turn.angles[f].is_some());
        let Some(first) = known.next() else { return Ok(()) };
        let last = known.next_back().unwrap_or(first);
        self.walk(context, times, last + 1..times.len(), &mut FrameWalk::new(last, first))?;
        self.walk(context, times, (0..first).rev(), &mut FrameWalk::new(first, last))
    }

    /// Goes through `frames` outwards.
    fn walk(
        &mut self,
        context: &CircularContext<'_>,
        times: &[f64],
        frames: impl Iterator<Item = usize>,
        walk: &mut FrameWalk,
    ) -> Result<(), SfmError> {
        for frame in frames {
            context.progress.check()?;
            let before = self.turn.angles[walk.last].unwrap_or(0.0);
            let expected = walk.expected_step(self, times, frame);
            let start = before + expected;
            let Some(angle) = self.resect_near(context, frame, start, (0.7 * expected.abs()).max(0.02))
            else {
                if walk.may_extrapolate() {
                    self.register(context, frame, start);
                    walk.last = frame;
                }
                continue;
            };
            self.register(context, frame, angle);
            if walk.is_adjustment_due(frame, (angle - before).abs())
                && !self.settle_rough(context, self.freedom_by_range())?
            {
                return Ok(());
            }
        }
        self.settle_rough(context, self.freedom_by_range())?;
        Ok(())
    }

    /// The angle of a frame within `span` of `start`; `None` where it sees too little of the model.
    fn resect_near(&self, context: &CircularContext<'_>, frame: usize, start: f64, span: f64) -> Option<f64> {
        let seen = observed_points(self, context, frame);
        let least = context.input.config.min_observations.min(LEAST_OBSERVATIONS);
        if seen.len() < least {
            return None;
        }
        let camera = &self.state.cameras[context.input.camera_of[frame]];
        let found = resect_angle(camera, &self.turn.axis, &seen, start, span);
        (found.inliers >= least && found.inliers * 4 >= found.asked).then_some(found.angle)
    }

    /// Gives a frame its angle and triangulates what it sees.
    pub(crate) fn register(&mut self, context: &CircularContext<'_>, frame: usize, angle: f64) {
        self.turn.angles[frame] = Some(angle);
        if let Some(pose) = self.turn.pose(frame) {
            self.state.register(frame, pose);
        }
        self.state.grow_image(context.input, frame);
    }
}

/// Where a walk along the frames is.
struct FrameWalk {
    /// Frames with resected angles; the first one had its angle before.
    resected: Vec<usize>,
    /// The rate is read off the last of them and this one.
    back: usize,
    /// The last frame that has an angle.
    last: usize,
    /// Frames in a row whose angle was extrapolated.
    extrapolated: usize,
    /// Radians since the last adjustment.
    turned: f64,
}

impl FrameWalk {
    /// From a frame; the rate is read off it and another one at first.
    fn new(from: usize, back: usize) -> Self {
        Self { resected: vec![from], back, last: from, extrapolated: 0, turned: 0.0 }
    }

    /// The turn from the last frame to another at the present rate, radians.
    fn expected_step(&mut self, model: &AxisModel, times: &[f64], frame: usize) -> f64 {
        let newest = self.resected[self.resected.len() - 1];
        if self.resected.len() > LEAST_OBSERVATIONS {
            self.back = self.resected[self.resected.len() - 1 - LEAST_OBSERVATIONS];
        }
        let [end, start] = [newest, self.back].map(|f| model.turn.angles[f].unwrap_or(0.0));
        let rate = (end - start) / (times[newest] - times[self.back]);
        let expected = rate * (times[frame] - times[self.last]);
        if expected.is_finite() { expected } else { 0.0 }
    }

    /// Whether one more frame may have the angle that the rate says.
    fn may_extrapolate(&mut self) -> bool {
        self.extrapolated += 1;
        self.extrapolated <= MOST_EXTRAPOLATED
    }

    /// Notes a resected frame, so much on from the last; whether the model has turned far since it
    /// was adjusted.
    fn is_adjustment_due(&mut self, frame: usize, step: f64) -> bool {
        self.extrapolated = 0;
        self.turned += step;
        self.resected.push(frame);
        self.last = frame;
        let due = self.turned > 0.5 * COMPARABLE;
        if due {
            self.turned = 0.0;
        }
        due
    }
}
