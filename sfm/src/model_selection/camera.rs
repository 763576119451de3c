//! The evidence decides the camera model: observations that took no part in the adjustment, and
//! BIC.
//!
//! Candidates are compared on the same observations: each is adjusted without the held-out ones,
//! which then say how well it predicts (paired by image), while BIC (Schwarz 1978) on the robust
//! cost over the measured noise says whether the parameters pay for themselves. Both must agree,
//! and the normal equations must determine what was freed.

use super::evidence::{Comparison, Score, cost_of_groups, is_determined};
use super::noise::{error_sq, inflation};
use crate::bundle::{BundleObservation, BundleProblem, IntrinsicsPrior, SolveOptions, free_parameters};
use crate::error::SfmError;
use crate::knowledge::Knowledge;
use crate::limits::{FEWEST_VIEWS, LOSS, OUTLIER_SIGMAS};
use scene::decision::{Alternative, Choice, Decision, Measurement, PrincipalPoint, Quantity, Rule, Subject};
use scene::{Camera, CameraModel, Progress};

/// Standard deviation of a principal point from the image centre, in longer image sides.
/// Source: lenses and crops of real cameras (docs/decisions/06: 3 %).
pub(crate) const PRINCIPAL_POINT_SIGMA: f64 = 0.03;
/// Standard deviation of a focal length that a file states, as a share of it; with less said, one
/// is not known better.
/// Source: docs/decisions/06 (5 %).
pub(crate) const FOCAL_SIGMA: f64 = 0.05;
/// Standard deviation of radial distortion half the longer image side from the centre, as a share
/// of that distance: 0.05, divided by √8 as residuals are correlated, rounded.
/// Source: docs/decisions/06.
pub(crate) const DISTORTION_SIGMA: f64 = 0.018;

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

/// The camera in another model: shared parameters are taken over, new ones are zero; two focal
/// lengths become their mean.
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

/// Standard deviation of a principal point beforehand, pixels.
pub(crate) fn point_sigma(camera: &Camera) -> f64 {
    PRINCIPAL_POINT_SIGMA * f64::from(camera.width.max(camera.height))
}

/// The prior of a free principal point.
pub(crate) fn principal_point_priors(index: usize, camera: &Camera) -> [IntrinsicsPrior; 2] {
    let (first, sigma) = (camera.model.num_focals(), point_sigma(camera));
    let centre = [camera.width, camera.height].map(|side| f64::from(side) / 2.0);
    [0, 1].map(|k| IntrinsicsPrior { camera: index, parameter: first + k, mean: centre[k], sigma })
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

impl Default for FreeIntrinsics {
    fn default() -> Self {
        before_the_choice(None)
    }
}

/// What is solved for before the evidence has spoken; `named`: the user's model.
pub(crate) fn before_the_choice(named: Option<CameraModel>) -> FreeIntrinsics {
    let model = named.unwrap_or(CameraModel::SimpleRadial);
    FreeIntrinsics { model, principal_point: false, held: None }
}

/// Chooses for all cameras of `problem` that are not known. `named`: the user's model, which stays.
/// `principal_point`: that it is free already. `sigma`: noise of the observations, pixels. The
/// problem's points and poses are those of a finished adjustment; nothing in it is changed.
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
    let selection = CameraSelection::new(problem, known, sigma, progress);
    if all_known || !selection.has_enough() {
        let decision = if all_known {
            Decision::new(Subject::CameraModel, known_choice(problem, known), Rule::Given)
        } else {
            Decision::new(Subject::CameraModel, start.choice(), Rule::TooFewObservations)
        };
        let problem = problem.clone();
        let score = Score { bic: f64::NAN, ..Score::default() };
        return Ok(CameraChoice { intrinsics: start, score, decision, problem });
    }
    let best = selection.trial(problem, start)?;
    let decision = Decision::new(Subject::CameraModel, start.choice(), Rule::Evidence)
        .measured(Quantity::Noise, sigma)
        .compared(start.choice(), true, best.scores());
    let mut search = CameraSearch { selection, best, decision };
    if !start.principal_point {
        search.free_principal_point()?;
    }
    if named.is_none() {
        let doubted = search.best.intrinsics;
        if !search.consider_model(CameraModel::SimplePinhole)?
            && search.consider_model(CameraModel::Radial)?
        {
            search.consider_model(CameraModel::Opencv)?;
        } else if search.best.intrinsics.model == CameraModel::SimplePinhole {
            search.consider_model(CameraModel::Pinhole)?;
        }
        // With another model the principal point is another question.
        if !search.best.intrinsics.principal_point && search.best.intrinsics != doubted {
            search.free_principal_point()?;
        }
    }
    let CameraSearch { best, mut decision, .. } = search;
    decision.choice = best.intrinsics.choice();
    Ok(CameraChoice { intrinsics: best.intrinsics, score: best.score, decision, problem: best.problem })
}

/// The best candidate so far, with what was decided on the way to it.
struct CameraSearch<'a> {
    selection: CameraSelection<'a>,
    best: CameraTrial,
    decision: Decision,
}

impl CameraSearch<'_> {
    fn free_principal_point(&mut self) -> Result<bool, SfmError> {
        self.consider(FreeIntrinsics { principal_point: true, ..self.best.intrinsics })
    }

    fn consider_model(&mut self, model: CameraModel) -> Result<bool, SfmError> {
        self.consider(FreeIntrinsics { model, ..self.best.intrinsics })
    }

    /// Adjusts another candidate and says whether it is the best one now.
    fn consider(&mut self, intrinsics: FreeIntrinsics) -> Result<bool, SfmError> {
        let trial = self.selection.trial(&self.best.problem, intrinsics)?;
        if let Some(again) = self.selection.again(&self.best, &trial)? {
            self.decision.alternatives.push(again.as_alternative(true));
            self.best = again;
        }
        let found = Comparison::new(&trial.score, &self.best.score);
        let better = if parameters(intrinsics) < parameters(self.best.intrinsics) {
            found.prefers_simpler()
        } else {
            found.prefers_richer() && self.selection.determines(&trial)?
        };
        self.decision.alternatives.push(trial.compared(&found, better));
        if better {
            self.best = trial;
        }
        Ok(better)
    }
}

/// Which of several ways to rotate images (see [`crate::model_selection::rotated_images`]) the
/// observations support, with the choice that goes with it: a free principal point that predicts
/// better than the untouched images' best model and pays for itself and for one bit an image.
/// `None` where the evidence is not clear. The alternatives say what was found.
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
        let trial = CameraSelection::new(problem, known, sigma, progress).trial(problem, free)?;
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
    let bits = cost_of_groups(ways[way].poses.len());
    let mut found = Comparison::new(&choice.score, &untouched.score);
    found.margin -= bits;
    let better = found.prefers_richer();
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

/// Candidates for one adjustment: what they are adjusted to, and what they have to predict.
pub(super) struct CameraSelection<'a> {
    training: Vec<BundleObservation>,
    held_out: Vec<BundleObservation>,
    images: usize,
    sigma: f64,
    inflation: f64,
    known: &'a [Knowledge],
    progress: &'a Progress,
}

impl<'a> CameraSelection<'a> {
    pub(super) fn new(
        problem: &BundleProblem,
        known: &'a [Knowledge],
        sigma: f64,
        progress: &'a Progress,
    ) -> Self {
        let (training, held_out) = split(problem);
        let (images, inflation) = (problem.poses.len(), inflation(problem));
        Self { training, held_out, images, sigma, inflation, known, progress }
    }

    /// Whether there is enough to choose by.
    pub(super) fn has_enough(&self) -> bool {
        self.images >= FEWEST_VIEWS && self.held_out.len() >= 100
    }

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
            *of_image = (of_image.0 + squared.min(OUTLIER_SIGMAS.powi(2)), of_image.1 + 1);
        }
        let all: f64 = held_out.iter().map(|s| s.0).sum::<f64>() / self.held_out.len().max(1) as f64;
        let held_out_px = all.sqrt() * self.sigma;
        let bic = if summary.usable { bic } else { f64::INFINITY };
        Ok(CameraTrial { intrinsics, problem, score: Score { bic, cost, held_out }, held_out_px })
    }

    /// `best` once more, from where `other` has come to, if it looked better and that helps: the
    /// other went on from where `best` had come to, and BIC would compare numbers of iterations.
    pub(super) fn again(
        &self,
        best: &CameraTrial,
        other: &CameraTrial,
    ) -> Result<Option<CameraTrial>, SfmError> {
        if !(other.score.bic < best.score.bic) {
            return Ok(None);
        }
        let again = self.trial(&other.gone_back_to(best), best.intrinsics)?;
        Ok((again.score.bic < best.score.bic).then_some(again))
    }

    /// Whether the normal equations pin down focal lengths and what was freed of principal points.
    pub(super) fn determines(&self, trial: &CameraTrial) -> Result<bool, SfmError> {
        let Some(covariance) = trial.problem.covariance(&options())? else { return Ok(false) };
        let free = trial.problem.cameras.iter().zip(&covariance.cameras).zip(self.known);
        Ok(free.filter(|(_, known)| !known.fixed).all(|((camera, c), _)| {
            let focals = camera.model.num_focals();
            let point = if trial.intrinsics.principal_point { 2 } else { 0 };
            (0..focals + point).all(|i| {
                let prior = if i < focals { FOCAL_SIGMA * camera.params[i] } else { point_sigma(camera) };
                is_determined(deviation(camera, c, i), self.inflation, prior)
            })
        }))
    }
}

/// Standard deviation of a camera's parameter, from the covariance of all of them, row by row.
pub(crate) fn deviation(camera: &Camera, covariance: &[f64], parameter: usize) -> f64 {
    covariance[parameter * camera.params.len() + parameter].max(0.0).sqrt()
}

pub(super) fn options() -> SolveOptions {
    SolveOptions::precise(25)
}

impl CameraTrial {
    /// Where this trial has come to, with principal points as `other` has them, if it holds them.
    fn gone_back_to(&self, other: &Self) -> BundleProblem {
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

    /// The same with how it compares to the best one.
    pub(super) fn compared(&self, found: &Comparison, accepted: bool) -> Alternative {
        let mut alternative = self.as_alternative(accepted);
        alternative.scores.extend(found.measurements());
        alternative
    }
}

/// Gives every camera the chosen model, freedom and priors; those that are known, what is known of
/// them.
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
        let mut of_camera = problem.priors.iter().filter(|p| p.camera == i);
        if let Some(p) = of_camera.find(|p| p.parameter < old[i].model.num_focals()) {
            let focals = 0..camera.model.num_focals();
            priors.extend(focals.map(|parameter| IntrinsicsPrior { parameter, ..*p }));
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
