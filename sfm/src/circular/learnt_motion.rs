//! What was learnt of the motion of a video, as priors and as angles of all frames.

use super::limits::HELD;
use super::motion::CircularMotion;
use super::prior::AnglePrior;
use scene::decision::Decision;

/// The angles under what was learnt of the motion.
pub(crate) struct LearntMotion {
    /// Frames, in their order.
    pub images: Vec<usize>,
    /// Angles of these frames, radians.
    pub angles: Vec<f64>,
    /// Their standard deviations against the first, radians.
    pub deviations: Vec<f64>,
    /// Factor on the variances that the observations' noise alone would give.
    pub excess: f64,
    /// Angles at the times that were asked for, seconds and radians, with standard deviations.
    pub between: Vec<AngleAt>,
    /// For the report.
    pub decision: Decision,
}

/// What a motion says of the angle at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AngleAt {
    /// Seconds.
    pub time: f64,
    /// Radians.
    pub angle: f64,
    /// Standard deviation, radians.
    pub deviation: f64,
}

impl LearntMotion {
    /// Holds every angle against the first: the adjustment of all else under the learnt motion.
    pub(crate) fn holding_prior(&self) -> AnglePrior<'_> {
        self.prior(vec![HELD; self.images.len()])
    }

    /// The same as loose as the angles are known, for standard deviations of all else.
    pub(crate) fn loose_prior(&self) -> AnglePrior<'_> {
        self.prior(self.deviations.iter().map(|d| d.max(HELD)).collect())
    }

    fn prior(&self, sigmas: Vec<f64>) -> AnglePrior<'_> {
        AnglePrior::Smooth { frames: &self.images, angles: &self.angles, sigmas }
    }

    /// The angles between frames as counted by a finished turn, whose first angle is 0 and whose
    /// sense may be the other one.
    pub(crate) fn between(&self, turn: &CircularMotion) -> Vec<AngleAt> {
        let (Some(&first), Some(&start)) = (self.images.first(), self.angles.first()) else {
            return Vec::new();
        };
        let at = |frame: usize| turn.angles[frame].unwrap_or(0.0) - turn.angles[first].unwrap_or(0.0);
        let agreement: f64 = self.images.iter().zip(&self.angles).map(|(&f, a)| at(f) * (a - start)).sum();
        let sign = if agreement < 0.0 { -1.0 } else { 1.0 };
        let zero = turn.angles[first].unwrap_or(0.0);
        let counted = |a: &AngleAt| AngleAt { angle: zero + sign * (a.angle - start), ..*a };
        self.between.iter().map(counted).collect()
    }

    /// By frame, of so many.
    pub(crate) fn by_frame(&self, frames: usize) -> Vec<Option<f64>> {
        let mut angles = vec![None; frames];
        self.images.iter().zip(&self.angles).for_each(|(&f, a)| angles[f] = Some(*a));
        angles
    }
}
