//! Incremental mapping: one image after the other, adjusted as the model grows (Schönberger & Frahm, CVPR 2016).

pub(crate) mod adjust;
pub(crate) mod aliasing;
pub(crate) mod depths;
pub(crate) mod finish;
pub(crate) mod growth;
pub(crate) mod initial;
pub(crate) mod merge;
pub(crate) mod resection;
pub(crate) mod state;
pub(crate) mod structureless_resection;

use crate::mapper::MapperChoice;
use crate::{Knowledge, SfmError};
use adjust::plausible;
use growth::{grow, settle};
use initial::{rank_pairs, start};
use resection::FOCAL_FACTORS;
use scene::{Camera, Progress, TwoViewGeometry};
use serde::{Deserialize, Serialize};
use state::{MapState, MappingInput};

/// Configuration of the mapper.
#[derive(clap::Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MapperConfig {
    /// Largest reprojection error of an observation that is kept, pixels
    #[arg(long, default_value_t = Self::default().max_reprojection_px, help_heading = "Mapping")]
    pub max_reprojection_px: f64,
    /// Smallest triangulation angle of a point that is kept, degrees
    #[arg(long, default_value_t = Self::default().min_angle_deg, help_heading = "Mapping")]
    pub min_angle_deg: f64,
    /// Fewest point observations with which an image is registered
    #[arg(long, default_value_t = Self::default().min_sightings, help_heading = "Mapping")]
    pub min_sightings: usize,
    /// Smallest share of an image's observations that must agree with its pose
    #[arg(long, default_value_t = Self::default().min_sighting_ratio, help_heading = "Mapping")]
    pub min_sighting_ratio: f64,
    /// How a model is made from verified pairs
    #[arg(long, value_enum, default_value_t = MapperChoice::Incremental, help_heading = "Mapping")]
    pub mapper: MapperChoice,
    /// How many first pairs are tried before the best model is taken
    #[arg(long, default_value_t = Self::default().starts, help_heading = "Mapping")]
    pub starts: usize,
}

impl Default for MapperConfig {
    fn default() -> Self {
        Self {
            max_reprojection_px: 4.0,
            min_angle_deg: 1.5,
            min_sightings: 15,
            min_sighting_ratio: 0.25,
            mapper: MapperChoice::Incremental,
            starts: 3,
        }
    }
}

/// Share of an image's verified matches that must agree with its pose.
const MIN_CONSISTENT: f64 = 0.3;
/// Images of the small models that are compared before one is grown.
const SMALL: usize = 5;

/// The best model that grows from some first pair among `geometries`, joined by what others have beyond it where they
/// share points; `None` where none grows.
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
        let done = state.registered_count() * 10 >= images * 9;
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

/// Takes out images whose pose most of their verified matches contradict, or that see too little.
pub(crate) fn expel(state: &mut MapState, input: &MappingInput<'_>) {
    let doubtful = |image: &usize| {
        let (agreeing, all) = structureless_resection::consistency(state, input, *image);
        let few = state.observations(*image) < input.config.min_sightings;
        few || (all >= 2 * input.config.min_sightings && (agreeing as f64) < MIN_CONSISTENT * all as f64)
    };
    let wrong: Vec<usize> = state.order.iter().copied().filter(doubtful).collect();
    wrong.into_iter().for_each(|image| state.unregister(image));
}

/// Models are compared by images, then by observations.
fn value(state: &MapState) -> (usize, usize) {
    (state.registered_count(), state.live().map(|(_, p)| p.views.len()).sum())
}

/// What priors and repairs refer to: the start's intrinsics where they were known, the small model's where not.
pub(crate) fn starts_of(cameras: &[Camera], known: &[Knowledge], state: &MapState) -> Vec<Camera> {
    let start = |i: usize| {
        if known[i].focal_sigma.is_some() || known[i].fixed { &cameras[i] } else { &state.cameras[i] }
    };
    (0..cameras.len()).map(|i| start(i).clone()).collect()
}

/// The small model from a pair; where a focal length is unknown, the one of several whose model explains most.
fn begin(
    input: &MappingInput<'_>,
    cameras: &[Camera],
    known: &[Knowledge],
    geometry: &TwoViewGeometry,
    progress: &Progress,
) -> Result<Option<MapState>, SfmError> {
    let unknown = |image: usize| {
        let k = &known[input.camera_of[image]];
        !k.fixed && k.focal_sigma.is_none()
    };
    let search = unknown(geometry.a) || unknown(geometry.b);
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
        let score = agreement(&state, input);
        if state.cameras.iter().all(plausible) && best.as_ref().is_none_or(|(s, _)| score > *s) {
            best = Some((score, state));
        }
    }
    Ok(best.map(|(_, state)| state))
}

/// `Σ max(0, 1 − e²/T²)` over all observations.
fn agreement(state: &MapState, input: &MappingInput<'_>) -> f64 {
    let limit = input.config.max_reprojection_px;
    state.errors(input).iter().map(|e| (1.0 - (e / limit).powi(2)).max(0.0)).sum()
}
