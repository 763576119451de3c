//! Images that were turned on their way here are turned back for the solver, and the model is turned again for them.

use crate::incremental::state::{Input, State};
use crate::model_selection::rotated_images::{turn_camera, turn_geometry, turn_pixel, turn_pose};
use crate::reconstruct::Solved;
use glam::DVec2;
use scene::{Camera, TwoViewGeometry};

/// Keypoints and verified pairs of the images the way up that the sensor was.
pub(crate) fn inputs(
    input: &Input<'_>,
    cameras: &[Camera],
    turned: &[bool],
) -> (Vec<Vec<DVec2>>, Vec<TwoViewGeometry>) {
    let camera = |image: usize| &cameras[input.camera_of[image]];
    let mut geometries = input.geometries.to_vec();
    for g in geometries.iter_mut().filter(|g| turned[g.a] || turned[g.b]) {
        turn_geometry(g, [camera(g.a), camera(g.b)], [turned[g.a], turned[g.b]]);
    }
    (keypoints(input, cameras, turned), geometries)
}

/// Keypoints with those of turned images turned.
pub(crate) fn keypoints(input: &Input<'_>, cameras: &[Camera], turned: &[bool]) -> Vec<Vec<DVec2>> {
    let mut keypoints = input.keypoints.to_vec();
    for (image, points) in keypoints.iter_mut().enumerate().filter(|(i, _)| turned[*i]) {
        points.iter_mut().for_each(|p| *p = turn_pixel(&cameras[input.camera_of[image]], *p));
    }
    keypoints
}

/// Turns the poses of the turned images.
pub(crate) fn poses(state: &mut State, turned: &[bool]) {
    for (pose, _) in state.poses.iter_mut().zip(turned).filter(|(_, t)| **t) {
        *pose = pose.as_ref().map(turn_pose);
    }
}

/// Gives turned images their own camera with the mirrored principal point, and the pose that fits the image as it is.
pub(crate) fn back(solved: &mut Solved, turned: &[bool]) {
    poses(&mut solved.state, turned);
    let shared = solved.state.cameras.len();
    for camera in 0..shared {
        let mut of_turned = None;
        for (_, of_image) in turned.iter().zip(&mut solved.camera_of).filter(|(t, c)| **t && **c == camera) {
            let cameras = &mut solved.state.cameras;
            let index = *of_turned.get_or_insert_with(|| {
                let number = cameras.len() as u32 + 1;
                let mirrored = Camera { id: number, ..turn_camera(&cameras[camera]) };
                cameras.push(mirrored);
                cameras.len() - 1
            });
            *of_image = index;
        }
        let of_cameras = solved.uncertainty.as_mut().map(|u| &mut u.cameras);
        if let (Some(index), Some(deviations)) = (of_turned, of_cameras) {
            let ids = [camera, index].map(|i| solved.state.cameras[i].id);
            if let Some(same) = deviations.get(&ids[0]).cloned() {
                deviations.insert(ids[1], same);
            }
        }
    }
}
