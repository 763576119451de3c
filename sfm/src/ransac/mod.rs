//! One locally optimised RANSAC loop for every model.

mod absolute_pose;
mod essential;
mod fundamental;
mod homography;

pub(crate) use absolute_pose::estimate_absolute_pose;
pub(crate) use essential::{EssentialEstimator, EssentialModel};
pub(crate) use fundamental::FundamentalEstimator;
pub(crate) use homography::HomographyEstimator;

use rand::Rng as _;
use scene::rng::rng;

/// A model that can be found from a minimal sample, scored and refined.
pub(crate) trait Estimator {
    /// What is estimated.
    type Model: Clone;
    /// Data that a minimal sample holds.
    fn sample_size(&self) -> usize;
    /// Data in all.
    fn num_data(&self) -> usize;
    /// Appends the models that fit the sample (`sample_size` different indices); none is an answer.
    fn solve(&self, sample: &[usize], models: &mut Vec<Self::Model>);
    /// Squared residual of a datum, in the unit of the threshold squared; not NaN.
    fn residual_sq(&self, model: &Self::Model, i: usize) -> f64;
    /// A better model from its inliers, if there is one.
    fn refine(&self, model: &Self::Model, inliers: &[usize]) -> Option<Self::Model>;
}

/// How long to search, and what counts as an inlier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RansacConfig {
    /// Largest residual of an inlier, in the estimator's unit.
    pub threshold: f64,
    /// Probability with which at least one sample without outliers shall have been drawn.
    pub confidence: f64,
    /// Samples drawn at least.
    pub min_iterations: usize,
    /// Samples drawn at most.
    pub max_iterations: usize,
    /// A model with fewer inliers is none. It also bounds the search: a model with as many inliers
    /// is found with the given confidence, and smaller ones are not waited for.
    pub min_inliers: usize,
    /// The user's seed.
    pub seed: u64,
    /// Whether the data are sorted, the most trustworthy first. Every other sample is then drawn
    /// from a growing head of the list (after PROSAC: Chum & Matas, CVPR 2005), the rest from all
    /// data.
    pub best_first: bool,
}

impl Default for RansacConfig {
    fn default() -> Self {
        Self {
            threshold: 4.0,
            confidence: 0.9999,
            min_iterations: 30,
            max_iterations: 5000,
            min_inliers: 8,
            seed: 0,
            best_first: false,
        }
    }
}

/// The best model found.
#[derive(Clone, Debug)]
pub(crate) struct RansacResult<M> {
    /// The model, refined on its inliers.
    pub model: M,
    /// Data within the threshold, ascending.
    pub inliers: Vec<usize>,
    /// Truncated quadratic cost `Σ min(r², T²)` over all data.
    pub score: f64,
}

/// Finds the model of least truncated quadratic cost (MSAC: Torr & Zisserman 2000): random minimal
/// samples, each new best refined on its inliers while that helps (LO-RANSAC: Chum, Matas & Kittler
/// 2003), stop when enough samples have been drawn for the inlier ratio found. Candidates that
/// exceed the best cost are dropped half-way, and so are those that a sequential test finds
/// unlikely to reach it ([`SequentialTest`]). The result depends on the data, the configuration and
/// `stream_index` only. `None` if no model has `min_inliers`.
pub(crate) fn ransac<E: Estimator>(
    estimator: &E,
    config: &RansacConfig,
    stream_index: u64,
) -> Option<RansacResult<E::Model>> {
    let (n, k) = (estimator.num_data(), estimator.sample_size());
    if n < k.max(config.min_inliers) || config.threshold.is_nan() || config.threshold <= 0.0 {
        return None;
    }
    let mut random = rng(config.seed, "ransac", stream_index);
    let mut search = RansacSearch::new(estimator, config, n);
    let hopeless = needed_samples(config.min_inliers.max(k) as f64 / n as f64, k, config.confidence);
    let mut limit = config.max_iterations.min(hopeless.max(config.min_iterations));
    let mut sample = vec![0; k];
    let mut models = Vec::with_capacity(10);
    let mut iterations = 0;
    while iterations < limit {
        iterations += 1;
        let head = if config.best_first && iterations % 2 == 1 { growing_head(iterations, k, n) } else { n };
        draw(&mut random, head, &mut sample);
        models.clear();
        estimator.solve(&sample, &mut models);
        let mut improved = false;
        for model in &models {
            improved |= search.consider(model);
        }
        if improved {
            search.optimise(4);
            let ratio = search.inliers.len() as f64 / n as f64;
            let needed = needed_samples(ratio, k, config.confidence);
            limit = limit.min(needed.max(config.min_iterations));
        }
    }
    search.optimise(10);
    let (model, mut inliers) = (search.best?, search.inliers);
    inliers.sort_unstable();
    (inliers.len() >= config.min_inliers).then_some(RansacResult { model, inliers, score: search.score })
}

/// Samples after which one without outliers has been drawn with the given confidence.
fn needed_samples(inlier_ratio: f64, sample_size: usize, confidence: f64) -> usize {
    let good = inlier_ratio.clamp(0.0, 1.0).powi(sample_size as i32);
    if good >= 1.0 {
        return 1;
    }
    // A float beyond the range of usize becomes its largest value.
    ((1.0 - confidence).max(1e-12).ln() / (-good).ln_1p()).ceil() as usize
}

/// How many of the most trustworthy data are drawn from: twice a sample at first, all after 500
/// samples.
fn growing_head(iteration: usize, sample_size: usize, n: usize) -> usize {
    /// Source: judgement, in place of the growth function of PROSAC (Chum & Matas, CVPR 2005).
    const ALL_AFTER: usize = 500;
    let first = (2 * sample_size).min(n);
    (first + (n - first) * iteration / ALL_AFTER).min(n)
}

/// Fills `sample` with different indices below `n`.
fn draw(random: &mut scene::rng::Rng, n: usize, sample: &mut [usize]) {
    for i in 0..sample.len() {
        sample[i] = loop {
            let candidate = random.random_range(0..n);
            if !sample[..i].contains(&candidate) {
                break candidate;
            }
        };
    }
}

/// Wald's sequential probability ratio test (Chum & Matas, PAMI 2008): the logarithm of how much
/// likelier a datum is under a wrong model than under one with as many inliers as the best.
struct SequentialTest {
    /// Data in all.
    count: f64,
    /// Share of inliers of the best model; before there is one, of the poorest that is a model.
    good: f64,
    /// Inliers of rejected models, and the data they were compared with.
    wrong: [f64; 2],
    /// Logarithm that an inlier adds.
    inlier: f64,
    /// Logarithm that an outlier adds.
    outlier: f64,
    /// From here on a model is rejected: one that is as good as the best is, with no greater
    /// probability than that with which the search may miss it in any case.
    most: f64,
}

impl SequentialTest {
    /// Inliers and data that stand for wrong models until some were seen: it takes longer where
    /// they are off, and errs no more often. Source: Chum & Matas, PAMI 2008 (0.05 at first).
    const WRONG_AT_FIRST: [f64; 2] = [1.0, 20.0];

    fn new(config: &RansacConfig, count: usize) -> Self {
        let most = -(1.0 - config.confidence).max(1e-12).ln();
        let (count, wrong) = (count as f64, Self::WRONG_AT_FIRST);
        let mut test = Self { count, good: 0.0, wrong, inlier: 0.0, outlier: 0.0, most };
        test.note_best(config.min_inliers);
        test
    }

    /// Half a datum short of all, so that an outlier never adds an infinity.
    fn note_best(&mut self, inliers: usize) {
        self.good = (inliers as f64).min(self.count - 0.5) / self.count;
        self.update();
    }

    fn note_rejected(&mut self, inliers: usize, looked: usize) {
        self.wrong[0] += inliers as f64;
        self.wrong[1] += looked as f64;
        self.update();
    }

    /// Where wrong models have as many inliers as the best one nothing is told apart.
    fn update(&mut self) {
        let (good, wrong) = (self.good, self.wrong[0] / self.wrong[1]);
        let apart = wrong < good;
        self.inlier = if apart { (wrong / good).ln() } else { 0.0 };
        self.outlier = if apart { ((1.0 - wrong) / (1.0 - good)).ln() } else { 0.0 };
    }
}

struct RansacSearch<'a, E: Estimator> {
    estimator: &'a E,
    limit_sq: f64,
    /// A fixed pseudo-random order of the data, so that dropping half-way sees a fair mixture.
    order: Vec<usize>,
    best: Option<E::Model>,
    score: f64,
    inliers: Vec<usize>,
    scratch: Vec<usize>,
    test: SequentialTest,
}

impl<'a, E: Estimator> RansacSearch<'a, E> {
    fn new(estimator: &'a E, config: &RansacConfig, n: usize) -> Self {
        let mut random = rng(0, "ransac order", n as u64);
        let mut order: Vec<usize> = (0..n).collect();
        for i in (1..n).rev() {
            order.swap(i, random.random_range(0..=i));
        }
        let limit_sq = config.threshold * config.threshold;
        let (inliers, scratch) = (Vec::with_capacity(n), Vec::with_capacity(n));
        // A model in which nothing is an inlier is no model.
        let score = limit_sq * n as f64;
        let test = SequentialTest::new(config, n);
        Self { estimator, limit_sq, order, best: None, score, inliers, scratch, test }
    }

    /// Takes the model as the best if it is; its inliers are then in `inliers`.
    fn consider(&mut self, model: &E::Model) -> bool {
        self.scratch.clear();
        let (mut cost, mut doubt) = (0.0, 0.0);
        for (looked, &i) in self.order.iter().enumerate() {
            let r = self.estimator.residual_sq(model, i);
            if r < self.limit_sq {
                cost += r;
                doubt += self.test.inlier;
                self.scratch.push(i);
            } else {
                cost += self.limit_sq;
                doubt += self.test.outlier;
            }
            if cost >= self.score {
                return false;
            }
            if doubt > self.test.most {
                self.test.note_rejected(self.scratch.len(), looked + 1);
                return false;
            }
        }
        self.score = cost;
        self.best = Some(model.clone());
        std::mem::swap(&mut self.inliers, &mut self.scratch);
        self.test.note_best(self.inliers.len());
        true
    }

    /// Refines the best model on its inliers while the cost falls, `rounds` times at most.
    fn optimise(&mut self, rounds: usize) {
        for _ in 0..rounds {
            let before = self.score;
            let Some(best) = &self.best else { return };
            let Some(refined) = self.estimator.refine(best, &self.inliers) else { return };
            if !self.consider(&refined) || self.score > before * (1.0 - 1e-4) {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests;
