//! What photos show of each Gaussian, and how the surface lies there.

use crate::colour::linear;
use crate::solid::SolidSplat;
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use scene::{Camera, Cancelled, Pose, PosedPhoto, Progress};

/// When a Gaussian is the surface that a view sees.
struct SurfaceLimits {
    /// Its depth is that of the surface but for this share. Source: chosen by hand on case 4.
    same: f64,
    /// Depths around a pixel that differ by more than this share are no one surface. Source:
    /// chosen by hand, never measured.
    jump: f64,
    /// Normals come from pixels so far apart. Source: chosen by hand, never measured.
    apart: i64,
    /// A normal more aslant to its ray says nothing: cosine. Source: docs/decisions/16, rounded.
    least_cosine: f64,
}

/// The values in force.
const LIMITS: SurfaceLimits = SurfaceLimits { same: 0.02, jump: 0.03, apart: 2, least_cosine: 0.1 };

/// A Gaussian in a photo.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Appearance {
    /// Which photo.
    pub(crate) view: u32,
    /// Linear light, 0 to 1; 1 where the photo is clipped.
    pub(crate) rgb: [f32; 3],
}

/// From here a channel of a photo is clipped, linear light: 250 of 255. Source: derived.
const CLIPPED: f32 = 0.956;

impl Appearance {
    /// Whether some channel only says "at least white".
    pub(crate) fn is_clipped(&self) -> bool {
        self.rgb.iter().any(|v| *v >= CLIPPED)
    }
}

/// Of every Gaussian's two sides: a sheet shows a lit and a shaded one. Side `2 i` of Gaussian `i`
/// is the one its normal points from, `2 i + 1` the other.
#[derive(Clone, Debug)]
pub(crate) struct SeenSurface {
    pub(crate) seen: Vec<Vec<Appearance>>,
    /// By Gaussian, world frame, unit; zero where no view tells.
    normal: Vec<DVec3>,
}

impl SeenSurface {
    pub(crate) fn of(
        solid: &SolidSplat,
        photos: &[PosedPhoto],
        progress: &Progress,
    ) -> Result<Self, Cancelled> {
        let count = solid.gaussians.len();
        let mut seen: Vec<Vec<Appearance>> = vec![Vec::new(); count];
        let mut normal = vec![DVec3::ZERO; count];
        progress.begin("light on the surface", photos.len());
        for (view, photo) in photos.iter().enumerate() {
            let map = PhotoDepth { photo, depth: solid.depth(photo.camera, &photo.pose) };
            let met = (0..count).into_par_iter().filter_map(|i| Some((i, map.meets(solid.place(i))?)));
            for (i, pixel) in met.collect::<Vec<_>>() {
                seen[i].push(Appearance { view: view as u32, rgb: map.colour(pixel) });
                let towards_eye = map.normal(pixel).unwrap_or_default();
                let sign = if towards_eye.dot(normal[i]) < 0.0 { -1.0 } else { 1.0 };
                normal[i] += sign * towards_eye;
            }
            progress.tick()?;
        }
        normal.iter_mut().for_each(|n| *n = n.normalize_or_zero());
        let eyes: Vec<DVec3> = photos.iter().map(|p| p.pose.centre()).collect();
        let sides = seen.into_par_iter().enumerate().flat_map_iter(|(i, seen)| {
            let before = |s: &Appearance| normal[i].dot(eyes[s.view as usize] - solid.place(i)) >= 0.0;
            let (front, back): (Vec<_>, Vec<_>) = seen.into_iter().partition(before);
            [front, back]
        });
        Ok(Self { seen: sides.collect(), normal })
    }

    /// Outwards, world frame, unit; zero where no view tells.
    pub(crate) fn normal(&self, side: usize) -> DVec3 {
        if side.is_multiple_of(2) { self.normal[side / 2] } else { -self.normal[side / 2] }
    }

    /// The side of a Gaussian that an eye sees.
    pub(crate) fn side(&self, i: usize, place: DVec3, eye: DVec3) -> usize {
        2 * i + usize::from(self.normal[i].dot(eye - place) < 0.0)
    }
}

struct PhotoDepth<'a> {
    photo: &'a PosedPhoto<'a>,
    depth: Vec<Option<f64>>,
}

impl PhotoDepth<'_> {
    fn camera(&self) -> &Camera {
        self.photo.camera
    }

    fn pose(&self) -> &Pose {
        &self.photo.pose
    }

    fn index(&self, [x, y]: [i64; 2]) -> Option<usize> {
        let [w, h] = [self.camera().width, self.camera().height].map(i64::from);
        ((0..w).contains(&x) && (0..h).contains(&y)).then_some((y * w + x) as usize)
    }

    /// The pixel in which a place is the surface.
    fn meets(&self, place: DVec3) -> Option<[i64; 2]> {
        let p = self.pose().transform(place);
        let pixel = self.camera().project(p).filter(|_| p.z > 0.0)?;
        let pixel = [pixel.x.floor() as i64, pixel.y.floor() as i64];
        let i = self.index(pixel)?;
        let is_object = self.photo.mask.is_none_or(|m| m[i] > u8::MAX / 2);
        let z = self.depth[i].filter(|_| is_object)?;
        ((p.z / z - 1.0).abs() < LIMITS.same).then_some(pixel)
    }

    fn colour(&self, pixel: [i64; 2]) -> [f32; 3] {
        let i = self.index(pixel).unwrap_or_default();
        [0, 1, 2].map(|c| linear(f64::from(self.photo.rgb[3 * i + c]) / 255.0) as f32)
    }

    /// Towards the eye, world frame; the longer the less aslant.
    fn normal(&self, [x, y]: [i64; 2]) -> Option<DVec3> {
        let here = self.depth[self.index([x, y])?]?;
        let a = LIMITS.apart;
        let [right, left] = [self.point([x + a, y], here)?, self.point([x - a, y], here)?];
        let [below, above] = [self.point([x, y + a], here)?, self.point([x, y - a], here)?];
        let normal = (below - above).cross(right - left).normalize_or_zero();
        let cosine = -normal.dot((right + left + below + above).normalize_or_zero());
        (cosine > LIMITS.least_cosine).then(|| self.pose().rotation.inverse() * normal * cosine)
    }

    /// What a pixel sees, camera frame, where it is of the same surface.
    fn point(&self, [x, y]: [i64; 2], here: f64) -> Option<DVec3> {
        let z = self.depth[self.index([x, y])?].filter(|z| (z / here - 1.0).abs() < LIMITS.jump)?;
        let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
        Some(self.camera().unproject(pixel).extend(1.0) * z)
    }
}
