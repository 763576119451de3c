//! The last adjustments: the camera model by evidence, all points, covariances.

use super::adjust::{Adjustment, Selected, select, take};
use super::growth::freedom;
use super::state::{MapState, MappingInput};
use crate::bundle::{BundleProblem, ExpectedPoses, SolveOptions};
use crate::error::SfmError;
use crate::knowledge::Knowledge;
use crate::limits::{LEAST_ERROR_PX, OUTLIER_SIGMAS};
use crate::model_selection::camera::{
    CameraChoice, FreeIntrinsics, apply, choose, choose_rotated, deviation,
};
use crate::model_selection::noise::{noise_in_units, redundancy};
use crate::model_selection::principal_point;
use crate::model_selection::rotated_images::{group_size, rotate_problem, suspects};
use crate::result::{PoseDeviation, Uncertainty};
use crate::skip::StepName;
use scene::decision::{Choice, Decision, Rule, Subject};
use scene::{Camera, CameraModel, Progress};

/// Observations that the choices of the camera model and of the motion are based on, and the first
/// round of the last adjustment.
/// Source: docs/decisions/08; 60 an image, ten times what a free pose has parameters.
pub(crate) const OBSERVATIONS: usize = 6000;
/// The same for the question whether images were rotated, of the images that are asked together.
/// Source: chosen by hand for the time that the question takes.
const OBSERVATIONS_ROTATED: usize = 20_000;
/// Iterations times observations that the last adjustment may take: points creep on long after
/// poses stand.
/// Source: chosen by hand for the time that it takes.
const LAST_EFFORT: usize = 300_000;

/// What the evidence says about the cameras.
pub(crate) struct CameraVerdict {
    pub intrinsics: FreeIntrinsics,
    /// For each image whether it was rotated by 180° against the others of its camera.
    pub rotated: Option<Vec<bool>>,
    pub decisions: Vec<Decision>,
    /// The part of the model that the decision was based on, adjusted with what was decided (images
    /// rotated).
    pub adjusted: Selected,
}

/// Decides on the camera model of a model that has been adjusted, and on which of its images were
/// rotated.
pub(crate) fn decide(
    state: &MapState,
    input: &MappingInput<'_>,
    known: &[Knowledge],
    starts: &[Camera],
    named: Option<CameraModel>,
    progress: &Progress,
) -> Result<CameraVerdict, SfmError> {
    let (free, priors) = freedom(&state.cameras, known, starts, state.registered_count());
    let mut what = Adjustment::growing(free, priors);
    what.points_per_image = Some(part_of(state, OBSERVATIONS));
    let part = select(state, input, &what);
    let sigma = noise_in_units(&part.problem);
    let choice = choose(&part.problem, known, named, false, sigma, progress)?;
    if input.is_video || input.skips(StepName::RotatedImages) {
        return Ok(CameraVerdict::new(choice, part, None, Vec::new()));
    }
    let together = group_size(state.registered_count()).max(1);
    what.points_per_image = Some((OBSERVATIONS_ROTATED / together).clamp(50, 1000));
    let suspects = suspects(&select(state, input, &what).problem, known, progress)?;
    if suspects.is_empty() {
        return Ok(CameraVerdict::new(choice, part, None, Vec::new()));
    }
    let ways: Vec<_> = suspects.iter().map(|s| rotate_problem(&part.problem, s)).collect();
    let (better, alternatives) = choose_rotated(&choice, &ways, known, named, sigma, progress)?;
    let images = part.images.len();
    let mut decision = Decision::new(Subject::RotatedImages, Choice::share(0, images), Rule::Evidence)
        .compared_all(alternatives);
    let Some((way, better)) = better else {
        return Ok(CameraVerdict::new(choice, part, None, vec![decision]));
    };
    let mirrored = &suspects[way];
    decision.choice = Choice::share(mirrored.iter().filter(|t| **t).count(), images);
    let mut rotated = vec![false; input.keypoints.len()];
    part.images.iter().zip(mirrored).for_each(|(&image, &t)| rotated[image] = t);
    Ok(CameraVerdict::new(better, part, Some(rotated), vec![decision]))
}

impl CameraVerdict {
    fn new(
        choice: CameraChoice,
        part: Selected,
        rotated: Option<Vec<bool>>,
        mut decisions: Vec<Decision>,
    ) -> Self {
        decisions.push(choice.decision);
        let adjusted = Selected { problem: choice.problem, ..part };
        Self { intrinsics: choice.intrinsics, rotated, decisions, adjusted }
    }
}

/// Points an image contributes where a part of them is enough.
pub(crate) fn part_of(state: &MapState, observations: usize) -> usize {
    (observations / state.registered_count().max(1)).clamp(50, 1000)
}

/// The camera model once more, by all observations of a model that has gained some: its principal
/// point, where it was held.
pub(crate) fn free_principal_point(
    state: &MapState,
    input: &MappingInput<'_>,
    known: &[Knowledge],
    starts: &[Camera],
    (now, named): (FreeIntrinsics, Option<CameraModel>),
    progress: &Progress,
) -> Result<Option<(FreeIntrinsics, Decision)>, SfmError> {
    let (free, priors) = freedom(&state.cameras, known, starts, usize::MAX);
    let problem = select(state, input, &Adjustment::growing(free, priors)).problem;
    principal_point::free_principal_point(&problem, known, (now, named), noise_in_units(&problem), progress)
}

/// Takes over the part of a model that was adjusted with what was decided, and drops what does not
/// fit it.
pub(crate) fn take_decided(state: &mut MapState, input: &MappingInput<'_>, adjusted: &Selected) {
    take(state, adjusted);
    state.refine_points(input, |_| false);
    trim(state, input, &adjusted.problem);
}

/// What the last adjustments hold on to.
pub(crate) struct FinalAdjustment<'a> {
    pub known: &'a [Knowledge],
    /// Intrinsics that priors refer to, one a camera.
    pub starts: &'a [Camera],
    pub intrinsics: FreeIntrinsics,
    /// What a motion says of the poses, by image.
    pub expected: Option<&'a ExpectedPoses>,
}

/// Triangulates, adjusts and filters until little changes.
pub(crate) fn converge(
    state: &mut MapState,
    input: &MappingInput<'_>,
    what: &FinalAdjustment<'_>,
    progress: &Progress,
) -> Result<(), SfmError> {
    for _ in 0..2 {
        let added = state.grow_all(input);
        let (mut selected, options) = what.prepare(state, input);
        let summary = selected.problem.solve(&options, progress)?;
        if !summary.usable {
            break;
        }
        take(state, &selected);
        let gone = trim(state, input, &selected.problem);
        if (added + gone) * 200 < selected.problem.observations.len() {
            break;
        }
    }
    Ok(())
}

/// Standard deviation of a residual coordinate of the model as it is, pixels.
pub(crate) fn noise_of(state: &MapState, input: &MappingInput<'_>) -> f64 {
    let free = state.cameras.iter().map(|c| vec![false; c.params.len()]).collect();
    noise_in_units(&select(state, input, &Adjustment::growing(free, Vec::new())).problem)
}

/// Drops observations that lie outside the noise of an adjustment; how many.
fn trim(state: &mut MapState, input: &MappingInput<'_>, problem: &BundleProblem) -> usize {
    let limit = OUTLIER_SIGMAS * noise_in_units(problem);
    state.filter(input, limit.clamp(LEAST_ERROR_PX, input.config.max_reprojection_px))
}

impl FinalAdjustment<'_> {
    /// The adjustment of all points, observations at the measured noise.
    pub(crate) fn prepare(&self, state: &MapState, input: &MappingInput<'_>) -> (Selected, SolveOptions) {
        let (free, priors) = freedom(&state.cameras, self.known, self.starts, usize::MAX);
        let mut selected = select(state, input, &Adjustment::growing(free, priors));
        apply(&mut selected.problem, self.intrinsics, self.known);
        let sigma = noise_in_units(&selected.problem);
        selected.problem.observations.iter_mut().for_each(|o| o.sigma_px *= sigma);
        selected.problem.expected = self.expected.map(|e| e.of_images(&selected.images));
        let most = (LAST_EFFORT / selected.problem.observations.len().max(1)).clamp(6, 30);
        (selected, SolveOptions::precise(most as u32))
    }
}

/// Standard deviations of poses and intrinsics.
pub(crate) fn uncertainty(
    state: &MapState,
    input: &MappingInput<'_>,
    what: &FinalAdjustment<'_>,
) -> Result<Option<Uncertainty>, SfmError> {
    let (selected, options) = what.prepare(state, input);
    let Some(covariance) = selected.problem.covariance(&options)? else { return Ok(None) };
    let factor = redundancy(&selected.problem);
    // The problem's observations are already in units of the noise.
    let mut result = Uncertainty { sigma_px: factor * noise_of(state, input), ..Uncertainty::default() };
    for (camera, c) in selected.problem.cameras.iter().zip(&covariance.cameras) {
        let n = camera.params.len();
        let deviations = (0..n).map(|i| factor * deviation(camera, c, i));
        result.cameras.insert(camera.id, deviations.collect());
    }
    let poses = covariance.poses.iter().zip(&covariance.centres);
    for (&image, (d, centre)) in selected.images.iter().zip(poses) {
        let rotation = [d[0], d[1], d[2]].map(|v| factor * v);
        let deviation = PoseDeviation { rotation, centre: *centre * (factor * factor) };
        result.images.insert(image as u32 + 1, deviation);
    }
    Ok(Some(result))
}
