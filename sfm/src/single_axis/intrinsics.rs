//! Which intrinsics a turn determines. One axis says little about the principal point along the axis (a tilt of the
//! axis does nearly the same), but something about its coordinate across.

use super::problem::TurnProblem;
use crate::bundle::{Loss, SolveOptions};
use crate::selection::{Intrinsics, PRINCIPAL_POINT_SIGMA, apply, choose, noise};
use crate::{Decision, SfmError};
use glam::DVec3;
use scene::{CameraModel, Progress};

/// A coordinate whose standard deviation is this share of what it was before is determined.
const DETERMINED: f64 = 0.2;
/// An axis leans at most so much (tangent) in the image where one coordinate is across it.
const LEAN: f64 = 0.5;

/// Camera model and freedom by evidence; the principal point across the axis where it is determined.
pub(crate) fn choose_for_turn(
    problem: &TurnProblem,
    fixed: &[bool],
    named: Option<CameraModel>,
    progress: &Progress,
) -> Result<(Intrinsics, Decision), SfmError> {
    let (chosen, mut decision) = choose(problem, fixed, named, progress)?;
    let Some(along) = along_axis(problem).filter(|_| !chosen.principal_point && !fixed[0]) else {
        return Ok((chosen, decision));
    };
    let partial = Intrinsics { principal_point: true, held: Some(along), ..chosen };
    let mut costs = Vec::new();
    let mut deviation = None;
    for intrinsics in [chosen, partial] {
        let mut trial = problem.clone();
        apply(&mut trial.bundle, intrinsics, fixed);
        let sigma = noise(&trial.bundle);
        trial.bundle.observations.iter_mut().for_each(|o| o.sigma_px = sigma);
        let options = SolveOptions {
            loss: Loss::Cauchy(2.0),
            max_iterations: 30,
            function_tolerance: 1e-7,
            ..SolveOptions::default()
        };
        let summary = trial.solve(&options, progress)?;
        let sightings = summary.observations as f64;
        costs.push(
            summary.final_rms.powi(2) * sightings
                + if intrinsics == partial { (2.0 * sightings).ln() } else { 0.0 },
        );
        if intrinsics == partial && summary.usable {
            let camera = &trial.bundle.cameras[0];
            let (n, i) = (camera.params.len(), camera.model.num_focals() + 1 - along);
            let variance = trial.covariance(&options)?.map(|c| c.cameras[0][i * n + i]);
            deviation = variance.map(|v| (camera.params[i], v.max(0.0).sqrt()));
        }
    }
    let camera = &problem.bundle.cameras[0];
    let before = PRINCIPAL_POINT_SIGMA * f64::from(camera.width.max(camera.height));
    let name = ["x", "y"][1 - along];
    let Some((value, sd)) = deviation else { return Ok((chosen, decision)) };
    let taken = sd < DETERMINED * before && costs[1] < costs[0] + 10.0;
    let verdict = if taken { "determined, the other coordinate is held" } else { "not determined, held" };
    decision.evidence = format!(
        "{}; principal point {name} across the axis {value:.2} ± {sd:.2} px, BIC {:+.0}: {verdict}",
        decision.evidence,
        costs[1] - costs[0]
    );
    if !taken {
        return Ok((chosen, decision));
    }
    decision.chosen = partial.describe();
    Ok((partial, decision))
}

/// The image coordinate (0: x, 1: y) along which the axis lies; `None` where it leans or is seen end on.
fn along_axis(problem: &TurnProblem) -> Option<usize> {
    let z = problem.axis.rotation * DVec3::Z;
    let (x, y) = (z.x.abs(), z.y.abs());
    match () {
        _ if x.max(y) < 0.3 => None,
        _ if x < LEAN * y => Some(1),
        _ if y < LEAN * x => Some(0),
        _ => None,
    }
}
