//! Single axis or free: the same sightings, adjusted under both assumptions, decide.

use super::model::{AxisModel, Context};
use super::problem::TurnProblem;
use crate::SfmError;
use crate::bundle::{Adjustable, BundleObservation, BundleProblem, Loss, SolveOptions};
use crate::incremental::adjust::{Adjustment, Selected, select};
use crate::incremental::growth::freedom;
use crate::incremental::state::State;
use crate::selection::{Intrinsics, apply, error_sq, gain, noise, split};
use crate::triangulation::{View, nearest_to_rays, refine_point};
use scene::Progress;

/// Sightings that the choice is based on.
const SIGHTINGS: usize = 6000;
/// Residuals beyond so many standard deviations count as this much.
const TRUNCATION: f64 = 4.0;

/// What one assumption yields on the common sightings.
#[derive(Clone, Debug)]
pub(crate) struct Verdict {
    /// Robust cost over the noise plus `k ln n`.
    pub bic: f64,
    /// Parameters of the motion.
    pub parameters: usize,
    /// Root mean square of the held-out error, pixels (truncated at four standard deviations).
    pub held_out_px: f64,
    /// For each pose the sum of truncated squared held-out errors in units of the noise, and their number.
    by_pose: Vec<(f64, usize)>,
}

/// Both assumptions on the same sightings.
#[derive(Clone, Debug)]
pub(crate) struct Comparison {
    /// One axis.
    pub single: Verdict,
    /// Six numbers a frame.
    pub free: Verdict,
    /// Standard deviation of one residual coordinate under the free motion, pixels.
    pub sigma_px: f64,
    /// Decrease of the held-out squared error, in units of the noise, that the free motion brings; its standard error.
    pub gain: (f64, f64),
    /// Images that took part.
    pub images: usize,
}

impl Comparison {
    /// Adjusts the sightings of `base` (some model of the same images; the turn's own where there is none) under both
    /// assumptions. `None` where there are too few.
    pub fn of(
        single: &AxisModel,
        base: Option<&State>,
        context: &Context<'_>,
        intrinsics: Intrinsics,
    ) -> Result<Option<Self>, SfmError> {
        let (turn, free) = pair(single, base.unwrap_or(&single.state), context, intrinsics);
        let (training, held_out) = split(&free);
        let images = free.poses.len();
        if images < 3 || held_out.len() < 50 {
            return Ok(None);
        }
        let options = SolveOptions {
            loss: Loss::Cauchy(2.0),
            max_iterations: 40,
            function_tolerance: 1e-7,
            ..SolveOptions::default()
        };
        let mut trial =
            Trial { training, held_out, options, sigma: noise(&free), progress: context.progress };
        let mut free = free;
        trial.adjust(&mut free)?;
        trial.sigma = noise(&free);
        let free = trial.verdict(&mut free, 6 * images - 7)?;
        let mut turn = turn;
        trial.adjust(&mut turn)?;
        let single = trial.verdict(&mut turn, images + 2)?;
        let gain = gain(&single.by_pose, &free.by_pose);
        Ok(Some(Self { single, free, sigma_px: trial.sigma, gain, images }))
    }

    /// Whether one axis is the better description.
    pub fn favours_single(&self) -> bool {
        self.single.bic < self.free.bic
    }

    /// The figures.
    pub fn describe(&self) -> String {
        let line = |name: &str, v: &Verdict| {
            format!(
                "{name}: {} parameters of motion, BIC {:.0}, held out {:.3} px",
                v.parameters, v.bic, v.held_out_px
            )
        };
        format!(
            "{} images, noise {:.3} px; {}; {} (held-out gain of free {:.3} ± {:.3})",
            self.images,
            self.sigma_px,
            line("single axis", &self.single),
            line("free", &self.free),
            self.gain.0,
            self.gain.1
        )
    }
}

/// The adjustments of both assumptions over the images that both models have.
fn pair(
    single: &AxisModel,
    base: &State,
    context: &Context<'_>,
    intrinsics: Intrinsics,
) -> (TurnProblem, BundleProblem) {
    let mut common = base.clone();
    for image in 0..common.poses.len() {
        if common.poses[image].is_some() && single.turn.angles[image].is_none() {
            common.unregister(image);
        }
    }
    let (free, priors) = freedom(&common.cameras, context.known, context.starts, usize::MAX);
    let mut what = Adjustment::growing(free, priors);
    what.points_per_image = Some((SIGHTINGS / common.registered().max(1)).clamp(50, 1000));
    let Selected { mut problem, images, .. } = select(&common, context.input, &what);
    let fixed: Vec<bool> = context.known.iter().map(|k| k.fixed).collect();
    let mut turning = problem.clone();
    turning.cameras.clone_from(&single.state.cameras);
    apply(&mut problem, intrinsics, &fixed);
    apply(&mut turning, intrinsics, &fixed);
    let angles = images.iter().map(|&i| single.turn.angles[i].unwrap_or(0.0)).collect();
    let mut turn = TurnProblem::new(turning, single.turn.axis, angles);
    retriangulate(&mut turn.bundle);
    (turn, problem)
}

/// Points from their sightings and the present poses.
fn retriangulate(problem: &mut BundleProblem) {
    let mut views: Vec<Vec<View<'_>>> = vec![Vec::new(); problem.points.len()];
    for o in &problem.observations {
        let camera = &problem.cameras[problem.pose_camera[o.pose as usize] as usize];
        views[o.point as usize].push(View::new(&problem.poses[o.pose as usize], camera, o.pixel));
    }
    let place =
        |views: &Vec<View<'_>>| nearest_to_rays(views.iter()).map(|x| refine_point(x, views.iter(), 5));
    let points: Vec<_> = views.iter().map(place).collect();
    for (x, found) in problem.points.iter_mut().zip(points) {
        *x = found.unwrap_or(*x);
    }
}

struct Trial<'a> {
    training: Vec<BundleObservation>,
    held_out: Vec<BundleObservation>,
    options: SolveOptions,
    sigma: f64,
    progress: &'a Progress,
}

impl Trial<'_> {
    fn adjust<P: Adjustable>(&self, problem: &mut P) -> Result<f64, SfmError> {
        let bundle = problem.bundle_mut();
        bundle.observations.clone_from(&self.training);
        bundle.observations.iter_mut().for_each(|o| o.sigma_px = self.sigma);
        let summary = problem.minimise(&self.options, self.progress)?;
        let cost = summary.final_rms.powi(2) * summary.observations as f64;
        // Sightings that fell behind their camera and were left out count as outliers.
        let missing = self.training.len() - summary.observations;
        let worst = 4.0 * (1.0 + (1e4 / self.sigma / 2.0).powi(2)).ln();
        Ok(if summary.usable { cost + worst * missing as f64 } else { f64::INFINITY })
    }

    fn verdict<P: Adjustable>(&self, problem: &mut P, parameters: usize) -> Result<Verdict, SfmError> {
        let cost = self.adjust(problem)?;
        let bic = cost + parameters as f64 * (2.0 * self.training.len() as f64).ln();
        let bundle = problem.bundle();
        let mut sums = vec![(0.0, 0usize); bundle.poses.len()];
        for o in &self.held_out {
            let error = error_sq(bundle, o) / self.sigma.powi(2);
            sums[o.pose as usize].0 += error.min(TRUNCATION * TRUNCATION);
            sums[o.pose as usize].1 += 1;
        }
        let all: f64 = sums.iter().map(|s| s.0).sum::<f64>() / self.held_out.len().max(1) as f64;
        Ok(Verdict { bic, parameters, held_out_px: all.sqrt() * self.sigma, by_pose: sums })
    }
}
