//! Other models than the one that grew first: from more pairs, from fewer, with images in their places on a ring.

use crate::circular::{Motion, ring};
use crate::incremental::state::MapState;
use crate::incremental::{self, aliasing};
use crate::model_selection::camera;
use crate::reconstruct::{MappedModel, StepContext, grow_model};
use crate::{SfmError, two_view};
use scene::{Camera, Decision, Progress, TwoViewGeometry};
use std::collections::BTreeSet;

/// Images up to which pairs are looked at a second time where some image found no pose (about 40 ms a pair), and how often.
const SECOND_LOOK_UP_TO: usize = 40;
const SECOND_LOOKS: usize = 2;

/// A model and, where it is a ring, the same with the images that it missed.
type RingModel = (MappedModel, Option<(MapState, Decision)>);

/// Where images are still missing from a small set: the model from all pairs looked at again, unless it has fewer images.
pub(crate) fn retry_unmatched_pairs(
    given: &StepContext<'_>,
    keypoints: &[Vec<glam::DVec2>],
    geometries: &mut Vec<TwoViewGeometry>,
    first: RingModel,
    progress: &Progress,
) -> Result<RingModel, SfmError> {
    let standing =
        |p: &RingModel| p.1.as_ref().map_or(p.0.state.registered_count(), |c| c.0.registered_count());
    if standing(&first) >= keypoints.len() || keypoints.len() > SECOND_LOOK_UP_TO {
        return Ok(first);
    }
    let mut wider = geometries.clone();
    let mut found: Option<MappedModel> = None;
    for _ in 0..SECOND_LOOKS {
        let from = found.as_ref().map_or(&first.0.state, |g| &g.state);
        let Some(next) = second_attempt(given, keypoints, &mut wider, from, progress)? else { break };
        found = Some(next);
    }
    let Some(model) = found else { return Ok(first) };
    let completed = complete_ring(given, keypoints, &model, &wider, progress)?;
    let second = (model, completed);
    if standing(&second) < standing(&first) {
        return Ok(first);
    }
    *geometries = wider;
    Ok(second)
}

/// Pairs that did not pass are looked at again with the solved intrinsics. The model that grows from all pairs then,
/// where it is no smaller; `None` where no pair passes.
fn second_attempt(
    given: &StepContext<'_>,
    keypoints: &[Vec<glam::DVec2>],
    geometries: &mut Vec<TwoViewGeometry>,
    first: &MapState,
    progress: &Progress,
) -> Result<Option<MappedModel>, SfmError> {
    let StepContext { config, setup, features, .. } = *given;
    let images = features.len();
    let passed: BTreeSet<(usize, usize)> = geometries.iter().map(|g| (g.a, g.b)).collect();
    let all = (0..images).flat_map(|a| (a + 1..images).map(move |b| (a, b)));
    let pairs: Vec<(usize, usize)> = all.filter(|p| !passed.contains(p)).collect();
    let cameras: Vec<Camera> = setup.camera_of.iter().map(|&c| first.cameras[c].clone()).collect();
    let wide = two_view::second_look(features, &cameras, &pairs, &config.matching, config.seed, progress)?;
    if wide.is_empty() {
        return Ok(None);
    }
    let configs = (&config.matching, &config.two_view);
    let wide =
        two_view::match_along_lines(features, &cameras, wide, configs, |_| true, config.seed, progress)?;
    let mut more = geometries.clone();
    more.extend(wide);
    more.sort_by_key(|g| (g.a, g.b));
    let second = grow_model(given, keypoints, &more, progress)?;
    let larger = second.filter(|g| g.state.registered_count() >= first.registered_count());
    if larger.is_some() {
        *geometries = more;
    }
    Ok(larger)
}

/// The model with the images that a ring of cameras misses, where it is one and one camera took it.
pub(crate) fn complete_ring(
    given: &StepContext<'_>,
    keypoints: &[Vec<glam::DVec2>],
    MappedModel { state, tracks, .. }: &MappedModel,
    geometries: &[TwoViewGeometry],
    progress: &Progress,
) -> Result<Option<(MapState, Decision)>, SfmError> {
    let StepContext { config, setup, .. } = *given;
    if config.motion.motion == Motion::Free || setup.cameras.len() != 1 {
        return Ok(None);
    }
    let starts = incremental::starts_of(&setup.cameras, &setup.known, state);
    let intrinsics = camera::before_the_choice(config.camera_model.model());
    let input = given.input(keypoints, tracks, geometries);
    ring::complete(state, &given.motion_input(&input, &starts, progress).context(&[]), intrinsics)
}

/// Where repeated structure has aliased the model: the model without the pairs that cannot be true, and what was
/// found. Those pairs are taken out of `geometries`.
pub(crate) fn remove_aliased_pairs(
    given: &StepContext<'_>,
    keypoints: &[Vec<glam::DVec2>],
    geometries: &mut Vec<TwoViewGeometry>,
    MappedModel { state, tracks, .. }: &MappedModel,
    progress: &Progress,
) -> Result<Option<(MappedModel, Decision)>, SfmError> {
    let input = given.input(keypoints, tracks, geometries);
    let Some(plausible) = aliasing::find_consistent_pairs(state, &input, given.is_video) else {
        return Ok(None);
    };
    let kept: Vec<TwoViewGeometry> = plausible.iter().map(|&i| geometries[i].clone()).collect();
    let Some(second) = grow_model(given, keypoints, &kept, progress)? else { return Ok(None) };
    if !aliasing::is_better(&second.state, state, &input, given.is_video) {
        return Ok(None);
    }
    let decision = aliasing::decision(&second.state, state, &input, kept.len(), given.is_video);
    *geometries = kept;
    Ok(Some((second, decision)))
}
