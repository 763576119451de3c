//! What changes where an image is rotated by 180°: pixels, poses, cameras and pairs.

use crate::bundle::BundleProblem;
use glam::{DMat3, DQuat, DVec2, DVec3};
use scene::{Camera, CameraModel, Pose, TwoViewGeometry};

/// A pixel of the rotated image.
pub(crate) fn rotate_pixel(camera: &Camera, pixel: DVec2) -> DVec2 {
    DVec2::new(f64::from(camera.width), f64::from(camera.height)) - pixel
}

/// The pose of the rotated camera.
pub(crate) fn rotate_pose(pose: &Pose) -> Pose {
    let turn = DQuat::from_xyzw(0.0, 0.0, 1.0, 0.0);
    Pose { rotation: (turn * pose.rotation).normalize(), translation: turn * pose.translation }
}

/// The camera of the rotated image: principal point mirrored, tangential distortion of the other
/// sign.
pub(crate) fn rotate_camera(camera: &Camera) -> Camera {
    let mut rotated = camera.clone();
    let n = camera.model.num_focals();
    let p = rotate_pixel(camera, camera.principal_point());
    rotated.params[n..n + 2].copy_from_slice(&p.to_array());
    if camera.model == CameraModel::Opencv {
        rotated.params[n + 4..].iter_mut().for_each(|p| *p = -*p);
    }
    rotated
}

/// The geometry of a pair of which the first, the second or both images are rotated.
pub(crate) fn rotate_geometry(geometry: &mut TwoViewGeometry, cameras: [&Camera; 2], rotated: [bool; 2]) {
    // Each of these matrices is its own inverse.
    let (mut pixels, mut rays) = ([DMat3::IDENTITY; 2], [DMat3::IDENTITY; 2]);
    for i in (0..2).filter(|&i| rotated[i]) {
        let (w, h) = (f64::from(cameras[i].width), f64::from(cameras[i].height));
        pixels[i] = DMat3::from_cols(-DVec3::X, -DVec3::Y, DVec3::new(w, h, 1.0));
        rays[i] = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));
    }
    geometry.f = geometry.f.map(|f| pixels[1].transpose() * f * pixels[0]);
    geometry.h = geometry.h.map(|h| pixels[1] * h * pixels[0]);
    geometry.e = geometry.e.map(|e| rays[1] * e * rays[0]);
    geometry.b_from_a = geometry.b_from_a.map(|pose| {
        let own = if rotated[1] { rotate_pose(&pose) } else { pose };
        let before = if rotated[0] { rotate_pose(&Pose::IDENTITY) } else { Pose::IDENTITY };
        own.compose(&before)
    });
}

/// The same adjustment with some images rotated.
pub(crate) fn rotate_problem(problem: &BundleProblem, rotated: &[bool]) -> BundleProblem {
    let mut result = problem.clone();
    for (pose, _) in result.poses.iter_mut().zip(rotated).filter(|(_, t)| **t) {
        *pose = rotate_pose(pose);
    }
    for o in result.observations.iter_mut().filter(|o| rotated[o.pose as usize]) {
        let camera = &problem.cameras[problem.pose_camera[o.pose as usize] as usize];
        o.pixel = rotate_pixel(camera, o.pixel);
    }
    result
}
