//! The first model: what grows from the verified pairs, or begins with all images in their places
//! on a ring.

use super::constant_step::place_all_images;
use super::mapper;
use super::ties::pairs_decision;
use crate::error::SfmError;
use crate::limits::WHOLE;
use crate::model_selection::accept::{Change, Support, accept};
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{ConstantStepStart, MappedModel, SfmModel, StepResult};
use crate::tracks::{build_tracks, positions};
use scene::{Decision, Features, TwoViewGeometry};

/// Standard deviations of an image's keypoints, in proportion to their scales and 1 for the finest:
/// blurred structure is found less exactly (Zeisl et al., "Estimation of Location Uncertainty for
/// Scale Invariant Feature Points", BMVC 2009).
fn keypoint_sigmas(features: &Features) -> Vec<f32> {
    features.keypoints.iter().map(|k| k.scale.max(1.0)).collect()
}

/// Maps.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    model.stats.features = model.features.iter().map(Features::len).sum();
    model.stats.pairs_verified = model.geometries.len();
    let mut decisions = vec![pairs_decision(&model)];
    context.progress.begin("mapping", model.features.len());
    model.keypoints = model.features.iter().map(positions).collect();
    model.sigmas = model.features.iter().map(keypoint_sigmas).collect();
    model.blurred_matches = None;
    if !context.config.keep_matches {
        model.matches = None;
    }
    let mapped = match model.constant_step.take() {
        Some(start) => grow_or_place(&mut model, &start, &mut decisions, context)?,
        None => grow_model(&model, &model.geometries, context)?,
    };
    if let Some(mapped) = mapped {
        decisions.extend(model.adopt(mapped));
    }
    Ok((model, decisions))
}

/// The model that grows from `geometries`, if one does.
pub(super) fn grow_model(
    model: &SfmModel,
    geometries: &[TwoViewGeometry],
    context: &StepContext<'_>,
) -> Result<Option<MappedModel>, SfmError> {
    let tracks = build_tracks(&model.features, geometries);
    let input = model.input_from(&tracks, geometries, context);
    let (cameras, known) = (&model.setup.cameras, &model.setup.known);
    let (state, decision) = mapper::map(&input, cameras, known, context.progress)?;
    let geometries = geometries.to_vec();
    Ok(state.map(|state| MappedModel { state, tracks, geometries, on_ring: false, decision }))
}

/// The model that grows from the pairs, or the one that begins with all images in their places on a
/// ring: where that stands and pairs alone say little, or where the first misses many images or has
/// them elsewhere.
fn grow_or_place(
    model: &mut SfmModel,
    start: &ConstantStepStart,
    decisions: &mut Vec<Decision>,
    context: &StepContext<'_>,
) -> Result<Option<MappedModel>, SfmError> {
    let mut placed = None;
    if start.instead {
        placed = place_all_images(model, start, context)?;
        if placed.is_some() {
            model.geometries.clone_from(&start.geometries);
            decisions.push(start.decision.clone());
        }
    }
    let grown = grow_model(model, &model.geometries, context)?;
    let before = grown.as_ref().map_or(0, |mapped| images_in_place(mapped, start));
    let enough = if placed.is_some() { 1.0 } else { WHOLE };
    if before as f64 >= enough * model.keypoints.len() as f64 {
        return Ok(grown);
    }
    if !start.instead {
        placed = place_all_images(model, start, context)?;
    }
    let before = Support::of(before);
    Ok(match placed {
        Some(placed) => {
            let after = Support::of(images_in_place(&placed, start));
            if accept(Change::ImagesOnRing, &before, &after) { Some(placed) } else { grown }
        }
        None => grown,
    })
}

/// Images of a model that are where the ring has them.
fn images_in_place(mapped: &MappedModel, start: &ConstantStepStart) -> usize {
    mapped.state.registered_count() - start.motion.astray(&mapped.state.poses)
}
