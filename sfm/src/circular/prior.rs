//! What is known of the angles beside the observations, as relations between two or three of them.
//!
//! What is known of the axis instead (a measured elevation) is an
//! [`ElevationPrior`](super::problem::ElevationPrior).

use super::limits::{LEAST_OBSERVATIONS, LEAST_SIGMA, MOST, RATE_CHANGE};
use super::motion::wrap_angle;
use super::problem::Relation;
use crate::statistics::{MEDIAN_DEVIATION, median};

/// A step is even if it is no farther from the median than this share of it.
/// Source: chosen by hand, never measured.
pub(crate) const EVEN: f64 = 0.35;

/// A prior on the angles of a circular motion.
#[derive(Clone, Debug)]
pub(crate) enum AnglePrior<'a> {
    /// The object turns at a rate that a user knows, radians a second of either sign; `times` by
    /// frame, seconds.
    KnownRate { times: &'a [f64], rate: f64 },
    /// The rate does not jump from one step to the next. Frames far apart share next to no points,
    /// and a few wrong observations could put them anywhere.
    Steady { times: &'a [f64] },
    /// Angles against the first frame as a Gaussian process has them, with standard deviations.
    Smooth { frames: &'a [usize], angles: &'a [f64], sigmas: Vec<f64> },
    /// Images go round by one step, where they do so evenly in their order: `θ_i = c + i r`.
    ConstantStep,
    /// The angle between the first and the last frame of a whole turn.
    LoopClosure(Relation),
}

impl AnglePrior<'_> {
    /// The relations that it puts between frames of these angles (radians, by frame).
    pub(crate) fn relations(&self, angles: &[Option<f64>]) -> Vec<Relation> {
        match self {
            Self::KnownRate { times, rate } => known_rate(angles, times, *rate),
            Self::Steady { times } => steady(angles, times),
            Self::Smooth { frames, angles, sigmas } => (1..frames.len())
                .map(|i| Relation::difference(frames[0], frames[i], angles[i] - angles[0], sigmas[i]))
                .collect(),
            Self::ConstantStep => constant_step(angles),
            Self::LoopClosure(relation) => vec![*relation],
        }
    }
}

/// What a known rate says of neighbouring angles, to a hundredth.
fn known_rate(angles: &[Option<f64>], times: &[f64], rate: f64) -> Vec<Relation> {
    let known: Vec<(usize, f64)> = with_angles(angles, times).map(|(f, angle, _)| (f, angle)).collect();
    let sense = match (known.first(), known.last()) {
        (Some(first), Some(last)) => (last.1 - first.1).signum(),
        _ => 1.0,
    };
    known
        .windows(2)
        .map(|w| {
            let target = sense * rate.abs() * (times[w[1].0] - times[w[0].0]);
            Relation::difference(w[0].0, w[1].0, target, (0.01 * target.abs()).max(1e-9))
        })
        .collect()
}

/// That the rates of neighbouring steps are alike, `(θ₂ − θ₁) / (t₂ − t₁) = (θ₁ − θ₀) / (t₁ − t₀)`,
/// in units of the mean step. Nothing where no times are known or nothing turns.
fn steady(angles: &[Option<f64>], times: &[f64]) -> Vec<Relation> {
    let known: Vec<(usize, f64, f64)> = with_angles(angles, times).collect();
    let rates = known.windows(2).map(|w| ((w[1].1 - w[0].1) / (w[1].2 - w[0].2)).abs());
    let usual = median(rates.filter(|r| r.is_finite()).collect());
    if !(usual > 0.0) {
        return Vec::new();
    }
    let mut relations = Vec::new();
    for w in known.windows(3) {
        let (before, after) = (w[1].2 - w[0].2, w[2].2 - w[1].2);
        let step = 0.5 * (before + after);
        if before > 0.0 && after > 0.0 {
            relations.push(Relation {
                frames: [w[0].0, w[1].0, w[2].0].map(|f| Some(f as u32)),
                coefficients: [step / before, -step / before - step / after, step / after],
                target: 0.0,
                sigma: RATE_CHANGE * usual * step,
            });
        }
    }
    relations
}

/// Frames that have an angle: number, angle, time.
fn with_angles(angles: &[Option<f64>], times: &[f64]) -> impl Iterator<Item = (usize, f64, f64)> {
    angles.iter().zip(times).enumerate().filter_map(|(frame, (angle, time))| Some((frame, (*angle)?, *time)))
}

/// The median step from an image to the next, radians, if most images that have a next one go round
/// evenly.
pub(crate) fn constant_rate(angles: &[Option<f64>]) -> Option<f64> {
    let steps: Vec<f64> = angles.windows(2).filter_map(|w| Some(wrap_angle(w[1]? - w[0]?))).collect();
    let rate = median(steps.clone());
    let even = steps.iter().filter(|s| (*s - rate).abs() <= EVEN * rate.abs()).count();
    let enough = steps.len() + 1 >= LEAST_OBSERVATIONS && even as f64 >= MOST * steps.len() as f64;
    (enough && rate != 0.0).then_some(rate)
}

/// That each angle is `c + i r`, as nearly as that turns out to be so for most: a table or a gantry
/// that is told where to go errs anew at each stop, it does not wander. The rate and `c` are the
/// median slope and the median intercept (Theil 1950, Sen 1968).
fn constant_step(angles: &[Option<f64>]) -> Vec<Relation> {
    let Some(rate) = constant_rate(angles) else { return Vec::new() };
    let Some(first) = angles.iter().position(Option::is_some) else { return Vec::new() };
    let start = angles[first].unwrap_or(0.0);
    // Beside the median rate; with it the angles are not wrapped round any more.
    let left: Vec<(usize, f64)> = (first + 1..angles.len())
        .filter_map(|i| Some((i, wrap_angle(angles[i]? - start - rate * (i - first) as f64))))
        .collect();
    let slopes = left.iter().enumerate().flat_map(|(k, a)| left[..k].iter().map(move |b| (a, b)));
    let more = median(slopes.map(|(a, b)| (a.1 - b.1) / (a.0 - b.0) as f64).collect());
    let beside: Vec<f64> = left.iter().map(|&(i, v)| v - more * (i - first) as f64).collect();
    let intercept = median(beside.clone());
    let deviation = median(beside.iter().map(|b| (b - intercept).abs()).collect()) / MEDIAN_DEVIATION;
    let sigma = deviation.max(LEAST_SIGMA);
    left.iter()
        .zip(&beside)
        .map(|(&(i, _), b)| {
            // As many turns on as the angle itself.
            let target = angles[i].unwrap_or(0.0) - start - wrap_angle(b - intercept);
            Relation::difference(first, i, target, sigma)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_turn_fits_whatever_its_steps_and_a_jump_of_a_step_is_two_deviations() {
        let times = [0.0, 1.0, 2.5, 3.0, 4.0, 5.0];
        let turning: Vec<Option<f64>> = times.iter().map(|t| Some(0.2 * t + 1.0)).collect();
        let off = |r: &Relation, angles: &[Option<f64>]| -> f64 {
            let sum = r.frames.iter().flatten().zip(r.coefficients);
            (sum.map(|(f, c)| c * angles[*f as usize].unwrap()).sum::<f64>() - r.target) / r.sigma
        };
        let relations = steady(&turning, &times);
        assert_eq!(relations.len(), 4);
        assert!(relations.iter().all(|r| off(r, &turning).abs() < 1e-12));
        let mut stuck = turning.clone();
        stuck[5] = stuck[4];
        assert!((off(&relations[3], &stuck).abs() - 1.0 / RATE_CHANGE).abs() < 1e-9);
        let mut some = turning.clone();
        some[1] = None;
        assert_eq!(steady(&some, &times).len(), 3);
        assert!(steady(&some, &times).iter().all(|r| off(r, &some).abs() < 1e-12));
    }

    #[test]
    fn nothing_is_believed_of_what_has_no_times_or_does_not_turn() {
        let angles = vec![Some(1.0); 5];
        assert!(steady(&angles, &[]).is_empty());
        assert!(steady(&angles, &[0.0, 1.0, 2.0, 3.0, 4.0]).is_empty());
        assert!(steady(&[None; 5], &[0.0, 1.0, 2.0, 3.0, 4.0]).is_empty());
        assert!(steady(&[Some(0.0), Some(1.0)], &[0.0, 1.0]).is_empty());
    }

    #[test]
    fn a_known_rate_follows_the_sense_of_the_turn() {
        let angles = [Some(0.0), None, Some(-0.2), Some(-0.31)];
        let relations = known_rate(&angles, &[0.0, 1.0, 2.0, 3.0], 0.1);
        assert_eq!(relations.len(), 2);
        assert!((relations[0].target + 0.2).abs() < 1e-12 && (relations[1].target + 0.1).abs() < 1e-12);
    }
}
