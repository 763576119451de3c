//! Does the richer model pay? The one rule by which a model is preferred to another, with all its thresholds.
//!
//! Models are adjusted to the same observations. `BIC = C + k ln n` (Schwarz, Annals of Statistics 1978) weighs the robust cost
//! C, which stands for -2 log likelihood, against the k parameters that it took. Taken as it is it believes too much: it
//! holds residuals for independent and their distribution for known, while glints, outlines and lenses err in common. How far the
//! difference of two costs is to be trusted is seen from the images, whose differences would all be alike if it meant
//! something: its standard deviation over them is Vuong's (Econometrica 1989), with images for clusters (Cameron & Miller, Journal of
//! Human Resources 2015). So a model is preferred where its BIC is lower by strong evidence and by more than the difference
//! may be off, and where observations that took no part in the adjustment do not speak against it.

use scene::decision::{Measurement, Quantity};

/// Least difference of BIC. Source: Kass & Raftery, J. American Statistical Association 1995, table in section 3.2: "strong".
const STRONG: f64 = 6.0;
/// Standard deviations by which a difference has to exceed zero. Source: two, the usual 2.5 % on one side of a normal distribution.
const SIGNIFICANT: f64 = 2.0;

/// How well an adjusted model does.
#[derive(Clone, Debug, Default)]
pub(crate) struct Score {
    /// Cost of all observations and priors plus `k ln n`; not finite where the adjustment failed.
    pub bic: f64,
    /// For each image the cost of its observations that took part.
    pub cost: Vec<f64>,
    /// For each image the sum of truncated squared errors of its held-out observations, in units of the noise, and their
    /// number.
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
    pub fn new(other: &Score, model: &Score) -> Self {
        let differences: Vec<f64> = model.cost.iter().zip(&other.cost).map(|(m, o)| m - o).collect();
        let (gain, error) = gain(&model.held_out, &other.held_out);
        let deviation = deviation_of_sum(&centred(&differences));
        Self { margin: model.bic - other.bic, deviation, gain, error }
    }

    /// Whether the other model is to be preferred.
    pub fn is_preferred(&self) -> bool {
        self.margin > STRONG
            && self.significance() > SIGNIFICANT
            && self.gain > -SIGNIFICANT * self.error.max(f64::MIN_POSITIVE)
    }

    /// The numbers that decide.
    pub fn measurements(&self) -> [Measurement; 3] {
        [
            Measurement::estimate(Quantity::BicMargin, self.margin, self.deviation),
            Measurement::estimate(Quantity::HeldOutGain, self.gain, self.error),
            Measurement::new(Quantity::Significance, self.significance()),
        ]
    }

    /// Both differences together, in standard deviations (Stouffer et al. 1949).
    pub fn significance(&self) -> f64 {
        let in_deviations = |value: f64, deviation: f64| value / deviation.max(f64::MIN_POSITIVE);
        (in_deviations(self.margin, self.deviation) + in_deviations(self.gain, self.error))
            / std::f64::consts::SQRT_2
    }
}

/// Mean decrease of the error of an observation from `old` to `new`, and its standard error.
pub(crate) fn gain(old: &[(f64, usize)], new: &[(f64, usize)]) -> (f64, f64) {
    let all = old.iter().map(|o| o.1).sum::<usize>().max(1) as f64;
    let mean = old.iter().zip(new).map(|(o, n)| o.0 - n.0).sum::<f64>() / all;
    let excess: Vec<f64> = old.iter().zip(new).map(|(o, n)| o.0 - n.0 - mean * o.1 as f64).collect();
    (mean, deviation_of_sum(&excess) / all)
}

fn centred(values: &[f64]) -> Vec<f64> {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    values.iter().map(|v| v - mean).collect()
}

/// Standard deviation of a sum of terms of mean zero, one an image in the order of the images, of which near ones may be
/// correlated: what slides over an object is seen by neighbours alike (Newey & West, Econometrica 1987, with Bartlett's
/// weights; lags as by Newey & West, Review of Economic Studies 1994).
fn deviation_of_sum(terms: &[f64]) -> f64 {
    let n = terms.len();
    let lags = (4.0 * (n as f64 / 100.0).powf(2.0 / 9.0)) as usize;
    let at = |lag: usize| terms.iter().zip(&terms[lag.min(n)..]).map(|(a, b)| a * b).sum::<f64>();
    let weight = |lag: usize| 1.0 - lag as f64 / (lags + 1) as f64;
    let variance = at(0) + (1..=lags).map(|lag| 2.0 * weight(lag) * at(lag)).sum::<f64>();
    variance.max(at(0)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;
    use scene::rng::rng;

    /// Scores of two models over so many images: the second costs each image `better` less, and what neighbouring images
    /// have in common adds `wandering`.
    fn scores(seed: u64, images: usize, better: f64, wandering: f64) -> [Score; 2] {
        let mut r = rng(seed, "evidence", 0);
        let mut drift = 0.0;
        let mut terms: Vec<f64> = Vec::new();
        for _ in 0..images {
            drift = 0.8 * drift + wandering * r.random_range(-1.0..1.0);
            terms.push(better + drift + 10.0 * r.random_range(-1.0..1.0));
        }
        let total: f64 = terms.iter().sum();
        let score = |bic: f64, cost: Vec<f64>, gain: f64| Score {
            bic,
            held_out: cost.iter().map(|c| (50.0 - gain * c, 50)).collect(),
            cost,
        };
        let simple = score(1000.0, vec![0.0; images], 0.0);
        let rich = score(1000.0 - total, terms.iter().map(|t| -t).collect(), -0.1);
        [rich, simple]
    }

    #[test]
    fn a_model_that_is_better_in_every_image_is_preferred_and_its_rival_is_not() {
        for seed in 0..100 {
            let [rich, simple] = scores(seed, 30, 12.0, 0.0);
            assert!(Comparison::new(&rich, &simple).is_preferred(), "seed {seed}");
            assert!(!Comparison::new(&simple, &rich).is_preferred(), "seed {seed}");
        }
    }

    #[test]
    fn what_neighbouring_images_have_in_common_is_rarely_taken_for_evidence() {
        for wandering in [0.0, 20.0] {
            let taken = |seed: &u64| {
                let [rich, simple] = scores(*seed, 40, 0.0, wandering);
                Comparison::new(&rich, &simple).is_preferred()
            };
            let wrong = (0..500).filter(taken).count();
            assert!(wrong < 75, "{wrong} of 500 with wandering {wandering}");
        }
    }

    #[test]
    fn a_failed_adjustment_an_equal_model_and_no_images_are_not_preferred() {
        let [rich, simple] = scores(1, 30, 12.0, 0.0);
        assert!(!Comparison::new(&Score { bic: f64::INFINITY, ..rich.clone() }, &simple).is_preferred());
        assert!(!Comparison::new(&simple, &simple).is_preferred());
        assert!(!Comparison::new(&Score::default(), &Score::default()).is_preferred());
        // An undefined BIC is no reason either.
        assert!(!Comparison::new(&Score { bic: f64::NAN, ..rich }, &simple).is_preferred());
    }
}
