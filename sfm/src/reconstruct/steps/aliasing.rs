//! The model without the pairs that repeated structure made, where it contradicts pairs that can be
//! trusted.

use super::mapping::grow_model;
use crate::incremental::aliasing::{count_agreeing, find_consistent_pairs};
use crate::incremental::state::{MapState, MappingInput};
use crate::model_selection::accept::{Change, Support, accept};
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};
use scene::TwoViewGeometry;
use scene::decision::{Choice, Decision, Measurement, Quantity, Rule, Subject};

/// Grows the model anew from the pairs that can be true together.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let is_video = context.frames.is_video;
    let input = model.input(context);
    let Some(plausible) = find_consistent_pairs(&model.state, &input, is_video) else {
        return Ok((model, Vec::new()));
    };
    let kept: Vec<TwoViewGeometry> = plausible.iter().map(|&i| model.geometries[i].clone()).collect();
    let Some(consistent) = grow_model(&model, &kept, context)? else { return Ok((model, Vec::new())) };
    let [before, after] = [&model.state, &consistent.state].map(|state| support(state, &input, is_video));
    if !accept(Change::FewerPairs, &before, &after) {
        return Ok((model, Vec::new()));
    }
    let all = model.geometries.len();
    let removed = all - kept.len();
    let [with_all, without] =
        [before, after].map(|s| vec![Measurement::count(Quantity::AgreeingMatches, s.explained)]);
    let decision = Decision::new(Subject::RepeatedStructure, Choice::share(removed, all), Rule::Evidence)
        .compared(Choice::count(0), false, with_all)
        .compared(Choice::count(removed), true, without);
    let mapper = model.adopt(consistent);
    Ok((model, std::iter::once(decision).chain(mapper).collect()))
}

fn support(state: &MapState, input: &MappingInput<'_>, is_video: bool) -> Support {
    let explained = count_agreeing(state, input, is_video);
    Support { images: state.registered_count(), explained, error_px: None }
}
