//! A textured convex object on the ground, ray-traced: photos whose cameras are known exactly.

use super::texture::colour;
use super::{orbit_pose, posed_images};
use crate::{Camera, Pose, Reconstruction};
use glam::{DVec2, DVec3};
use image::{GrayImage, Luma, Rgb, RgbImage};
use rayon::prelude::*;

/// Half sides of the object, scene units: a block whose corners a sphere cuts off. Source: chosen
/// by hand, never measured.
const HALF: DVec3 = DVec3::new(0.9, 0.65, 0.5);
/// Radius of that sphere, scene units. Source: chosen by hand, never measured.
const CORNER_RADIUS: f64 = 1.05;
/// The ground is a disc of this radius under the object, scene units. Source: chosen by hand, never
/// measured.
const GROUND_RADIUS: f64 = 2.5;
/// Samples along each side of a pixel. Source: chosen by hand, never measured.
const SAMPLES: usize = 2;

/// The object, with or without its ground. The texture is solid and dull (no highlights), so pixels
/// of one surface point look alike in all views.
#[derive(Clone, Debug, PartialEq)]
pub struct TexturedScene {
    /// Scene units a unit of the object (its radius is about 1).
    pub unit: f64,
    /// Whether it stands on a textured disc; otherwise nothing but the object is before the
    /// background.
    pub ground: bool,
    /// Half the side of a textured room about it, scene units of the object; then its floor is the
    /// ground.
    pub room: Option<f64>,
    /// Colour where no ray hits, sRGB.
    pub background: [u8; 3],
    /// Another seed is another texture.
    pub seed: u32,
}

impl Default for TexturedScene {
    fn default() -> Self {
        Self { unit: 1.0, ground: true, room: None, background: [90, 110, 140], seed: 1 }
    }
}

enum Hit {
    Object(DVec3, DVec3),
    Ground(DVec3),
    Wall(DVec3),
    Nothing,
    /// The lens shows nothing there.
    Unseen,
}

impl TexturedScene {
    /// The photo a camera takes; 4 rays a pixel, through the camera's distortion.
    pub fn render(&self, camera: &Camera, pose: &Pose) -> RgbImage {
        self.render_through((camera.width, camera.height), |pixel| Some(camera.ray(pixel)), pose)
    }

    /// The photo that any lens takes, of this size; 4 rays a pixel. `ray`: direction of a pixel,
    /// camera frame, unit; `None` where the lens shows nothing (black).
    pub fn render_through(
        &self,
        size: (u32, u32),
        ray: impl Fn(DVec2) -> Option<DVec3> + Sync,
        pose: &Pose,
    ) -> RgbImage {
        let background = self.background.map(|v| linear(f64::from(v) / 255.0));
        let mut image = RgbImage::new(size.0, size.1);
        let samples = image.as_flat_samples_mut().samples;
        trace(
            |pixel| self.hit_by(pose, ray(pixel)),
            size.0,
            samples,
            3,
            |hits, out| {
                let sum = hits.iter().map(|hit| match hit {
                    Hit::Object(x, n) => colour(*x, self.seed) * (0.65 + 0.35 * n.dot(LIGHT).max(0.0)),
                    Hit::Ground(x) => colour(*x, self.seed ^ 0xabcd) * 0.8,
                    Hit::Wall(x) => colour(*x, self.seed ^ 0x1234) * 0.9,
                    Hit::Nothing => DVec3::from_array(background),
                    Hit::Unseen => DVec3::ZERO,
                });
                let mean = sum.sum::<DVec3>() / hits.len() as f64;
                out.copy_from_slice(&Rgb(mean.to_array().map(|v| (srgb(v) * 255.0).round() as u8)).0);
            },
        );
        image
    }

    /// Coverage of the object in the photo: 255 = the pixel shows nothing else.
    pub fn render_mask(&self, camera: &Camera, pose: &Pose) -> GrayImage {
        let mut image = GrayImage::new(camera.width, camera.height);
        let samples = image.as_flat_samples_mut().samples;
        trace(
            |pixel| self.hit(camera, pose, pixel),
            camera.width,
            samples,
            1,
            |hits, out| {
                let inside = hits.iter().filter(|h| matches!(h, Hit::Object(..))).count();
                out.copy_from_slice(&Luma([(255 * inside / hits.len()) as u8]).0);
            },
        );
        image
    }

    /// Depth along the optical axis at a pixel, scene units; `None` where nothing is hit.
    pub fn depth(&self, camera: &Camera, pose: &Pose, pixel: DVec2) -> Option<f64> {
        match self.hit(camera, pose, pixel) {
            Hit::Object(x, _) | Hit::Ground(x) | Hit::Wall(x) => Some(pose.transform(x * self.unit).z),
            Hit::Nothing | Hit::Unseen => None,
        }
    }

    /// What a pixel sees, in object units.
    fn hit(&self, camera: &Camera, pose: &Pose, pixel: DVec2) -> Hit {
        self.hit_by(pose, Some(camera.ray(pixel)))
    }

    /// What a ray of the camera frame hits.
    fn hit_by(&self, pose: &Pose, ray: Option<DVec3>) -> Hit {
        let Some(ray) = ray else { return Hit::Unseen };
        let eye = pose.centre() / self.unit;
        let ray = pose.rotation.conjugate() * ray;
        if let Some((t, n)) = hit_object(eye, ray) {
            return Hit::Object(eye + t * ray, n);
        }
        let t = (-HALF.z - eye.z) / ray.z;
        let x = eye + t * ray;
        let is_floor = self.room.is_some_and(|half| x.truncate().abs().max_element() < half);
        if t > 0.0 && (is_floor || (self.ground && x.truncate().length() < GROUND_RADIUS)) {
            return Hit::Ground(x);
        }
        self.room.map_or(Hit::Nothing, |half| Hit::Wall(eye + leaving(eye, ray, half) * ray))
    }
}

/// Calls `shade` for every pixel with what the rays through it hit.
fn trace(
    look: impl Fn(DVec2) -> Hit + Sync,
    width: u32,
    out: &mut [u8],
    channels: usize,
    shade: impl Fn(&[Hit], &mut [u8]) + Sync,
) {
    out.par_chunks_exact_mut(width as usize * channels).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
            let hits: [Hit; SAMPLES * SAMPLES] = std::array::from_fn(|s| {
                let inside =
                    DVec2::new((s % SAMPLES) as f64 + 0.5, (s / SAMPLES) as f64 + 0.5) / SAMPLES as f64;
                look(DVec2::new(x as f64, y as f64) + inside)
            });
            shade(&hits, pixel);
        }
    });
}

/// How far a ray from inside a cube about the origin goes until it leaves it.
fn leaving(eye: DVec3, ray: DVec3, half: f64) -> f64 {
    let far = [0, 1, 2].map(|axis| (half.copysign(ray[axis]) - eye[axis]) / ray[axis]);
    far.into_iter().filter(|t| t.is_finite()).fold(f64::INFINITY, f64::min)
}

/// Direction towards the light, unit length. Source: chosen by hand, never measured.
const LIGHT: DVec3 = DVec3::new(0.36, 0.48, 0.8);

/// First intersection with the block cut by the sphere, and the normal there.
fn hit_object(eye: DVec3, ray: DVec3) -> Option<(f64, DVec3)> {
    let b = eye.dot(ray);
    let root = (b * b - eye.length_squared() + CORNER_RADIUS * CORNER_RADIUS).max(-1.0);
    if root <= 0.0 {
        return None;
    }
    let (mut near, mut far) = (-b - root.sqrt(), -b + root.sqrt());
    let mut normal = (eye + near * ray) / CORNER_RADIUS;
    for axis in 0..3 {
        let (a, c) = ((-HALF[axis] - eye[axis]) / ray[axis], (HALF[axis] - eye[axis]) / ray[axis]);
        if ray[axis] == 0.0 {
            if eye[axis].abs() > HALF[axis] {
                return None;
            }
            continue;
        }
        if a.min(c) > near {
            near = a.min(c);
            normal = DVec3::ZERO;
            normal[axis] = -ray[axis].signum();
        }
        far = far.min(a.max(c));
    }
    (near > 0.0 && near < far).then_some((near, normal))
}

/// sRGB value of linear light, both in [0, 1].
fn srgb(v: f64) -> f64 {
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.min(1.0).powf(1.0 / 2.4) - 0.055 }
}

fn linear(v: f64) -> f64 {
    if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// `n` photos from a circle, `step_deg` apart, 25° above the ground and 4 units away, with the true
/// cameras (images `view_000.png` …, in the order of the photos; no points).
pub fn photo_ring(
    scene: &TexturedScene,
    camera: &Camera,
    n: usize,
    step_deg: f64,
) -> (Vec<RgbImage>, Reconstruction) {
    let elevation = 25_f64.to_radians();
    let angles = (0..n).map(|i| (i as f64 * step_deg).to_radians());
    let poses: Vec<Pose> = angles.map(|a| orbit_pose(a, elevation, 4.0 * scene.unit)).collect();
    let photos = poses.iter().map(|pose| scene.render(camera, pose)).collect();
    (photos, posed_images(camera, &poses))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CameraModel;
    use crate::synthetic::default_camera;

    #[test]
    fn a_surface_point_has_the_same_colour_in_two_views() {
        let camera = default_camera(CameraModel::SimplePinhole, 160, 120);
        let scene = TexturedScene::default();
        let (photos, model) = photo_ring(&scene, &camera, 2, 5.0);
        let (a, b) = (model.images[&1].pose, model.images[&2].pose);
        let mut differences = Vec::new();
        for y in 10..110 {
            for x in 10..150 {
                let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
                let Some(depth) = scene.depth(&camera, &a, pixel) else { continue };
                let world = a.inverse().transform(camera.unproject(pixel).extend(1.0) * depth);
                let Some(q) = camera.project(b.transform(world)) else { continue };
                let (qx, qy) = (q.x.floor(), q.y.floor());
                if !(0.0..160.0).contains(&qx) || !(0.0..120.0).contains(&qy) {
                    continue;
                }
                let (p, q) = (photos[0].get_pixel(x, y), photos[1].get_pixel(qx as u32, qy as u32));
                differences.push(p.0[1].abs_diff(q.0[1]));
            }
        }
        differences.sort_unstable();
        assert!(
            differences.len() > 8000 && differences[differences.len() / 2] < 20,
            "{}",
            differences[differences.len() / 2]
        );
        let spread = photos[0].pixels().map(|p| p.0[1]).max().unwrap();
        assert!(spread > 150, "the texture has contrast");
    }

    #[test]
    fn the_mask_covers_the_object_and_units_do_not_matter() {
        let camera = default_camera(CameraModel::Radial, 80, 60);
        let small = TexturedScene { unit: 1e-6, ground: false, ..Default::default() };
        let big = TexturedScene { unit: 1e6, ..small.clone() };
        let (a, model) = photo_ring(&small, &camera, 1, 10.0);
        let (b, _) = photo_ring(&big, &camera, 1, 10.0);
        let differing = a[0].iter().zip(b[0].iter()).filter(|(p, q)| p.abs_diff(**q) > 1).count();
        assert!(differing < 10, "{differing}");
        let mask = small.render_mask(&camera, &model.images[&1].pose);
        let covered = mask.iter().filter(|&&v| v == 255).count();
        assert!(covered > 400 && covered < 2400, "{covered}");
        assert_eq!(a[0].get_pixel(0, 0).0, small.background);
    }
}
