//! The model as the types that cross borders, and what is to be said of its images.

use super::rotation::rotate_back;
use crate::reconstruct::context::StepContext;
use crate::reconstruct::export::{convert, fill_statistics, weak_images, why_missing};
use crate::reconstruct::model::{SfmModel, StepResult};

/// Converts the model, with rotated images the way up that they came.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    if model.rotated.contains(&true) {
        rotate_back(&mut model);
    }
    let frames = &context.frames.frames;
    let reconstruction = convert(&model.state, &model.setup.camera_of, &model.keypoints, frames);
    fill_statistics(&mut model.stats, &reconstruction);
    let verified = model.verified.as_deref().unwrap_or(&model.geometries);
    for (i, frame) in frames.iter().enumerate() {
        if !reconstruction.images.contains_key(&(i as u32 + 1)) {
            model.missing.push((frame.name.clone(), why_missing(i, &model.features[i], verified)));
        }
    }
    model.weak_images = weak_images(&reconstruction, model.uncertainty.as_ref());
    model.reconstruction = Some(reconstruction);
    Ok((model, Vec::new()))
}
