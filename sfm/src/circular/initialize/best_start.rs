//! Which of several seeds a model begins with.

use super::seed::Seed;
use crate::circular::model::{AxisModel, CircularContext};
use crate::circular::motion::CircularMotion;
use crate::error::SfmError;
use crate::incremental::state::MappingInput;
use crate::knowledge::Knowledge;
use scene::Camera;

/// The cameras that a seed's model starts with.
pub(crate) struct SeedCameras<'a> {
    pub cameras: &'a [Camera],
    /// Of the first one.
    pub known: &'a Knowledge,
    /// Points that an image contributes while the seed's model settles.
    pub points_per_image: usize,
}

/// The model about one axis, of those that begin with a seed, with which most observations agree,
/// and the cameras that it began with. `angles`: by image, of a seed.
pub(crate) fn best_start(
    context: &CircularContext<'_>,
    given: &SeedCameras<'_>,
    seeds: &[Seed],
    angles: impl Fn(&Seed) -> Vec<Option<f64>>,
) -> Result<Option<(AxisModel, Vec<Camera>)>, SfmError> {
    let mut best: Option<(f64, AxisModel, Vec<Camera>)> = None;
    for seed in seeds {
        let cameras = seed.cameras(given.cameras, given.known);
        let Some(turn) = CircularMotion::new(seed.direction(), seed.place(), angles(seed)) else { continue };
        let mut model = AxisModel::new(context.input, cameras.clone(), turn);
        let context = CircularContext { starts: &cameras, ..context.clone() };
        if !model.settle_with(&context, 3, given.points_per_image, 2)? {
            continue;
        }
        let score = agreement(&model, context.input);
        if best.as_ref().is_none_or(|(least, ..)| score > *least) {
            best = Some((score, model, cameras));
        }
    }
    Ok(best.map(|(_, model, cameras)| (model, cameras)))
}

/// `Σ max(0, 1 − e²/T²)` over all observations.
fn agreement(model: &AxisModel, input: &MappingInput<'_>) -> f64 {
    let limit = input.config.max_reprojection_px;
    model.state.errors(input).iter().map(|e| (1.0 - (e / limit).powi(2)).max(0.0)).sum()
}
