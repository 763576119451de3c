//! Images that were rotated on their way here are rotated back for the solver, and the model is
//! rotated again for them.

use crate::model_selection::rotated_images::{rotate_camera, rotate_geometry, rotate_pixel, rotate_pose};
use crate::reconstruct::model::SfmModel;
use scene::Camera;

/// Makes keypoints and verified pairs those of the images the way up that the sensor was.
pub(super) fn rotate_inputs(model: &mut SfmModel) {
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
