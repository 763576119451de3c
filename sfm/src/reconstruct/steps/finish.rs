//! Short steps that end a model: the last adjustment, covariances, and what is handed back.

use super::camera_model::rotate_back;
use crate::incremental::depths::drop_lonely;
use crate::incremental::finish::uncertainty;
use crate::reconstruct::context::{FeatureOrigin, StepContext};
use crate::reconstruct::export::{colour, convert, fill_statistics, weak_images, why_missing};
use crate::reconstruct::model::{ModelStage, SfmModel, StepResult};

/// Adjusts all poses, points and intrinsics with the camera model that was decided on, until little
/// changes.
pub(super) fn adjust(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let state = std::mem::take(&mut model.state);
    model.state = model.settle(state, &model.input(context), model.intrinsics, context)?;
    Ok((model, Vec::new()))
}

/// Takes out points that two images see and that stand alone in depth.
pub(super) fn remove_isolated_points(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let mut state = std::mem::take(&mut model.state);
    drop_lonely(&mut state, &model.input(context));
    model.state = state;
    Ok((model, Vec::new()))
}

/// Standard deviations of poses and intrinsics at the last adjustment.
pub(super) fn compute_covariance(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let what = model.final_adjustment(model.intrinsics);
    let mut found = uncertainty(&model.state, &model.input(context), &what)?;
    if let (Some(found), Some(deviations)) = (&mut found, &model.deviations) {
        // Poses are held near the motion, which itself is no better known than it is.
        found.images.iter_mut().for_each(|(id, d)| *d = deviations[*id as usize - 1]);
    }
    model.uncertainty = found;
    Ok((model, Vec::new()))
}

/// Converts the model to the types that cross borders, with rotated images the way up that they
/// came, and says what there is to say of its images.
pub(super) fn convert_model(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
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
    let turn = model.stage == ModelStage::OneAxis;
    model.weak_images = weak_images(&reconstruction, model.uncertainty.as_ref(), turn);
    model.reconstruction = Some(reconstruction);
    Ok((model, Vec::new()))
}

/// Colours points, where images may be read.
pub(super) fn colour_points(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    if let Some(reconstruction) = &mut model.reconstruction
        && context.source != FeatureOrigin::WithoutImages
    {
        colour(reconstruction, context.frames, context.progress)?;
    }
    Ok((model, Vec::new()))
}
