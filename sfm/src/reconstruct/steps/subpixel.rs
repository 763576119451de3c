//! Whether a model is better for keypoints that were moved to where their windows fit together.

use crate::incremental::state::{MapState, MappingInput};
use crate::reconstruct::StepContext;
use crate::refinement::{RefinedKeypoints, refine};
use crate::statistics::median;
use crate::tracks::NONE;
use crate::{KeypointPlaces, SfmError};
use scene::Progress;
use scene::decision::{Decision, Measurement, Quantity, Rule, Subject};

/// Share of the moved observations that the adjusted model must keep.
const KEPT: f64 = 0.8;

/// Moved keypoints and the model adjusted to them, if it fits them more closely than the model before fitted those that were
/// detected. `settle` adjusts a model. The decision says what was found; there is none where no image may be read.
pub(crate) fn refine_keypoints(
    given: &StepContext<'_>,
    (state, input): (&MapState, &MappingInput<'_>),
    rotated: &[bool],
    settle: impl Fn(MapState, &MappingInput<'_>) -> Result<MapState, SfmError>,
    progress: &Progress,
) -> Result<(Option<(RefinedKeypoints, MapState)>, Option<Decision>), SfmError> {
    let wanted = given.config.keypoints == KeypointPlaces::Windows;
    let Some(frames) = given.images.filter(|_| wanted) else { return Ok((None, None)) };
    let refined = refine(state, input, frames, rotated, progress)?;
    let moved_input = MappingInput { keypoints: &refined.keypoints, sigmas: &refined.sigmas, ..*input };
    let mut sharper = state.clone();
    refined.unsure.iter().for_each(|v| sharper.drop_view(*v));
    sharper.refine_points(&moved_input, |_| false);
    let sharper = settle(sharper, &moved_input)?;
    let observations = state.live().map(|(_, p)| p.views.len()).sum::<usize>();
    let of = |model: &MapState, input: &MappingInput<'_>| median_error(model, input, &refined.moved);
    let ((had, before), (kept, after)) = (of(state, input), of(&sharper, &moved_input));
    let taken = after < before && kept as f64 >= KEPT * had as f64;
    let decision = Decision::new(Subject::KeypointRefinement, taken, Rule::Evidence).with_all([
        Measurement::count(Quantity::Observations, observations),
        Measurement::count(Quantity::MovedObservations, refined.moved.len()),
        Measurement::new(Quantity::MedianErrorBefore, before),
        Measurement::new(Quantity::MedianErrorAfter, after),
    ]);
    Ok((taken.then_some((refined, sharper)), Some(decision)))
}

/// How many of `observations` a model has, and their median reprojection error, pixels; infinite where it has none.
fn median_error(state: &MapState, input: &MappingInput<'_>, observations: &[[u32; 2]]) -> (usize, f64) {
    let error = |view: &[u32; 2]| {
        let point = state.point_of[view[0] as usize][view[1] as usize];
        let point = if point == NONE { None } else { state.points[point as usize].as_ref() };
        point.map(|p| state.error_sq(input, *view, p.position))
    };
    let errors: Vec<f64> = observations.iter().filter_map(error).collect();
    if errors.is_empty() {
        return (0, f64::INFINITY);
    }
    (errors.len(), median(errors).sqrt())
}
