//! Images that were rotated on their way here are rotated back for the solver, and the model is rotated again for them.

use crate::incremental::state::{MapState, MappingInput};
use crate::model_selection::rotated_images::{rotate_camera, rotate_geometry, rotate_pixel, rotate_pose};
use crate::reconstruct::SolvedModel;
use glam::DVec2;
use scene::{Camera, TwoViewGeometry};

/// Keypoints and verified pairs of the images the way up that the sensor was.
pub(crate) fn rotate_inputs(
    input: &MappingInput<'_>,
    cameras: &[Camera],
    rotated: &[bool],
) -> (Vec<Vec<DVec2>>, Vec<TwoViewGeometry>) {
    let camera = |image: usize| &cameras[input.camera_of[image]];
    let mut geometries = input.geometries.to_vec();
    for g in geometries.iter_mut().filter(|g| rotated[g.a] || rotated[g.b]) {
        rotate_geometry(g, [camera(g.a), camera(g.b)], [rotated[g.a], rotated[g.b]]);
    }
    (rotate_keypoints(input, cameras, rotated), geometries)
}

/// Keypoints with those of rotated images rotated.
pub(crate) fn rotate_keypoints(
    input: &MappingInput<'_>,
    cameras: &[Camera],
    rotated: &[bool],
) -> Vec<Vec<DVec2>> {
    let mut keypoints = input.keypoints.to_vec();
    for (image, points) in keypoints.iter_mut().enumerate().filter(|(i, _)| rotated[*i]) {
        points.iter_mut().for_each(|p| *p = rotate_pixel(&cameras[input.camera_of[image]], *p));
    }
    keypoints
}

/// Rotates the poses of the rotated images.
pub(crate) fn rotate_poses(state: &mut MapState, rotated: &[bool]) {
    for (pose, _) in state.poses.iter_mut().zip(rotated).filter(|(_, t)| **t) {
        *pose = pose.as_ref().map(rotate_pose);
    }
}

/// Gives rotated images their own camera with the mirrored principal point, and the pose that fits the image as it is.
pub(crate) fn rotate_back(solved: &mut SolvedModel, rotated: &[bool]) {
    rotate_poses(&mut solved.state, rotated);
    let shared = solved.state.cameras.len();
    for camera in 0..shared {
        let mut of_rotated = None;
        for (_, of_image) in rotated.iter().zip(&mut solved.camera_of).filter(|(t, c)| **t && **c == camera) {
            let cameras = &mut solved.state.cameras;
            let index = *of_rotated.get_or_insert_with(|| {
                let number = cameras.len() as u32 + 1;
                let mirrored = Camera { id: number, ..rotate_camera(&cameras[camera]) };
                cameras.push(mirrored);
                cameras.len() - 1
            });
            *of_image = index;
        }
        let of_cameras = solved.uncertainty.as_mut().map(|u| &mut u.cameras);
        if let (Some(index), Some(deviations)) = (of_rotated, of_cameras) {
            let ids = [camera, index].map(|i| solved.state.cameras[i].id);
            if let Some(same) = deviations.get(&ids[0]).cloned() {
                deviations.insert(ids[1], same);
            }
        }
    }
}
