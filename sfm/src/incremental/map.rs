//! Incremental mapping: one image after the other, adjusted as the model grows (Schönberger &
//! Frahm, CVPR 2016).

use super::adjust::plausible;
use super::growth::{SMALL, expel, grow, settle, starts_of};
use super::initial::{rank_pairs, start};
use super::merge;
use super::resection::FOCAL_FACTORS;
use super::state::{MapState, MappingInput};
use crate::error::SfmError;
use crate::knowledge::Knowledge;
use crate::limits::WHOLE;
use scene::{Camera, Progress, TwoViewGeometry};

/// The best model that grows from some first pair among `geometries`, joined by what others have
/// beyond it where they share points; `None` where none grows.
pub(crate) fn map(
    input: &MappingInput<'_>,
    cameras: &[Camera],
    known: &[Knowledge],
    progress: &Progress,
) -> Result<Option<MapState>, SfmError> {
    let geometries = input.geometries;
    let images = input.keypoints.len();
    let mut models: Vec<MapState> = Vec::new();
    let mut used = vec![false; images];
    let ranked = rank_pairs(geometries);
    let mut tries = 0;
    for pair in ranked {
        let g = &geometries[pair];
        if tries >= input.config.starts {
            break;
        }
        // Another start from where a model has grown would grow the same one.
        if used[g.a] && used[g.b] {
            continue;
        }
        tries += 1;
        used[g.a] = true;
        used[g.b] = true;
        let Some(mut state) = begin(input, cameras, known, g, progress)? else { continue };
        let starts = starts_of(cameras, known, &state);
        grow(&mut state, input, known, &starts, images, progress)?;
        settle(&mut state, input, known, &starts, progress)?;
        expel(&mut state, input);
        state.order.iter().for_each(|&i| used[i] = true);
        let done = state.registered_count() as f64 >= WHOLE * images as f64;
        models.push(state);
        if done {
            break;
        }
    }
    // The best comes first; of equals the earlier one.
    models.sort_by_key(|m| std::cmp::Reverse(value(m)));
    let mut models = models.into_iter();
    let Some(mut best) = models.next() else { return Ok(None) };
    for other in models {
        if let Some(whole) = merge::join(&best, &other, input, (cameras, known), progress)? {
            best = whole;
        }
    }
    Ok((best.registered_count() >= 2).then_some(best))
}

/// The small model of the best first pair that gives one; its intrinsics are about right.
pub(crate) fn sketch(
    input: &MappingInput<'_>,
    cameras: &[Camera],
    known: &[Knowledge],
    progress: &Progress,
) -> Result<Option<MapState>, SfmError> {
    for pair in rank_pairs(input.geometries).into_iter().take(input.config.starts.max(1)) {
        let begun = begin(input, cameras, known, &input.geometries[pair], progress)?;
        if begun.is_some() {
            return Ok(begun);
        }
    }
    Ok(None)
}

/// Models are compared by images, then by observations.
fn value(state: &MapState) -> (usize, usize) {
    (state.registered_count(), state.live().map(|(_, p)| p.views.len()).sum())
}

/// The small model from a pair; where a focal length is unknown, the one of several whose model
/// explains most.
fn begin(
    input: &MappingInput<'_>,
    cameras: &[Camera],
    known: &[Knowledge],
    geometry: &TwoViewGeometry,
    progress: &Progress,
) -> Result<Option<MapState>, SfmError> {
    let of_pair = [geometry.a, geometry.b].map(|image| &known[input.camera_of[image]]);
    let search = of_pair.iter().any(|k| !k.fixed && k.focal_sigma.is_none());
    let factors: &[f64] = if search { &FOCAL_FACTORS } else { &[1.0] };
    let mut best: Option<(f64, MapState)> = None;
    for factor in factors {
        let mut scaled = cameras.to_vec();
        for (camera, k) in scaled.iter_mut().zip(known) {
            if !k.fixed && k.focal_sigma.is_none() {
                let focals = camera.model.num_focals();
                camera.params[..focals].iter_mut().for_each(|f| *f *= factor);
            }
        }
        let Some(mut state) = start(input, &scaled, geometry, progress)? else { continue };
        grow(&mut state, input, known, &scaled, SMALL, progress)?;
        let score = state.agreement(input);
        if state.cameras.iter().all(plausible) && best.as_ref().is_none_or(|(s, _)| score > *s) {
            best = Some((score, state));
        }
    }
    Ok(best.map(|(_, state)| state))
}
