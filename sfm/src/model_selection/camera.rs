//! The evidence decides the camera model: observations that took no part in the adjustment, and BIC.
//!
//! Candidates are compared on the same observations: each is adjusted without the held-out ones, which then say how well
//! it predicts (paired by image), while BIC (Schwarz 1978) on the robust cost over the measured noise says whether the
//! parameters pay for themselves. Both must agree, and the normal equations must determine what was freed.

use super::evidence::{Comparison, Score};
use super::noise::{TRUNCATION, error_sq};
use crate::bundle::{
    BundleObservation, BundleProblem, IntrinsicsPrior, RobustLoss, SolveOptions, free_parameters,
};
use crate::{Knowledge, SfmError};
use scene::decision::{Alternative, Choice, Decision, Measurement, PrincipalPoint, Quantity, Rule, Subject};
use scene::{Camera, CameraModel, Progress};

/// Standard deviation of a principal point from the image centre, in longer image sides (lenses and crops of real
/// cameras).
pub(crate) const PRINCIPAL_POINT_SIGMA: f64 = 0.03;
/// Standard deviation of radial distortion half the longer image side from the centre, as a share of that distance: 0.05 for
/// lenses that are not fisheyes, less by the root of 8, since observations err together and their variances come out that much too
/// small (`single_axis/smoothness.rs`).
const DISTORTION_SIGMA: f64 = 0.018;
/// Largest standard deviation of a focal length that counts as determined, as a share of it.
const DETERMINED_FOCAL: f64 = 0.02;
/// Largest standard deviation of a principal point that counts as determined, in longer image sides.
const DETERMINED_POINT: f64 = 0.01;
/// Scale of the robust loss, standard deviations. Source: the usual 2.385 for 95 % efficiency (Holland & Welsch 1977), rounded
/// down for the many wrong matches.
const LOSS: f64 = 2.0;

/// What is solved for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FreeIntrinsics {
    /// Camera model.
    pub model: CameraModel,
    /// Whether the principal point is free.
    pub principal_point: bool,
    /// The coordinate of it (0: x, 1: y) that is held all the same.
    pub held: Option<usize>,
}

impl FreeIntrinsics {
    /// As a choice in a decision.
    pub(crate) fn choice(self) -> Choice {
        let principal_point = match (self.principal_point, self.held) {
            (false, _) => PrincipalPoint::Centre,
            (true, None) => PrincipalPoint::Free,
            (true, Some(0)) => PrincipalPoint::FreeY,
            (true, Some(_)) => PrincipalPoint::FreeX,
        };
        Choice::Camera { model: Some(self.model), principal_point }
    }

    /// Free parameters of one camera.
    pub(crate) fn free(self, camera: &Camera) -> Vec<bool> {
        let mut free = free_parameters(camera, true, self.principal_point, true);
        if let Some(k) = self.held {
            free[camera.model.num_focals() + k] = false;
        }
        free
    }
}

/// The camera in another model: shared parameters are taken over, new ones are zero; two focal lengths become their
/// mean.
pub(crate) fn convert_camera(camera: &Camera, model: CameraModel) -> Camera {
    let mut params = match (camera.model.num_focals(), model.num_focals()) {
        (2, 2) => camera.params[..2].to_vec(),
        (_, n) => vec![camera.mean_focal(); n],
    };
    params.extend(camera.principal_point().to_array());
    let distortion = camera.distortion().iter().copied();
    params.extend(distortion.take(model.num_params() - params.len()));
    params.resize(model.num_params(), 0.0);
    Camera { model, params, ..camera.clone() }
}

/// The prior of a free principal point.
pub(crate) fn principal_point_priors(index: usize, camera: &Camera) -> [IntrinsicsPrior; 2] {
    let (w, h) = (f64::from(camera.width), f64::from(camera.height));
    let prior = |k: usize, mean: f64| IntrinsicsPrior {
        camera: index,
        parameter: camera.model.num_focals() + k,
        mean,
        sigma: PRINCIPAL_POINT_SIGMA * w.max(h),
    };
    [prior(0, w / 2.0), prior(1, h / 2.0)]
}

/// The priors of radial distortion: what each term does half an image side from the centre.
fn distortion_priors(index: usize, camera: &Camera) -> impl Iterator<Item = IntrinsicsPrior> + use<> {
    let first = camera.model.num_focals() + 2;
    let terms = camera.distortion().len().min(2);
    let side = f64::from(camera.width.max(camera.height));
    let shrink = (2.0 * camera.mean_focal() / side).powi(2);
    (0..terms).map(move |k| IntrinsicsPrior {
        camera: index,
        parameter: first + k,
        mean: 0.0,
        sigma: DISTORTION_SIGMA * shrink.powi(k as i32 + 1),
    })
}

/// A candidate after its adjustment.
pub(super) struct CameraTrial {
    pub intrinsics: FreeIntrinsics,
    pub problem: BundleProblem,
    pub score: Score,
    /// Root mean square of the held-out error, pixels.
    held_out_px: f64,
}

/// The chosen camera model and how well it does.
#[derive(Clone, Debug)]
pub(crate) struct CameraChoice {
    /// What is to be solved for.
    pub intrinsics: FreeIntrinsics,
    /// How well the chosen model does; its BIC is not finite where there was nothing to choose by.
    pub(crate) score: Score,
    /// For the report.
    pub decision: Decision,
    /// The problem's cameras, poses and points as the chosen model has them.
    pub problem: BundleProblem,
}

/// What is solved for before the evidence has spoken; `named`: the user's model.
pub(crate) fn before_the_choice(named: Option<CameraModel>) -> FreeIntrinsics {
    let model = named.unwrap_or(CameraModel::SimpleRadial);
    FreeIntrinsics { model, principal_point: false, held: None }
}

/// Chooses for all cameras of `problem` that are not known. `named`: the user's model, which stays. `principal_point`: that
/// it is free already. `sigma`: noise of the observations, pixels. The problem's points and poses are those of a finished adjustment; nothing in it is changed.
pub(crate) fn choose(
    problem: &BundleProblem,
    known: &[Knowledge],
    named: Option<CameraModel>,
    principal_point: bool,
    sigma: f64,
    progress: &Progress,
) -> Result<CameraChoice, SfmError> {
    let start = FreeIntrinsics { principal_point, ..before_the_choice(named) };
    let all_known = known.iter().all(|k| k.fixed);
    let decision = if all_known {
        Decision::new(Subject::CameraModel, known_choice(problem, known), Rule::Given)
    } else {
        Decision::new(Subject::CameraModel, start.choice(), Rule::TooFewObservations)
    };
    let (training, held_out) = split(problem);
    if problem.poses.len() < 3 || held_out.len() < 100 || all_known {
        let problem = problem.clone();
        let score = Score { bic: f64::NAN, ..Score::default() };
        return Ok(CameraChoice { intrinsics: start, score, decision, problem });
    }
    let context = CameraSelection { training, held_out, sigma, known, progress };
    let mut best = context.trial(problem, start)?;
    let mut decision = Decision::new(Subject::CameraModel, start.choice(), Rule::Evidence)
        .measured(Quantity::Noise, sigma)
        .compared(start.choice(), true, best.scores());
    let mut consider = |intrinsics: FreeIntrinsics, best: &mut CameraTrial| -> Result<bool, SfmError> {
        let trial = context.trial(&best.problem, intrinsics)?;
        if trial.score.bic < best.score.bic {
            // It went on from where the other had come to. So may the other, or BIC compares numbers of iterations.
            let again = context.trial(&trial.gone_back_to(best), best.intrinsics)?;
            if again.score.bic < best.score.bic {
                *best = again;
                decision.alternatives.push(best.as_alternative(true));
            }
        }
        let found = Comparison::new(&trial.score, &best.score);
        let better = if parameters(intrinsics) < parameters(best.intrinsics) {
            found.prefers_simpler()
        } else {
            found.prefers_richer() && context.determined(&trial)?
        };
        let mut alternative = trial.as_alternative(better);
        alternative.scores.extend(found.measurements());
        decision.alternatives.push(alternative);
        if better {
            *best = trial;
        }
        Ok(better)
    };
    let with = |best: &CameraTrial, model| FreeIntrinsics { model, ..best.intrinsics };
    let freed = |best: &CameraTrial| FreeIntrinsics { principal_point: true, ..best.intrinsics };
    if !start.principal_point {
        consider(freed(&best), &mut best)?;
    }
    if named.is_none() {
        let doubted = best.intrinsics;
        if !consider(with(&best, CameraModel::SimplePinhole), &mut best)?
            && consider(with(&best, CameraModel::Radial), &mut best)?
        {
            consider(with(&best, CameraModel::Opencv), &mut best)?;
        } else if best.intrinsics.model == CameraModel::SimplePinhole {
            consider(with(&best, CameraModel::Pinhole), &mut best)?;
        }
        // With another model the principal point is another question.
        if !best.intrinsics.principal_point && best.intrinsics != doubted {
            consider(freed(&best), &mut best)?;
        }
    }
    decision.choice = best.intrinsics.choice();
    Ok(CameraChoice { intrinsics: best.intrinsics, score: best.score, decision, problem: best.problem })
}

/// Which of several ways to rotate images (see [`crate::model_selection::rotated_images`]) the observations support, with the choice that goes with it:
/// a free principal point that predicts better than the untouched images' best model and pays for itself and for one
/// bit an image. `None` where the evidence is not clear. The alternatives say what was found.
pub(crate) fn choose_rotated(
    untouched: &CameraChoice,
    ways: &[BundleProblem],
    known: &[Knowledge],
    named: Option<CameraModel>,
    sigma: f64,
    progress: &Progress,
) -> Result<(Option<(usize, CameraChoice)>, Vec<Alternative>), SfmError> {
    let free = FreeIntrinsics { principal_point: true, ..untouched.intrinsics };
    let mut least: Option<(usize, CameraTrial)> = None;
    for (way, problem) in ways.iter().enumerate() {
        let (training, held_out) = split(problem);
        let trial = CameraSelection { training, held_out, sigma, known, progress }.trial(problem, free)?;
        if least.as_ref().is_none_or(|(_, t)| trial.score.bic < t.score.bic) {
            least = Some((way, trial));
        }
    }
    let Some((way, trial)) = least else { return Ok((None, Vec::new())) };
    // From where that trial has come to, with all observations and priors again.
    let start =
        BundleProblem { poses: trial.problem.poses, points: trial.problem.points, ..ways[way].clone() };
    let cameras =
        trial.problem.cameras.iter().zip(&start.cameras).map(|(c, old)| convert_camera(c, old.model));
    let start = BundleProblem { cameras: cameras.collect(), ..start };
    let choice = choose(&start, known, named, true, sigma, progress)?;
    let bits = 2.0 * std::f64::consts::LN_2 * ways[way].poses.len() as f64;
    let mut found = Comparison::new(&choice.score, &untouched.score);
    found.margin -= bits;
    let better = found.prefers_rotated();
    let bic = |bic| Measurement::new(Quantity::Bic, bic);
    let alternatives = vec![
        Alternative {
            choice: Choice::Taken(false),
            accepted: !better,
            scores: vec![bic(untouched.score.bic)],
        },
        Alternative {
            choice: Choice::Taken(true),
            accepted: better,
            scores: [bic(choice.score.bic + bits)].into_iter().chain(found.measurements()).collect(),
        },
    ];
    Ok((better.then_some((way, choice)), alternatives))
}

/// The choice where all cameras are known.
pub(crate) fn known_choice(problem: &BundleProblem, known: &[Knowledge]) -> Choice {
    let is_calibrated = known.iter().any(|k| k.calibration.is_some());
    Choice::Camera {
        model: problem.cameras.first().map(|c| c.model),
        principal_point: if is_calibrated { PrincipalPoint::Calibrated } else { PrincipalPoint::Given },
    }
}

fn parameters(intrinsics: FreeIntrinsics) -> usize {
    intrinsics.model.num_params() - if intrinsics.principal_point { 0 } else { 2 }
}

pub(super) struct CameraSelection<'a> {
    pub training: Vec<BundleObservation>,
    pub held_out: Vec<BundleObservation>,
    pub sigma: f64,
    pub known: &'a [Knowledge],
    pub progress: &'a Progress,
}

impl CameraSelection<'_> {
    pub(super) fn trial(
        &self,
        from: &BundleProblem,
        intrinsics: FreeIntrinsics,
    ) -> Result<CameraTrial, SfmError> {
        let mut problem = from.clone();
        problem.observations.clone_from(&self.training);
        problem.observations.iter_mut().for_each(|o| o.sigma_px *= self.sigma);
        apply(&mut problem, intrinsics, self.known);
        let summary = problem.solve(&options(), self.progress)?;
        let n = problem.observations.len() as f64;
        let cameras = self.known.iter().filter(|k| !k.fixed).count();
        // `final_rms² n` is twice the robust cost, which stands for −2 log likelihood.
        let bic = summary.final_rms.powi(2) * n + (parameters(intrinsics) * cameras) as f64 * (2.0 * n).ln();
        let mut cost = vec![0.0; problem.poses.len()];
        for o in &problem.observations {
            let squared = error_sq(&problem, o).min(f64::MAX) / o.sigma_px.powi(2);
            cost[o.pose as usize] += LOSS.powi(2) * (squared / LOSS.powi(2)).ln_1p();
        }
        let mut held_out = vec![(0.0, 0usize); problem.poses.len()];
        for o in &self.held_out {
            let squared = error_sq(&problem, o) / (o.sigma_px * self.sigma).powi(2);
            let of_image = &mut held_out[o.pose as usize];
            *of_image = (of_image.0 + squared.min(TRUNCATION * TRUNCATION), of_image.1 + 1);
        }
        let all: f64 = held_out.iter().map(|s| s.0).sum::<f64>() / self.held_out.len().max(1) as f64;
        let held_out_px = all.sqrt() * self.sigma;
        let bic = if summary.usable { bic } else { f64::INFINITY };
        Ok(CameraTrial { intrinsics, problem, score: Score { bic, cost, held_out }, held_out_px })
    }

    /// Whether the normal equations pin down what was freed.
    pub(super) fn determined(&self, trial: &CameraTrial) -> Result<bool, SfmError> {
        let Some(covariance) = trial.problem.covariance(&options())? else { return Ok(false) };
        let free = trial.problem.cameras.iter().zip(&covariance.cameras).zip(self.known);
        Ok(free.filter(|(_, known)| !known.fixed).all(|((camera, c), _)| {
            let n = camera.params.len();
            let deviation = |i: usize| c[i * n + i].max(0.0).sqrt();
            let focals = camera.model.num_focals();
            let focal = (0..focals).map(|i| deviation(i) / camera.params[i].abs()).fold(0.0, f64::max);
            let point =
                deviation(focals).max(deviation(focals + 1)) / f64::from(camera.width.max(camera.height));
            focal < DETERMINED_FOCAL && (!trial.intrinsics.principal_point || point < DETERMINED_POINT)
        }))
    }
}

pub(super) fn options() -> SolveOptions {
    SolveOptions {
        loss: RobustLoss::Cauchy(LOSS),
        max_iterations: 25,
        function_tolerance: 2e-5,
        ..SolveOptions::default()
    }
}

impl CameraTrial {
    /// Where this trial has come to, with principal points as `other` has them, if it holds them.
    pub(super) fn gone_back_to(&self, other: &Self) -> BundleProblem {
        let mut problem = self.problem.clone();
        if !other.intrinsics.principal_point {
            for (camera, held) in problem.cameras.iter_mut().zip(&other.problem.cameras) {
                let (n, point) = (camera.model.num_focals(), held.principal_point().to_array());
                camera.params[n..n + 2].copy_from_slice(&point);
            }
        }
        problem
    }

    /// How well it does, and the intrinsics of its first camera.
    pub(super) fn scores(&self) -> Vec<Measurement> {
        let camera = self.problem.cameras.iter().take(1).flat_map(|c| Measurement::of_camera(c, &[]));
        [
            Measurement::new(Quantity::HeldOutError, self.held_out_px),
            Measurement::new(Quantity::Bic, self.score.bic),
        ]
        .into_iter()
        .chain(camera)
        .collect()
    }

    pub(super) fn as_alternative(&self, accepted: bool) -> Alternative {
        Alternative { choice: self.intrinsics.choice(), accepted, scores: self.scores() }
    }
}

/// Gives every camera the chosen model, freedom and priors; those that are known, what is known of them.
pub(crate) fn apply(problem: &mut BundleProblem, intrinsics: FreeIntrinsics, known: &[Knowledge]) {
    let old: Vec<Camera> = problem.cameras.clone();
    let mut priors = Vec::new();
    for (i, camera) in problem.cameras.iter_mut().enumerate() {
        if known[i].fixed {
            let (free, own) = known[i].freedom(i, camera.params.len());
            problem.camera_free[i] = free;
            priors.extend(own);
            continue;
        }
        *camera = convert_camera(&old[i], intrinsics.model);
        problem.camera_free[i] = intrinsics.free(camera);
        // Priors on focal lengths hold in every model; those on distortion are replaced.
        let focal = |p: &&IntrinsicsPrior| p.camera == i && p.parameter < old[i].model.num_focals();
        if let Some(p) = problem.priors.iter().find(focal) {
            priors
                .extend((0..camera.model.num_focals()).map(|parameter| IntrinsicsPrior { parameter, ..*p }));
        }
        if intrinsics.principal_point {
            priors.extend(principal_point_priors(i, camera));
        }
        priors.extend(distortion_priors(i, camera));
    }
    problem.priors = priors;
}

/// Of every other point that is seen at least three times, one observation is held out.
pub(crate) fn split(problem: &BundleProblem) -> (Vec<BundleObservation>, Vec<BundleObservation>) {
    let mut views = vec![0usize; problem.points.len()];
    problem.observations.iter().for_each(|o| views[o.point as usize] += 1);
    let mut seen = vec![0usize; problem.points.len()];
    let (mut training, mut held_out) = (Vec::new(), Vec::new());
    for o in &problem.observations {
        let point = o.point as usize;
        // Which observation of the point it is, so that all images give some.
        let turn = seen[point] == (point / 2) % views[point].max(1);
        seen[point] += 1;
        if views[point] >= 3 && point.is_multiple_of(2) && turn {
            held_out.push(*o)
        } else {
            training.push(*o)
        }
    }
    (training, held_out)
}
