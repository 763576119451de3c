//! Which mapper's model is taken: the incremental one's, the global one's, or the one that the
//! observations bear out.

use crate::disjoint_sets::DisjointSets;
use crate::error::SfmError;
use crate::global;
use crate::incremental::state::{MapState, MappingInput};
use crate::incremental::structureless_resection::{MATCHES, agreement};
use crate::incremental::{MapperChoice, map as incremental};
use crate::knowledge::Knowledge;
use crate::limits::WHOLE;
use crate::model_selection::accept::{Change, Support, accept};
use scene::decision::{Decision, MapperKind, Measurement, Quantity, Rule, Subject};
use scene::{Camera, Progress};

/// The model of all images that can be tied together; what was decided, where there was a choice.
pub(super) fn map(
    input: &MappingInput<'_>,
    cameras: &[Camera],
    known: &[Knowledge],
    progress: &Progress,
) -> Result<(Option<MapState>, Option<Decision>), SfmError> {
    let choice = input.config.mapper;
    if choice == MapperChoice::Global {
        let started = incremental::sketch(input, cameras, known, progress)?;
        let Some(start) = started else { return Ok((None, None)) };
        let model = global::map(input, &start.cameras, known, progress)?;
        let said = model.as_ref().map(|m| describe(input, MapperKind::Global, &[(MapperKind::Global, m)]));
        return Ok((model, said));
    }
    let Some(first) = incremental::map(input, cameras, known, progress)? else { return Ok((None, None)) };
    let complete = first.registered_count() as f64 >= WHOLE * largest_part(input) as f64;
    if choice == MapperChoice::Incremental || complete {
        return Ok((Some(first), None));
    }
    let Some(second) = global::map(input, &first.cameras, known, progress)? else {
        return Ok((Some(first), None));
    };
    let [before, after] = [&first, &second].map(|state| Support::of(count_agreeing(state, input).0));
    let models = [(MapperKind::Incremental, &first), (MapperKind::Global, &second)];
    if accept(Change::GlobalMapper, &before, &after) {
        let decision = describe(input, MapperKind::Global, &models);
        return Ok((Some(second), Some(decision)));
    }
    let decision = describe(input, MapperKind::Incremental, &models);
    Ok((Some(first), Some(decision)))
}

/// Images in the largest part of the graph of verified pairs.
fn largest_part(input: &MappingInput<'_>) -> usize {
    let mut parts = DisjointSets::new(input.keypoints.len());
    input.geometries.iter().for_each(|g| {
        parts.join(g.a, g.b);
    });
    parts.sizes().into_iter().max().unwrap_or(0)
}

/// Matches of all verified pairs: (those that agree with a model, all); of pairs without two poses
/// none agrees.
fn count_agreeing(state: &MapState, input: &MappingInput<'_>) -> (usize, usize) {
    let mut sums = (0, 0);
    for g in input.geometries {
        let (agreeing, all) = agreement(state, input, g).unwrap_or((0, g.inliers.len().min(MATCHES)));
        sums.0 += agreeing;
        sums.1 += all;
    }
    sums
}

/// The decision with what each mapper's model explains.
fn describe(input: &MappingInput<'_>, taken: MapperKind, models: &[(MapperKind, &MapState)]) -> Decision {
    let mut decision = Decision::new(Subject::Mapper, taken, Rule::Evidence);
    for &(kind, state) in models {
        let (agreeing, all) = count_agreeing(state, input);
        let scores = vec![
            Measurement::count(Quantity::RegisteredImages, state.registered_count()),
            Measurement::count(Quantity::AgreeingMatches, agreeing),
            Measurement::count(Quantity::Matches, all),
        ];
        decision = decision.compared(kind, kind == taken, scores);
    }
    decision
}
