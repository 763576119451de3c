//! Exact synthetic scenes for tests and benches: points and keypoints with known correspondences,
//! and a small ray-traced object with real pixels.

mod photos;
mod points;
mod texture;

pub use photos::{TexturedScene, photo_ring};
pub use points::{CameraPath, SceneShape, SyntheticOptions, SyntheticScene, synthetic_scene};

use crate::rng::Rng;
use crate::{Camera, CameraModel, Pose, PosedImage, Reconstruction};
use glam::DVec3;
use rand::Rng as _;

/// A normally distributed number with mean 0 and standard deviation 1 (Box and Muller 1958).
pub(crate) fn normal(r: &mut Rng) -> f64 {
    let u: f64 = 1.0 - r.random::<f64>(); // (0, 1]
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * r.random::<f64>()).cos()
}

/// A direction, uniform on the sphere.
pub(crate) fn direction(r: &mut Rng) -> DVec3 {
    let z: f64 = r.random_range(-1.0..1.0);
    let angle = r.random_range(0.0..std::f64::consts::TAU);
    let s = (1.0 - z * z).sqrt();
    DVec3::new(s * angle.cos(), s * angle.sin(), z)
}

/// Pose of a camera on a circle about the z axis, looking at the origin: `azimuth` and `elevation`
/// in radians.
pub fn orbit_pose(azimuth: f64, elevation: f64, distance: f64) -> Pose {
    let (s, c) = azimuth.sin_cos();
    let eye = DVec3::new(c * elevation.cos(), s * elevation.cos(), elevation.sin()) * distance;
    Pose::look_at(eye, DVec3::ZERO, DVec3::Z)
}

/// The camera all synthetic scenes share: focal length 1.2 image widths, principal point at the
/// centre.
pub fn default_camera(model: CameraModel, width: u32, height: u32) -> Camera {
    Camera::centred(1, model, width, height, 1.2 * f64::from(width.max(height)))
}

/// A reconstruction of cameras without points, images named `view_000.png` and so on.
pub fn posed_images(camera: &Camera, poses: &[Pose]) -> Reconstruction {
    let mut model = Reconstruction::default();
    model.cameras.insert(camera.id, camera.clone());
    for (i, pose) in poses.iter().enumerate() {
        let id = i as u32 + 1;
        let name = format!("view_{i:03}.png");
        model
            .images
            .insert(id, PosedImage { id, camera: camera.id, name, pose: *pose, observations: Vec::new() });
    }
    model
}
