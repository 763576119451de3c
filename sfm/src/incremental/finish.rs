//! The last adjustments: the camera model by evidence, all points, covariances.

use super::adjust::{Adjustment, Selected, select, take};
use super::growth::{Knowledge, freedom};
use super::state::{Input, State};
use crate::bundle::{Loss, SolveOptions};
use crate::selection::{Choice, Intrinsics, apply, choose, choose_turned, noise};
use crate::turned::{suspects, turn_problem};
use crate::{Decision, PoseDeviation, SfmError, Uncertainty};
use scene::{Camera, CameraModel, Progress};

/// Sightings that the choice of the camera model is based on, and the first round of the last adjustment.
const SIGHTINGS: usize = 6000;
/// The same for the question whether images were turned.
const SIGHTINGS_TURNED: usize = 20_000;
/// Iterations times sightings that the last adjustment may take: points creep on long after poses stand.
const LAST_EFFORT: usize = 300_000;
/// Sightings farther off than so many standard deviations of the noise are dropped at the end.
const FINAL_SIGMAS: f64 = 8.0;
/// They are never held to less than this, pixels.
const FINAL_LEAST_PX: f64 = 1.0;

/// What the evidence says about the cameras.
pub(crate) struct Verdict {
    pub intrinsics: Intrinsics,
    /// For each image whether it was turned by half a turn against the others of its camera.
    pub turned: Option<Vec<bool>>,
    pub decisions: Vec<Decision>,
}

/// Decides on the camera model of a model that has been adjusted.
pub(crate) fn decide(
    state: &State,
    input: &Input<'_>,
    known: &[Knowledge],
    starts: &[Camera],
    named: Option<CameraModel>,
    progress: &Progress,
) -> Result<Verdict, SfmError> {
    let (free, priors) = freedom(&state.cameras, known, starts, state.registered());
    let mut what = Adjustment::growing(free, priors);
    what.points_per_image = Some(part_of(state, SIGHTINGS));
    let Selected { problem, images, .. } = select(state, input, &what);
    let (fixed, sigma) = (fixed(known), noise(&problem));
    let choice = choose(&problem, &fixed, named, false, sigma, progress)?;
    let none = |choice: Choice, mut decisions: Vec<Decision>| {
        decisions.push(choice.decision);
        Verdict { intrinsics: choice.intrinsics, turned: None, decisions }
    };
    if !input.may_be_turned {
        return Ok(none(choice, Vec::new()));
    }
    let more = Adjustment { points_per_image: Some(part_of(state, SIGHTINGS_TURNED)), ..what };
    let suspects = suspects(&select(state, input, &more).problem, &fixed, progress)?;
    if suspects.is_empty() {
        return Ok(none(choice, Vec::new()));
    }
    let ways: Vec<_> = suspects.iter().map(|s| turn_problem(&problem, s)).collect();
    let (better, evidence) = choose_turned(&choice, &ways, &fixed, named, sigma, progress)?;
    let count = |way: usize| suspects[way].iter().filter(|t| **t).count();
    let mut decision = Decision {
        what: "images turned by half a turn".to_owned(),
        chosen: format!("0 of {}", images.len()),
        evidence: format!("the principal points of {} images might be mirrored: {evidence}", count(0)),
    };
    let Some((way, better)) = better else { return Ok(none(choice, vec![decision])) };
    decision.chosen = format!("{} of {}", count(way), images.len());
    decision.evidence = format!("their principal points are mirrored: {evidence}");
    let mut turned = vec![false; input.keypoints.len()];
    images.iter().zip(&suspects[way]).for_each(|(&image, &t)| turned[image] = t);
    let decisions = vec![decision, better.decision];
    Ok(Verdict { intrinsics: better.intrinsics, turned: Some(turned), decisions })
}

/// Points an image contributes where a part of them is enough.
fn part_of(state: &State, sightings: usize) -> usize {
    (sightings / state.registered().max(1)).clamp(50, 1000)
}

fn fixed(known: &[Knowledge]) -> Vec<bool> {
    known.iter().map(|k| k.fixed).collect()
}

/// Triangulates, adjusts to convergence and filters with the chosen intrinsics.
pub(crate) fn polish(
    state: &mut State,
    input: &Input<'_>,
    known: &[Knowledge],
    starts: &[Camera],
    intrinsics: Intrinsics,
    progress: &Progress,
) -> Result<(), SfmError> {
    for round in 0..3 {
        // The intrinsics settle on a part of the points; then all of them need few iterations.
        let part = (round == 0).then_some(2 * part_of(state, SIGHTINGS));
        let (mut selected, options) = prepare(state, input, known, starts, intrinsics, part);
        let summary = selected.problem.solve(&options, progress)?;
        if !summary.usable {
            break;
        }
        take(state, &selected);
        if part.is_some() {
            state.refine_points(input, |_| false);
        }
        let sigma = noise(&selected.problem);
        let limit = (FINAL_SIGMAS * sigma).clamp(FINAL_LEAST_PX, input.config.max_reprojection_px);
        let gone = state.filter(input, limit);
        let added = if round < 2 { state.grow_all(input) } else { 0 };
        if round > 0 && (gone + added) * 200 < selected.problem.observations.len() {
            break;
        }
    }
    Ok(())
}

fn prepare(
    state: &State,
    input: &Input<'_>,
    known: &[Knowledge],
    starts: &[Camera],
    intrinsics: Intrinsics,
    points_per_image: Option<usize>,
) -> (Selected, SolveOptions) {
    let (free, priors) = freedom(&state.cameras, known, starts, usize::MAX);
    let what = Adjustment { points_per_image, ..Adjustment::growing(free, priors) };
    let mut selected = select(state, input, &what);
    apply(&mut selected.problem, intrinsics, &fixed(known));
    let sigma = noise(&selected.problem);
    selected.problem.observations.iter_mut().for_each(|o| o.sigma_px = sigma);
    let most = (LAST_EFFORT / selected.problem.observations.len().max(1)).clamp(6, 30);
    let options = SolveOptions {
        loss: Loss::Cauchy(2.0),
        max_iterations: if points_per_image.is_some() { 15 } else { most as u32 },
        function_tolerance: if points_per_image.is_some() { 1e-5 } else { 2e-5 },
        ..SolveOptions::default()
    };
    (selected, options)
}

/// Standard deviations of poses and intrinsics.
pub(crate) fn uncertainty(
    state: &State,
    input: &Input<'_>,
    known: &[Knowledge],
    starts: &[Camera],
    intrinsics: Intrinsics,
) -> Result<Option<Uncertainty>, SfmError> {
    let (selected, options) = prepare(state, input, known, starts, intrinsics, None);
    let Some(covariance) = selected.problem.covariance(&options)? else { return Ok(None) };
    let sigma_px = noise(&selected.problem);
    let mut result = Uncertainty { sigma_px, ..Uncertainty::default() };
    for (camera, c) in selected.problem.cameras.iter().zip(&covariance.cameras) {
        let n = camera.params.len();
        result.cameras.insert(camera.id, (0..n).map(|i| c[i * n + i].max(0.0).sqrt()).collect());
    }
    for (&image, d) in selected.images.iter().zip(&covariance.poses) {
        let deviation = PoseDeviation { rotation: [d[0], d[1], d[2]], centre: [d[3], d[4], d[5]] };
        result.images.insert(image as u32 + 1, deviation);
    }
    Ok(Some(result))
}
