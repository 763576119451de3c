//! Single axis, orbit or free: the same observations, adjusted under each assumption, decide.

use super::limits::FRAMES_TO_CHOOSE;
use super::model::{AxisModel, CircularContext};
use super::orbit;
use super::problem::CircularProblem;
use crate::bundle::{
    Adjustable, BundleCovariance, BundleObservation, BundleProblem, RobustLoss, SolveOptions,
};
use crate::error::SfmError;
use crate::incremental::adjust::{Adjustment, Selected, select};
use crate::incremental::finish::OBSERVATIONS;
use crate::incremental::growth::freedom;
use crate::incremental::state::MapState;
use crate::limits::OUTLIER_SIGMAS;
use crate::model_selection::camera::{FreeIntrinsics, apply, split};
use crate::model_selection::evidence::{gain, is_motion_as_good, predicts_worse};
use crate::model_selection::noise::{error_sq, noise};
use crate::statistics::median;
use crate::triangulation::{PointView, nearest_to_rays, refine_point};
use scene::Progress;
use scene::decision::{Decision, Measurement, MotionModel, Quantity, Rule, Subject};

/// What one assumption yields on the common observations.
#[derive(Clone, Debug)]
pub(crate) struct MotionScore {
    pub motion: MotionModel,
    /// Robust cost over the noise, and what is expected of small motions, plus `k ln n`.
    pub bic: f64,
    /// Parameters of the motion k; of small motions the effective number.
    pub parameters: usize,
    /// Root mean square of the held-out error, pixels (truncated at four standard deviations).
    pub held_out_px: f64,
    /// For each pose the sum of truncated squared held-out errors in units of the noise, and their
    /// number.
    by_pose: Vec<(f64, usize)>,
}

impl MotionScore {
    /// BIC without what its parameters cost.
    pub(crate) fn cost(&self, price: f64) -> f64 {
        self.bic - self.parameters as f64 * price
    }

    /// Whether it predicts held-out observations clearly worse than another.
    pub(crate) fn predicts_worse(&self, other: &Self) -> bool {
        predicts_worse(&self.by_pose, &other.by_pose)
    }

    /// Its figures beside those of free poses.
    pub(crate) fn figures(&self, free: &Self) -> Vec<Measurement> {
        let mut scores = vec![
            Measurement::count(Quantity::MotionParameters, self.parameters),
            Measurement::new(Quantity::Bic, self.bic),
            Measurement::new(Quantity::HeldOutError, self.held_out_px),
        ];
        if self.motion != MotionModel::Free {
            let (gain, error) = gain(&free.by_pose, &self.by_pose);
            scores.push(Measurement::estimate(Quantity::HeldOutGain, gain, error));
        }
        scores
    }
}

/// All assumptions on the same observations, the simplest first; the last is the free motion.
#[derive(Clone, Debug)]
pub(crate) struct MotionComparison {
    pub verdicts: Vec<MotionScore>,
    /// Standard deviation of one residual coordinate under the free motion, pixels.
    pub sigma_px: f64,
    /// Standard deviations of an orbit's small motions: rotation (radians), translation (radii).
    pub orbit_sigma: [f64; 2],
    /// Logarithm of the evidence for an orbit against free poses.
    pub orbit_evidence: f64,
    /// Images that took part.
    pub images: usize,
    /// What a parameter costs.
    price: f64,
}

impl MotionComparison {
    /// Adjusts the observations of `base` (some model of the same images) under each assumption;
    /// one axis where there is a model about one. `None` where there are too few observations.
    pub(super) fn of(
        single: Option<&AxisModel>,
        base: &MapState,
        context: &CircularContext<'_>,
        intrinsics: FreeIntrinsics,
    ) -> Result<Option<Self>, SfmError> {
        let (turn, mut free) = problems(single, base, context, intrinsics);
        let images = free.poses.len();
        let Some((trial, of_free)) = MotionTrial::of_free(&mut free, context.progress)? else {
            return Ok(None);
        };
        let mut verdicts = Vec::new();
        if let Some(mut turn) = turn {
            verdicts.push(trial.verdict(MotionModel::SingleAxis, &mut turn, images + 2)?);
        }
        let mut comparison = Self {
            verdicts,
            sigma_px: trial.sigma,
            orbit_sigma: [0.0; 2],
            orbit_evidence: f64::NEG_INFINITY,
            images,
            price: trial.price(),
        };
        if let Some((orbit, sigma, gain)) = trial.orbit(&free)? {
            let cost = |v: &MotionScore| v.cost(trial.price());
            comparison.orbit_evidence = 0.5 * (gain - cost(&orbit) + cost(&of_free));
            comparison.orbit_sigma = sigma;
            comparison.verdicts.push(orbit);
        }
        comparison.verdicts.push(of_free);
        Ok(Some(comparison))
    }

    fn of_motion(&self, motion: MotionModel) -> Option<&MotionScore> {
        self.verdicts.iter().find(|v| v.motion == motion)
    }

    /// Whether one axis explains the observations as well as free poses do, for what these cost.
    fn pays(&self, single: &MotionScore, free: &MotionScore) -> bool {
        let cost = |v: &MotionScore| v.cost(self.price);
        let more = free.parameters.saturating_sub(single.parameters);
        is_motion_as_good(cost(single) - cost(free), more, self.price)
    }

    /// One axis where it pays against free poses and an orbit with less does not predict clearly
    /// better; else an orbit where the evidence is for one; else free. What predicts clearly worse
    /// than free poses is out.
    pub(super) fn choice(&self) -> MotionModel {
        let Some(free) = self.of_motion(MotionModel::Free) else { return MotionModel::Free };
        let orbit = self
            .of_motion(MotionModel::Orbit)
            .filter(|v| self.orbit_evidence > 0.0 && !v.predicts_worse(free));
        let single =
            self.of_motion(MotionModel::SingleAxis).filter(|v| self.pays(v, free) && !v.predicts_worse(free));
        match (single, orbit) {
            (Some(s), Some(o)) if o.bic < s.bic && s.predicts_worse(o) => MotionModel::Orbit,
            (Some(_), _) => MotionModel::SingleAxis,
            (None, Some(_)) => MotionModel::Orbit,
            (None, None) => MotionModel::Free,
        }
    }

    /// Whether one axis is the better description.
    pub(super) fn favours_single(&self) -> bool {
        self.choice() == MotionModel::SingleAxis
    }

    /// The figures as evidence for the choice.
    pub(super) fn describe(&self) -> Decision {
        let choice = self.choice();
        let free = self.of_motion(MotionModel::Free);
        let decision = Decision::new(Subject::Motion, choice, Rule::Evidence).with_all([
            Measurement::count(Quantity::Images, self.images),
            Measurement::new(Quantity::Noise, self.sigma_px),
        ]);
        self.verdicts.iter().fold(decision, |decision, verdict| {
            let mut scores = verdict.figures(free.unwrap_or(verdict));
            if verdict.motion == MotionModel::Orbit {
                let [rotation, translation] = self.orbit_sigma;
                scores.push(Measurement::new(Quantity::OrbitRotation, rotation.to_degrees()));
                scores.push(Measurement::new(Quantity::OrbitTranslation, translation));
            }
            decision.compared(verdict.motion, verdict.motion == choice, scores)
        })
    }
}

/// The effective number of deviations from a motion, `Σ σ²/(σ² + s²)` with the standard deviations
/// s to which the observations know a free pose, and by how much twice the logarithm of the
/// evidence grows because they are not free: `Σ ln (1 + 1/s²) − ln (1 + σ²/s²)`, the widths of what
/// is expected of a pose that may be anywhere within a radius and a radian, and of one near the
/// motion, over what is found (Occam factors: MacKay 1992). Rotations (radians) and translations
/// (radii), `count` coordinates of each.
pub(crate) fn occam(count: f64, sigma: [f64; 2], seen: [f64; 2]) -> (f64, f64) {
    let (mut effective, mut gain) = (0.0, 0.0);
    for (sigma, seen) in sigma.into_iter().zip(seen) {
        let s2 = seen.max(1e-12).powi(2);
        let ratio = sigma * sigma / s2;
        effective += count * ratio / (1.0 + ratio);
        gain += count * ((1.0 + 1.0 / s2).ln() - (1.0 + ratio).ln());
    }
    (effective, gain)
}

/// Median standard deviation of three coordinates of the poses, from `first` on; 0: held ones.
pub(crate) fn median_deviation(known: &BundleCovariance, first: usize) -> f64 {
    let all = known.poses.iter().flat_map(|d| d[first..first + 3].to_vec());
    median(all.filter(|d| *d > 0.0).collect())
}

/// Free poses of at most [`FRAMES_TO_CHOOSE`] images with the observations that a choice of the
/// motion is based on, and the images.
pub(crate) fn free_problem(
    base: &MapState,
    context: &CircularContext<'_>,
    intrinsics: FreeIntrinsics,
) -> (BundleProblem, Vec<usize>) {
    let mut common = base.clone();
    let (mut problem, images) = thinned(&mut common, context);
    apply(&mut problem, intrinsics, context.known);
    (problem, images)
}

/// The observations of a model's images, of which it keeps [`FRAMES_TO_CHOOSE`].
fn thinned(common: &mut MapState, context: &CircularContext<'_>) -> (BundleProblem, Vec<usize>) {
    thin(common);
    let (free, priors) = freedom(&common.cameras, context.known, context.starts, usize::MAX);
    let mut what = Adjustment::growing(free, priors);
    what.points_per_image = Some((OBSERVATIONS / common.registered_count().max(1)).clamp(50, 1000));
    let Selected { problem, images, .. } = select(common, context.input, &what);
    (problem, images)
}

/// The adjustments of one axis and of free poses over the images that both models have.
fn problems(
    single: Option<&AxisModel>,
    base: &MapState,
    context: &CircularContext<'_>,
    intrinsics: FreeIntrinsics,
) -> (Option<CircularProblem>, BundleProblem) {
    let mut common = base.clone();
    for image in 0..common.poses.len() {
        if common.poses[image].is_some() && single.is_some_and(|s| s.turn.angles[image].is_none()) {
            common.unregister(image);
        }
    }
    let (mut problem, images) = thinned(&mut common, context);
    let turn = single.map(|single| {
        let mut turning = problem.clone();
        turning.cameras.clone_from(&single.state.cameras);
        apply(&mut turning, intrinsics, context.known);
        let angles = images.iter().map(|&i| single.turn.angles[i].unwrap_or(0.0)).collect();
        let mut turn = CircularProblem::new(turning, single.turn.axis, angles);
        retriangulate(&mut turn.bundle);
        turn
    });
    apply(&mut problem, intrinsics, context.known);
    (turn, problem)
}

/// Points from their observations and the present poses.
fn retriangulate(problem: &mut BundleProblem) {
    let mut views: Vec<Vec<PointView<'_>>> = vec![Vec::new(); problem.points.len()];
    for o in &problem.observations {
        let camera = &problem.cameras[problem.pose_camera[o.pose as usize] as usize];
        views[o.point as usize].push(PointView::new(&problem.poses[o.pose as usize], camera, o.pixel));
    }
    let place =
        |views: &Vec<PointView<'_>>| nearest_to_rays(views.iter()).map(|x| refine_point(x, views.iter(), 5));
    let points: Vec<_> = views.iter().map(place).collect();
    for (x, found) in problem.points.iter_mut().zip(points) {
        *x = found.unwrap_or(*x);
    }
}

/// Leaves at most [`FRAMES_TO_CHOOSE`] of the images.
pub(crate) fn thin(state: &mut MapState) {
    let registered: Vec<usize> = (0..state.poses.len()).filter(|&i| state.poses[i].is_some()).collect();
    for image in surplus(&registered, FRAMES_TO_CHOOSE) {
        state.unregister(image);
    }
}

/// What has to go so that at most `most` are left, evenly.
fn surplus(images: &[usize], most: usize) -> Vec<usize> {
    let share = |k: usize| k * most / images.len();
    let goes = |k: &usize| images.len() > most && share(*k) == share(k - 1);
    (1..images.len()).filter(goes).map(|k| images[k]).collect()
}

/// Observations on which motions are compared.
pub(crate) struct MotionTrial<'a> {
    training: Vec<BundleObservation>,
    held_out: Vec<BundleObservation>,
    pub options: SolveOptions,
    /// Standard deviation of one residual coordinate under the free motion, pixels.
    pub sigma: f64,
    progress: &'a Progress,
}

impl<'a> MotionTrial<'a> {
    /// Adjusts free poses to most of the observations; `None` where there are too few.
    pub(crate) fn of_free(
        free: &mut BundleProblem,
        progress: &'a Progress,
    ) -> Result<Option<(Self, MotionScore)>, SfmError> {
        let (training, held_out) = split(free);
        let images = free.poses.len();
        if images < 3 || held_out.len() < 50 {
            return Ok(None);
        }
        let options = SolveOptions {
            loss: RobustLoss::Cauchy(2.0),
            max_iterations: 40,
            function_tolerance: 2e-5,
            ..SolveOptions::default()
        };
        let mut trial = Self { training, held_out, options, sigma: noise(free), progress };
        trial.adjust(free)?;
        trial.sigma = noise(free);
        let of_free = trial.verdict(MotionModel::Free, free, 6 * images - 7)?;
        Ok(Some((trial, of_free)))
    }

    pub(crate) fn adjust<P: Adjustable>(&self, problem: &mut P) -> Result<f64, SfmError> {
        let bundle = problem.bundle_mut();
        bundle.observations.clone_from(&self.training);
        bundle.observations.iter_mut().for_each(|o| o.sigma_px = self.sigma);
        let summary = problem.minimise(&self.options, self.progress)?;
        let cost = summary.final_rms.powi(2) * summary.observations as f64;
        // Observations that fell behind their camera and were left out count as outliers.
        let missing = self.training.len() - summary.observations;
        let worst = 4.0 * (1.0 + (1e4 / self.sigma / 2.0).powi(2)).ln();
        Ok(if summary.usable { cost + worst * missing as f64 } else { f64::INFINITY })
    }

    /// What a parameter costs without a prior.
    pub(crate) fn price(&self) -> f64 {
        (2.0 * self.training.len() as f64).ln()
    }

    fn verdict<P: Adjustable>(
        &self,
        motion: MotionModel,
        problem: &mut P,
        parameters: usize,
    ) -> Result<MotionScore, SfmError> {
        let bic = self.adjust(problem)? + parameters as f64 * self.price();
        Ok(self.held_out(motion, problem.bundle(), bic, parameters))
    }

    /// An orbit from adjusted free poses, the strength of its small motions, and what they gain by
    /// not being free (see [`occam`]).
    fn orbit(&self, free: &BundleProblem) -> Result<Option<(MotionScore, [f64; 2], f64)>, SfmError> {
        let Some((mut problem, misfit)) = orbit::of_free(free) else { return Ok(None) };
        if !orbit::is_near(&misfit) {
            return Ok(None);
        }
        let Some(known) = free.covariance(&self.options)? else { return Ok(None) };
        let mut cost = f64::INFINITY;
        let mut sigma = [0.0; 2];
        for _ in 0..2 {
            sigma = orbit::strengths(&problem);
            problem.offset_sigma = Some(sigma);
            cost = self.adjust(&mut problem)?;
        }
        let seen = [median_deviation(&known, 0), median_deviation(&known, 3) / problem.radius()];
        // The angle stands for one of a pose's six numbers.
        let (effective, gain) = occam(2.5 * problem.offsets.len() as f64, sigma, seen);
        let parameters = problem.angles.len() + 2 + effective.round() as usize;
        let bic = cost + parameters as f64 * self.price();
        Ok(Some((self.held_out(MotionModel::Orbit, &problem.bundle, bic, parameters), sigma, gain)))
    }

    pub(crate) fn held_out(
        &self,
        motion: MotionModel,
        bundle: &BundleProblem,
        bic: f64,
        parameters: usize,
    ) -> MotionScore {
        let mut sums = vec![(0.0, 0usize); bundle.poses.len()];
        for o in &self.held_out {
            let error = error_sq(bundle, o) / self.sigma.powi(2);
            sums[o.pose as usize].0 += error.min(OUTLIER_SIGMAS * OUTLIER_SIGMAS);
            sums[o.pose as usize].1 += 1;
        }
        let all: f64 = sums.iter().map(|s| s.0).sum::<f64>() / self.held_out.len().max(1) as f64;
        MotionScore { motion, bic, parameters, held_out_px: all.sqrt() * self.sigma, by_pose: sums }
    }
}

#[cfg(test)]
mod tests {
    use super::surplus;

    #[test]
    fn as_many_are_left_as_may_be_and_evenly() {
        for n in [0, 1, 199, 200, 201, 333, 1000] {
            let images: Vec<usize> = (0..n).map(|k| 2 * k + 1).collect();
            let gone = surplus(&images, 200);
            let left: Vec<usize> = images.iter().copied().filter(|i| !gone.contains(i)).collect();
            assert_eq!(left.len(), n.min(200), "{n} images");
            let widest = left.windows(2).map(|w| w[1] - w[0]).max().unwrap_or(0);
            assert!(widest <= 2 * n.div_ceil(200), "{n} images, a gap of {widest}");
        }
    }
}
