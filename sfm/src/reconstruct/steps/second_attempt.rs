//! Where images of a small set are missing: pairs that did not pass are matched again, loosely and
//! with the solved intrinsics, and the model is grown anew from all pairs.

use super::mapping::grow_model;
use super::motion::complete_circle;
use crate::error::SfmError;
use crate::model_selection::accept::{Change, Support, accept};
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{MappedModel, SfmModel, StepResult};
use crate::two_view;
use scene::{Camera, TwoViewGeometry};
use std::collections::BTreeSet;

/// How often, each time with the pairs that the last one found.
/// Source: chosen by hand, never measured.
const LOOKS: usize = 2;

/// Looks again where some image has no pose, after the ring is completed if the model is one.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let images = model.keypoints.len();
    if model.state.registered_count() >= images || images > context.config.pairs.exhaustive_up_to {
        return Ok((model, Vec::new()));
    }
    let first = images_in_the_end(&model, None, context)?;
    if first >= images {
        return Ok((model, Vec::new()));
    }
    let mut second: Option<MappedModel> = None;
    for _ in 0..LOOKS {
        let Some(next) = attempt(&model, second.as_ref(), context)? else { break };
        second = Some(next);
    }
    let Some(second) = second else { return Ok((model, Vec::new())) };
    let after = images_in_the_end(&model, Some(&second), context)?;
    let [before, after] = [first, after].map(|images| Support { images, ..Support::default() });
    let decision = if accept(Change::MorePairs, &before, &after) { model.adopt(second) } else { None };
    Ok((model, decision.into_iter().collect()))
}

/// Images that the model, or another one mapped in its place, has once its ring is completed.
fn images_in_the_end(
    model: &SfmModel,
    other: Option<&MappedModel>,
    context: &StepContext<'_>,
) -> Result<usize, SfmError> {
    let (state, input) = match other {
        Some(other) => (&other.state, model.input_from(&other.tracks, &other.geometries, context)),
        None => (&model.state, model.input(context)),
    };
    let completed = complete_circle(model, state, &input, context)?;
    Ok(completed.map_or(state.registered_count(), |(completed, _)| completed.registered_count()))
}

/// Pairs that did not pass are looked at again with the solved intrinsics. The model that grows
/// from all pairs then, where it is no smaller; `None` where no pair passes.
fn attempt(
    model: &SfmModel,
    last: Option<&MappedModel>,
    context: &StepContext<'_>,
) -> Result<Option<MappedModel>, SfmError> {
    let StepContext { config, progress, .. } = *context;
    let (state, geometries) =
        last.map_or((&model.state, &model.geometries), |last| (&last.state, &last.geometries));
    let passed: BTreeSet<(usize, usize)> = geometries.iter().map(|g| (g.a, g.b)).collect();
    let images = model.features.len();
    let all = (0..images).flat_map(|a| (a + 1..images).map(move |b| (a, b)));
    let pairs: Vec<(usize, usize)> = all.filter(|p| !passed.contains(p)).collect();
    let cameras: Vec<Camera> = model.setup.camera_of.iter().map(|&c| state.cameras[c].clone()).collect();
    let (features, configs) = (&model.features, (&config.matching, &config.two_view));
    let wide = two_view::second_look(features, &cameras, &pairs, configs, config.seed, progress)?;
    if wide.is_empty() {
        return Ok(None);
    }
    let wide =
        two_view::match_along_lines(features, &cameras, wide, configs, |_| true, config.seed, progress)?;
    let mut more: Vec<TwoViewGeometry> = geometries.iter().cloned().chain(wide).collect();
    more.sort_by_key(|g| (g.a, g.b));
    let grown = grow_model(model, &more, context)?;
    Ok(grown.filter(|mapped| mapped.state.registered_count() >= state.registered_count()))
}
