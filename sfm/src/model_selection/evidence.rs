//! Does the richer model pay, and is a parameter determined? The rules by which a camera model is
//! preferred to another, with all their thresholds. (What is taken where models explain different
//! matches, so that no likelihood is common to both, is another question: `accept.rs`.)
//!
//! Models are adjusted to the same observations. `BIC = C + k ln n` (Schwarz, Annals of Statistics
//! 1978) weighs the robust cost C, which stands for -2 log likelihood, against the k parameters
//! that it took. Taken as it is it believes too much: it holds residuals for independent and their
//! distribution for known, while glints, outlines and lenses err in common. So observations that
//! took no part in the adjustment have to agree: either they are predicted significantly better, or
//! the margin of BIC is far larger than the textbook asks and they are predicted no worse.
//!
//! How far a margin is to be trusted shows from the images, too: its standard deviation over them
//! (Vuong, Econometrica 1989, with images for clusters) is reported beside it. It decides nothing:
//! it cannot tell the margins that are right from those that are wrong (docs/decisions/tried.md).

use scene::decision::{Measurement, Quantity};
use std::f64::consts::LN_2;

/// Least margin of BIC for fewer parameters. A parameter that is truly nothing makes BIC less by
/// ln 2n, 9 to 10, when it goes; a tie says no more than that it is not known.
/// Source: Kass & Raftery, J. American Statistical Association 1995, section 3.2: "strong".
const SIMPLER: f64 = 6.0;
/// Least margin for more parameters where held-out observations are predicted significantly better.
/// Source: Kass & Raftery 1995: "very strong".
const PREDICTED: f64 = 10.0;
/// Least margin where they are not.
/// Source: docs/decisions/06: principal points of fox (246, right) and of case 2 (100, wrong by
/// 22 px); images of temple_ring that were rotated (208 to 491, right).
const CLEAR: f64 = 150.0;
/// Standard errors that make a gain significant.
/// Source: 2.5 % on one side of a normal distribution.
const SIGNIFICANT: f64 = 2.0;
/// A parameter is determined if its standard deviation is below this share of that beforehand.
/// Source: then its prior moves it by a ninth of what it was off, less than one standard deviation
/// for all that lies within three standard deviations of the prior.
const DETERMINED: f64 = 1.0 / 3.0;

/// Factor by which variances from followed points are too small at least: outlines and glints slide
/// along, so that one track errs in many frames together. Differences of cost count for as much
/// less.
/// Source: docs/decisions/10, on textured objects the angles themselves say 4 to 8.
pub(crate) const TRACK_EXCESS: f64 = 8.0;
/// A held-out error that is larger by less is none that anybody sees.
/// Source: derived; a fiftieth of the noise of an observation.
const NOTICEABLE: f64 = 1.02;

/// Whether BIC, which grew by so much as a prior came in, contradicts the prior: it needs no
/// evidence of its own.
pub(crate) fn contradicts_prior(growth: f64) -> bool {
    !(growth < TRACK_EXCESS * PREDICTED)
}

/// Whether a model with fewer parameters of a motion is as good as one with so many more, of which
/// each costs `price`: what followed points have in common in a frame is taken up by a free pose,
/// so that its gain counts for less.
pub(crate) fn is_motion_as_good(gain: f64, more: usize, price: f64) -> bool {
    gain / TRACK_EXCESS < more as f64 * price
}

/// Whether a model predicts held-out observations clearly worse than another: for each image the
/// sum of squared errors in units of the noise, and their number.
pub(crate) fn predicts_worse(model: &[(f64, usize)], other: &[(f64, usize)]) -> bool {
    let (gain, error) = gain(model, other);
    let all = |held_out: &[(f64, usize)]| held_out.iter().map(|h| h.0).sum::<f64>();
    let count = model.iter().map(|h| h.1).sum::<usize>() as f64;
    // Errors far below the noise are all alike.
    gain > SIGNIFICANT * error && all(model) > NOTICEABLE * NOTICEABLE * all(other).max(count)
}

/// Whether observations determine a parameter: `deviation`, its standard deviation for independent
/// observations; `inflation`, by how much that is too small, as observations err together;
/// `prior`, its standard deviation beforehand.
pub(crate) fn is_determined(deviation: f64, inflation: f64, prior: f64) -> bool {
    deviation * inflation < DETERMINED * prior
}

/// What it costs to say for each of so many images to which of two groups it belongs, in BIC: a bit
/// an image.
pub(crate) fn cost_of_groups(images: usize) -> f64 {
    2.0 * LN_2 * images as f64
}

/// Whether two groups of images that make BIC so much less are worth an adjustment of their own:
/// whether they might be preferred then.
pub(crate) fn may_be_two_groups(gain: f64, images: usize) -> bool {
    gain > CLEAR + cost_of_groups(images)
}

/// How well an adjusted model does.
#[derive(Clone, Debug, Default)]
pub(crate) struct Score {
    /// Cost of all observations and priors plus `k ln n`; not finite where the adjustment failed.
    pub bic: f64,
    /// For each image the cost of its observations that took part.
    pub cost: Vec<f64>,
    /// For each image the sum of truncated squared errors of its held-out observations, in units of
    /// the noise, and their number.
    pub held_out: Vec<(f64, usize)>,
}

/// How much better one model does than another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Comparison {
    /// By how much BIC is lower.
    pub margin: f64,
    /// Standard deviation of that.
    pub deviation: f64,
    /// Mean decrease of the squared error of a held-out observation, in units of the noise.
    pub gain: f64,
    /// Standard error of that.
    pub error: f64,
}

impl Comparison {
    /// Of `other` against `model`, two adjustments of the same observations.
    pub(crate) fn new(other: &Score, model: &Score) -> Self {
        let differences: Vec<f64> = model.cost.iter().zip(&other.cost).map(|(m, o)| m - o).collect();
        let (gain, error) = gain(&model.held_out, &other.held_out);
        let deviation = deviation_of_sum(&differences);
        Self { margin: model.bic - other.bic, deviation, gain, error }
    }

    /// Whether the other model, which has more parameters, is to be preferred.
    pub(crate) fn prefers_richer(&self) -> bool {
        let asked = if self.gain > SIGNIFICANT * self.error { PREDICTED } else { CLEAR };
        self.is_not_contradicted() && self.margin > asked
    }

    /// Whether the other model, which has fewer parameters, is to be preferred.
    pub(crate) fn prefers_simpler(&self) -> bool {
        self.is_not_contradicted() && self.margin > SIMPLER
    }

    /// Whether held-out observations are predicted no worse, as far as their number tells.
    fn is_not_contradicted(&self) -> bool {
        self.gain > -self.error
    }

    /// The numbers that decide.
    pub(crate) fn measurements(&self) -> [Measurement; 2] {
        [
            Measurement::estimate(Quantity::BicMargin, self.margin, self.deviation),
            Measurement::estimate(Quantity::HeldOutGain, self.gain, self.error),
        ]
    }
}

/// Mean decrease of the error of an observation from `old` to `new`, and its standard error: the
/// observations of an image are not independent of each other, those of different images are.
pub(crate) fn gain(old: &[(f64, usize)], new: &[(f64, usize)]) -> (f64, f64) {
    let all = old.iter().map(|o| o.1).sum::<usize>().max(1) as f64;
    let mean = old.iter().zip(new).map(|(o, n)| o.0 - n.0).sum::<f64>() / all;
    let excess = old.iter().zip(new).map(|(o, n)| (o.0 - n.0 - mean * o.1 as f64).powi(2));
    (mean, excess.sum::<f64>().sqrt() / all)
}

/// Standard deviation of a sum of independent terms, from the terms.
fn deviation_of_sum(terms: &[f64]) -> f64 {
    let n = terms.len() as f64;
    let mean = terms.iter().sum::<f64>() / n.max(1.0);
    let squares: f64 = terms.iter().map(|t| (t - mean).powi(2)).sum();
    (squares * n / (n - 1.0).max(1.0)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A comparison with these numbers.
    fn found(margin: f64, gain: f64, error: f64) -> Comparison {
        Comparison { margin, deviation: 0.0, gain, error }
    }

    #[test]
    fn more_parameters_need_a_significant_gain_or_a_clear_margin() {
        assert!(found(11.0, 0.5, 0.2).prefers_richer());
        assert!(!found(11.0, 0.3, 0.2).prefers_richer());
        assert!(found(151.0, 0.1, 0.2).prefers_richer());
        assert!(found(151.0, -0.1, 0.2).prefers_richer(), "what is held out says nothing");
        assert!(!found(1000.0, -0.3, 0.2).prefers_richer(), "what is held out speaks against it");
        assert!(!found(9.0, 1.0, 0.1).prefers_richer());
    }

    #[test]
    fn fewer_parameters_need_strong_evidence_and_no_loss() {
        assert!(found(7.0, 0.0, 0.1).prefers_simpler());
        assert!(!found(5.0, 0.1, 0.1).prefers_simpler());
        assert!(!found(7.0, -0.2, 0.1).prefers_simpler());
    }

    #[test]
    fn a_parameter_is_determined_where_little_of_its_prior_is_left_for_all_that_errs_together() {
        assert!(is_determined(0.3, 1.0, 1.0) && !is_determined(0.35, 1.0, 1.0));
        assert!(!is_determined(0.3, 1.2, 1.0));
        assert!(!is_determined(f64::NAN, 1.0, 1.0) && !is_determined(f64::INFINITY, 1.0, 1.0));
    }

    #[test]
    fn numbers_that_are_none_prefer_nothing() {
        for margin in [f64::NAN, f64::NEG_INFINITY] {
            let c = found(margin, 1.0, 0.1);
            assert!(!c.prefers_richer() && !c.prefers_simpler(), "{margin}");
        }
        let equal = Comparison::new(&Score::default(), &Score::default());
        assert!(!equal.prefers_richer() && !equal.prefers_simpler());
    }

    #[test]
    fn a_margin_that_all_images_share_is_certain_and_one_of_a_single_image_is_not() {
        let score = |cost: &[f64]| Score { bic: cost.iter().sum(), cost: cost.to_vec(), held_out: vec![] };
        let old = score(&[10.0; 4]);
        let even = Comparison::new(&score(&[5.0; 4]), &old);
        let single = Comparison::new(&score(&[10.0, 10.0, 10.0, -10.0]), &old);
        assert_eq!((even.margin, even.deviation), (20.0, 0.0));
        assert_eq!((single.margin, single.deviation), (20.0, 20.0));
    }
}
