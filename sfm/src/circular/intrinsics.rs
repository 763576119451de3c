//! Which intrinsics a turn determines.
//!
//! Without distortion, and with the axis in the plane of the optical axis, a tilt of the axis, the
//! focal length and the principal point along the axis can change together without changing any
//! image: planes across the axis are seen as they are, but the scale along it is only known up to a
//! projectivity (Fitzgibbon, Cross & Zisserman 1998, section 4). What breaks this is distortion,
//! whose centre is the principal point, and an axis beside the image centre; what is known
//! beforehand does the rest. So the principal point has a prior and is free where the observations
//! say more than that; distortion is free with it, for it must not stand for a wrong centre.

use super::axis::Elevation;
use super::model::CircularContext;
use super::motion::CircularMotion;
use super::problem::{CircularProblem, ElevationPrior};
use super::vertical_lines::{self, Segment};
use crate::bundle::{RobustLoss, SolveOptions};
use crate::error::SfmError;
use crate::knowledge::Knowledge;
use crate::model_selection::camera::{FreeIntrinsics, apply, known_choice, point_sigma};
use crate::model_selection::evidence::{TRACK_EXCESS, contradicts_prior, is_determined};
use glam::DVec3;
use scene::decision::{Alternative, Decision, Measurement, Quantity, Rule, Subject};
use scene::{CameraModel, Progress};

/// An axis leans at most so much (tangent) in the image where one coordinate is across it.
/// Source: derived; the other coordinate is then half along it.
const LEAN: f64 = 0.5;

/// Camera model and freedom by evidence; the principal point where it is determined. The
/// observations of `problem` have their standard deviations. `edges`: lines of the room.
pub(crate) fn choose_for_turn(
    problem: &CircularProblem,
    context: &CircularContext<'_>,
    edges: &[Segment],
    named: Option<CameraModel>,
) -> Result<(FreeIntrinsics, Decision, Option<Elevation>), SfmError> {
    let (known, progress) = (context.known, context.progress);
    let model = named.unwrap_or(CameraModel::SimpleRadial);
    let chosen = FreeIntrinsics { model, principal_point: false, held: None };
    let undetermined = Decision::new(Subject::CameraModel, chosen.choice(), Rule::NotDetermined);
    let trial = IntrinsicsTrials { known, progress };
    if known[0].fixed {
        let choice = known_choice(&problem.bundle, known);
        let decision = Decision::new(Subject::CameraModel, choice, Rule::Given);
        return Ok((chosen, decision, None));
    }
    let Some(mut best) = trial.of(problem, chosen)? else {
        return Ok((chosen, undetermined, None));
    };
    let mut decision = Decision { rule: Rule::Evidence, ..undetermined };
    decision.alternatives.push(best.as_alternative(true));
    let mut elevation = None;
    if let Some(along) = along_axis(problem) {
        let partial = FreeIntrinsics { principal_point: true, held: Some(along), ..chosen };
        if let Some(found) = trial.of(&best.solution, partial)? {
            let taken = is_taken(&found, 1 - along, best.bic);
            decision.alternatives.push(found.as_alternative(taken));
            if taken {
                best = found;
            }
        }
        // Along the axis it is seen by distortion alone, which has to be free in full.
        let model = if named.is_none() { CameraModel::Radial } else { model };
        let held = (!best.intrinsics.principal_point).then_some(1 - along);
        let whole = FreeIntrinsics { model, principal_point: true, held };
        (best, elevation) = trial.along(best, whole, along, (context, edges), &mut decision)?;
    }
    // Distortion once more: it takes up what a wrong principal point leaves.
    for model in [CameraModel::SimpleRadial, CameraModel::Radial] {
        let more = model.num_params() > best.intrinsics.model.num_params();
        if named.is_some() || !more || best.intrinsics.model.num_focals() > 1 {
            continue;
        }
        let Some(found) = trial.of(&best.solution, FreeIntrinsics { model, ..best.intrinsics })? else {
            continue;
        };
        let taken = found.bic < best.bic;
        decision.alternatives.push(found.as_alternative(taken));
        if taken {
            best = found;
        }
    }
    decision.choice = best.intrinsics.choice();
    decision.measurements = best.camera_values();
    Ok((best.intrinsics, decision, elevation))
}

struct IntrinsicsTrials<'a> {
    known: &'a [Knowledge],
    progress: &'a Progress,
}

/// An adjusted candidate.
struct IntrinsicsTrial {
    intrinsics: FreeIntrinsics,
    solution: CircularProblem,
    bic: f64,
    focals: usize,
    /// Parameters of the camera with their standard deviations.
    values: Vec<(f64, f64)>,
}

impl IntrinsicsTrials<'_> {
    /// Frees the principal point along the axis (coordinate `along`) where an elevation of the
    /// camera, given or shown by the room's vertical lines, or the observations alone determine it.
    fn along(
        &self,
        best: IntrinsicsTrial,
        whole: FreeIntrinsics,
        along: usize,
        (context, edges): (&CircularContext<'_>, &[Segment]),
        decision: &mut Decision,
    ) -> Result<(IntrinsicsTrial, Option<Elevation>), SfmError> {
        let solved = &best.solution;
        let turn = CircularMotion { axis: solved.axis, angles: Vec::new() };
        let shown = || vertical_lines::elevation(edges, &solved.bundle.cameras[0], &turn);
        let given = context.elevation.clone().or_else(shown);
        // Observations that do not tell the other coordinate do not tell this one.
        let observations_alone = whole.held.is_none().then_some(None);
        for elevation in given.map(Some).into_iter().chain(observations_alone) {
            let levels: Vec<ElevationPrior> = elevation.iter().map(|e| e.level(&turn)).collect();
            let start = CircularProblem { levels, ..solved.clone() };
            let Some(found) = self.of(&start, whole)? else { continue };
            let taken = is_taken(&found, along, best.bic);
            let mut alternative = found.as_alternative(taken);
            if let Some(e) = &elevation {
                let (angle, sigma) = (e.angle.to_degrees(), e.sigma.to_degrees());
                alternative.scores.push(Measurement::estimate(Quantity::GivenElevation, angle, sigma));
            }
            decision.alternatives.push(alternative);
            if taken {
                return Ok((found, elevation));
            }
        }
        Ok((best, None))
    }

    /// Adjusts from a solution with other intrinsics.
    fn of(
        &self,
        start: &CircularProblem,
        intrinsics: FreeIntrinsics,
    ) -> Result<Option<IntrinsicsTrial>, SfmError> {
        let mut trial = start.clone();
        apply(&mut trial.bundle, intrinsics, self.known);
        let options = SolveOptions {
            loss: RobustLoss::Cauchy(2.0),
            max_iterations: 30,
            function_tolerance: 2e-5,
            ..SolveOptions::default()
        };
        let summary = trial.solve(&options, self.progress)?;
        let Some(covariance) = trial.covariance(&options, 1.0)?.filter(|_| summary.usable) else {
            return Ok(None);
        };
        let camera = &trial.bundle.cameras[0];
        let n = camera.params.len();
        let free = intrinsics.free(camera).iter().filter(|f| **f).count() as f64;
        let observations = summary.observations as f64;
        let bic = summary.final_rms.powi(2) * observations + free * (2.0 * observations).ln();
        let deviation = |i: usize| covariance.cameras[0][i * n + i].max(0.0).sqrt();
        let values = (0..n).map(|i| (camera.params[i], deviation(i))).collect();
        let focals = camera.model.num_focals();
        Ok(Some(IntrinsicsTrial { intrinsics, bic, focals, values, solution: trial }))
    }
}

impl IntrinsicsTrial {
    /// The camera's parameters with their standard deviations.
    fn camera_values(&self) -> Vec<Measurement> {
        let deviations: Vec<f64> = self.values.iter().map(|v| v.1).collect();
        Measurement::of_camera(&self.solution.bundle.cameras[0], &deviations).collect()
    }

    fn as_alternative(&self, accepted: bool) -> Alternative {
        let bic = Measurement::new(Quantity::Bic, self.bic);
        let scores = [bic].into_iter().chain(self.camera_values()).collect();
        Alternative { choice: self.intrinsics.choice(), accepted, scores }
    }
}

/// Whether a coordinate of the principal point (0: x, 1: y) is determined, and its prior and what
/// else was known not contradicted. `before`: BIC of what is there without.
fn is_taken(found: &IntrinsicsTrial, coordinate: usize, before: f64) -> bool {
    let prior = point_sigma(&found.solution.bundle.cameras[0]);
    let (_, sd) = found.values[found.focals + coordinate];
    is_determined(sd, TRACK_EXCESS.sqrt(), prior) && !contradicts_prior(found.bic - before)
}

/// The image coordinate (0: x, 1: y) along which the axis lies; `None` where it leans or is seen
/// end on.
fn along_axis(problem: &CircularProblem) -> Option<usize> {
    let z = problem.axis.rotation * DVec3::Z;
    let (x, y) = (z.x.abs(), z.y.abs());
    match () {
        _ if x.max(y) < 0.3 => None,
        _ if x < LEAN * y => Some(1),
        _ if y < LEAN * x => Some(0),
        _ => None,
    }
}
