//! Depths of a view.

use crate::{Camera, Pose};
use glam::{DVec2, DVec3};
use std::borrow::Cow;

/// What a camera without distortion measured.
#[derive(Clone, Debug)]
pub struct DepthMap<'a> {
    /// Of the map's size.
    pub camera: Camera,
    /// `cam_from_world`.
    pub pose: Pose,
    /// [height × width] camera z, scene units; infinite where the ray meets nothing, −∞ where it
    /// probably does not (beside what it could have met); anything else that is not a positive
    /// number is unknown.
    pub depth: Vec<f32>,
    /// [height × width] pixels to the outline of a part that is too thin for depths to tell its
    /// sides apart, negative inside it; NaN elsewhere. Empty where there are none.
    pub outline: Vec<f32>,
    /// [height × width × 3] sRGB.
    pub rgb: Cow<'a, [u8]>,
}

impl DepthMap<'_> {
    /// The point measured at pixel `i`, world frame.
    pub fn point(&self, i: usize, world_from_cam: &Pose) -> Option<DVec3> {
        let z = f64::from(self.depth[i]);
        (z > 0.0 && z.is_finite()).then(|| unprojected(&self.camera, i, z, world_from_cam))
    }
}

/// The points of a depth map, world frame.
pub fn points_of(depth: &[Option<f64>], camera: &Camera, pose: &Pose) -> Vec<DVec3> {
    let world_from_cam = pose.inverse();
    let seen = depth.iter().enumerate().filter_map(|(i, z)| Some((i, (*z)?)));
    seen.map(|(i, z)| unprojected(camera, i, z, &world_from_cam)).collect()
}

/// Where pixel `i` of a camera without distortion is at a depth, world frame.
fn unprojected(camera: &Camera, i: usize, z: f64, world_from_cam: &Pose) -> DVec3 {
    let width = camera.width as usize;
    let pixel = DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
    let ray = (pixel - camera.principal_point()) / camera.focal();
    world_from_cam.transform(ray.extend(1.0) * z)
}
