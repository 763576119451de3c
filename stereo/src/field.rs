//! The planes of a view's pixels.

use crate::level::LevelImage;
use glam::{DVec2, DVec3, Vec3};
use scene::Camera;

/// The nearest normal that 16 bits a component can tell: what is kept is what was returned.
pub(crate) fn rounded(normal: Vec3) -> Vec3 {
    from_steps(to_steps(normal))
}

pub(crate) fn to_steps(normal: Vec3) -> [i16; 3] {
    normal.to_array().map(|v| (v * f32::from(i16::MAX)).round() as i16)
}

pub(crate) fn from_steps(steps: [i16; 3]) -> Vec3 {
    Vec3::from(steps.map(|v| f32::from(v) / f32::from(i16::MAX)))
}

/// What a view's pixels see. Only the rectangle around the object is kept.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaneField {
    /// The camera, of the field's resolution.
    pub camera: Camera,
    /// First column and row that are kept.
    pub corner: [usize; 2],
    /// Columns that are kept.
    pub width: usize,
    /// [rows × width] camera z, scene units; 0 where nothing is known.
    pub depth: Vec<f32>,
    /// [rows × width] unit normals towards the camera, camera frame, to 1/32,767 a component.
    pub normal: Vec<Vec3>,
    /// [rows × width] one minus the correlation, 0 to 2: the mean over the views that count.
    pub cost: Vec<f32>,
    /// [rows × width] how many other views agree.
    pub agreeing: Vec<u8>,
    /// Which pixels are the object's.
    pub(crate) inside: Vec<bool>,
    lens: PinholeLens,
}

impl PlaneField {
    /// At the place of an image's object: the planes of half the resolution, or nothing.
    pub(crate) fn start(image: &LevelImage, coarser: Option<&Self>) -> Self {
        let [left, top, right, bottom] = image.frame;
        let (width, height) = (right - left, bottom - top);
        let n = width * height;
        let mut field = Self {
            camera: image.camera.clone(),
            corner: [left, top],
            width,
            lens: PinholeLens::of(&image.camera),
            depth: vec![0.0; n],
            normal: vec![Vec3::NEG_Z; n],
            cost: vec![f32::MAX; n],
            agreeing: vec![0; n],
            inside: (0..n)
                .map(|i| image.inside[(top + i / width.max(1)) * image.width + left + i % width.max(1)])
                .collect(),
        };
        if let Some(coarser) = coarser {
            field.take_from(coarser);
        }
        field
    }

    /// The planes of a field of the same pixels and their costs. They are copied, as memory that
    /// is freed between others is lost for what is a little longer.
    pub(crate) fn take_planes(&mut self, next: &Self) {
        self.depth.copy_from_slice(&next.depth);
        self.normal.copy_from_slice(&next.normal);
        self.cost.copy_from_slice(&next.cost);
    }

    fn take_from(&mut self, coarser: &Self) {
        for i in (0..self.depth.len()).filter(|&i| self.inside[i]) {
            let (x, y) = self.place(i);
            let Some(j) = coarser.nearest(x / 2, y / 2) else { continue };
            let (cx, cy) = coarser.place(j);
            let (here, there) = (self.lens.ray(x, y), coarser.lens.ray(cx, cy));
            self.normal[i] = coarser.normal[j];
            self.depth[i] = carried(coarser.depth[j], coarser.normal[j], there, here);
        }
    }

    /// The index of a known pixel at a place of the whole picture or beside it.
    fn nearest(&self, x: usize, y: usize) -> Option<usize> {
        let near = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1)];
        near.iter().find_map(|&(dx, dy)| {
            let i = self.index(x as i64 + dx, y as i64 + dy)?;
            (self.depth[i] > 0.0).then_some(i)
        })
    }

    /// Column and row in the whole picture.
    pub fn place(&self, i: usize) -> (usize, usize) {
        (self.corner[0] + i % self.width, self.corner[1] + i / self.width)
    }

    /// The index of a place in the whole picture, where it is kept.
    pub(crate) fn index(&self, x: i64, y: i64) -> Option<usize> {
        let (x, y) = (x - self.corner[0] as i64, y - self.corner[1] as i64);
        let rows = self.depth.len() / self.width.max(1);
        let kept = (0..self.width as i64).contains(&x) && (0..rows as i64).contains(&y);
        kept.then(|| y as usize * self.width + x as usize)
    }

    /// The point that a pixel sees, camera frame.
    pub(crate) fn point(&self, i: usize) -> DVec3 {
        let (x, y) = self.place(i);
        let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
        let ray = (pixel - self.camera.principal_point()) / self.camera.focal();
        ray.extend(1.0) * f64::from(self.depth[i])
    }

    /// The depth of a pixel's plane at a place inside the pixel.
    #[inline]
    pub(crate) fn depth_along(&self, i: usize, [x, y]: [f32; 2]) -> f32 {
        let (column, row) = self.place(i);
        let here = self.lens.ray(column, row);
        let there = self.lens.ray_at(x, y);
        carried(self.depth[i], self.normal[i], here, there)
    }
}

/// The depth that a plane has along another ray; as it was where the ray does not meet it.
#[inline(always)]
pub(crate) fn carried(depth: f32, normal: Vec3, from: Vec3, to: Vec3) -> f32 {
    let ratio = normal.dot(from) / normal.dot(to);
    // A plane seen so much aslant tells nothing of a neighbour.
    if ratio > 0.5 && ratio < 2.0 { depth * ratio } else { depth }
}

/// A pinhole in single precision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PinholeLens {
    inverse_focal: [f32; 2],
    centre: [f32; 2],
}

impl PinholeLens {
    pub(crate) fn of(camera: &Camera) -> Self {
        let (f, c) = (camera.focal(), camera.principal_point());
        Self { inverse_focal: [1.0 / f.x as f32, 1.0 / f.y as f32], centre: [c.x as f32, c.y as f32] }
    }

    /// Through the middle of a pixel, z = 1.
    #[inline(always)]
    pub(crate) fn ray(&self, x: usize, y: usize) -> Vec3 {
        self.ray_at(x as f32 + 0.5, y as f32 + 0.5)
    }

    /// Through a place in the picture, z = 1.
    #[inline(always)]
    fn ray_at(&self, x: f32, y: f32) -> Vec3 {
        let [fx, fy] = self.inverse_focal;
        Vec3::new((x - self.centre[0]) * fx, (y - self.centre[1]) * fy, 1.0)
    }

    /// The normal whose [`row`](Self::row) this is, of any length.
    pub(crate) fn normal(&self, [a, b, c]: [f32; 3]) -> Vec3 {
        let [x, y] = self.centre;
        Vec3::new(a / self.inverse_focal[0], b / self.inverse_focal[1], a * x + b * y + c)
    }

    /// `nᵀ K⁻¹`: with it `n · ray(p) = row · (x, y, 1)`.
    #[inline(always)]
    pub(crate) fn row(&self, n: Vec3) -> [f32; 3] {
        let (a, b) = (n.x * self.inverse_focal[0], n.y * self.inverse_focal[1]);
        [a, b, n.z - a * self.centre[0] - b * self.centre[1]]
    }
}
