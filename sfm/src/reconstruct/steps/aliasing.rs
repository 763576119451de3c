//! The model without the pairs that repeated structure made, where it contradicts pairs that can be
//! trusted.

use super::mapping::grow_model;
use crate::Decision;
use crate::incremental::aliasing::{count_agreeing, find_consistent_pairs};
use crate::incremental::state::{MapState, MappingInput};
use crate::reconstruct::accept::{Change, Support, accept};
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};
use scene::TwoViewGeometry;

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
    let decision = Decision {
        what: "repeated structure".to_owned(),
        chosen: format!("{} image pairs set aside", model.geometries.len() - kept.len()),
        evidence: format!(
            "with them the model is aliased: it contradicts trusted pairs ({} of their matches agree with it, {} without \
             the pairs that were set aside)",
            before.explained, after.explained
        ),
    };
    let mapper = model.adopt(consistent);
    Ok((model, std::iter::once(decision).chain(mapper).collect()))
}

fn support(state: &MapState, input: &MappingInput<'_>, is_video: bool) -> Support {
    let explained = count_agreeing(state, input, is_video);
    Support { images: state.registered_count(), explained, error_px: None }
}
