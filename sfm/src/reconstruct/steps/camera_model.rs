//! The camera model by evidence, and which photos were rotated by 180° on their way here. From this
//! step on the solver sees every image the way up that its sensor was.

use crate::incremental::finish::{decide, take_decided};
use crate::incremental::growth::starts_of;
use crate::model_selection::rotated_images::{rotate_camera, rotate_geometry, rotate_pixel, rotate_pose};
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};
use scene::Camera;

/// Decides, and takes over the part of the model that was adjusted for it.
pub(super) fn choose_camera_model(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    model.starts = starts_of(&model.setup.cameras, &model.setup.known, &model.state);
    let named = context.config.camera_model.model();
    let (known, starts) = (&model.setup.known, &model.starts);
    let verdict = decide(&model.state, &model.input(context), known, starts, named, context.progress)?;
    model.intrinsics = verdict.intrinsics;
    model.camera_decisions = verdict.decisions;
    if let Some(rotated) = verdict.rotated {
        // Poses of which some are rotated by 180° are on no circle.
        model.on_ring = false;
        model.rotated = rotated;
        rotate_inputs(&mut model);
    }
    let mut state = std::mem::take(&mut model.state);
    if model.on_ring {
        state.cameras.clone_from(&verdict.adjusted.problem.cameras);
    } else {
        take_decided(&mut state, &model.input(context), &verdict.adjusted);
    }
    model.state = state;
    Ok((model, Vec::new()))
}

/// Makes keypoints and verified pairs those of the images the way up that the sensor was.
fn rotate_inputs(model: &mut SfmModel) {
    model.keep_verified();
    let (setup, rotated) = (&model.setup, &model.rotated);
    for g in model.geometries.iter_mut().filter(|g| rotated[g.a] || rotated[g.b]) {
        let cameras = [g.a, g.b].map(|image| &setup.cameras[setup.camera_of[image]]);
        rotate_geometry(g, cameras, [rotated[g.a], rotated[g.b]]);
    }
    rotate_keypoints(model);
}

fn rotate_keypoints(model: &mut SfmModel) {
    let setup = &model.setup;
    for (image, points) in model.keypoints.iter_mut().enumerate().filter(|(i, _)| model.rotated[*i]) {
        let camera = &setup.cameras[setup.camera_of[image]];
        points.iter_mut().for_each(|p| *p = rotate_pixel(camera, *p));
    }
}

/// Gives rotated images the keypoints and the pose that fit the image as it is, and their own
/// camera with the mirrored principal point.
pub(super) fn rotate_back(model: &mut SfmModel) {
    rotate_keypoints(model);
    for (pose, _) in model.state.poses.iter_mut().zip(&model.rotated).filter(|(_, rotated)| **rotated) {
        *pose = pose.as_ref().map(rotate_pose);
    }
    let shared = model.state.cameras.len();
    for camera in 0..shared {
        let images = 0..model.rotated.len();
        let own: Vec<usize> =
            images.filter(|&i| model.rotated[i] && model.setup.camera_of[i] == camera).collect();
        if own.is_empty() {
            continue;
        }
        let index = model.state.cameras.len();
        let id = index as u32 + 1;
        let mirrored = Camera { id, ..rotate_camera(&model.state.cameras[camera]) };
        model.state.cameras.push(mirrored);
        own.into_iter().for_each(|i| model.setup.camera_of[i] = index);
        let deviations = model.uncertainty.as_mut().map(|u| &mut u.cameras);
        if let Some(deviations) = deviations
            && let Some(same) = deviations.get(&model.state.cameras[camera].id).cloned()
        {
            deviations.insert(id, same);
        }
    }
}
