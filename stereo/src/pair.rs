//! Two views: from pixels and depths of one to pixels of the other.

use crate::level::LevelImage;
use glam::{DMat3, DVec3};
use scene::{Camera, Pose};

/// A neighbour of a view. Pixels (0, 0) is the picture's corner; depths are in scene units.
#[derive(Clone, Debug)]
pub(crate) struct Pair {
    /// Which view the neighbour is.
    pub(crate) view: usize,
    /// `K' R K⁻¹` and `K' t`: `z' p' = z A p + b`, by rows.
    pub(crate) there: PixelMap,
    /// The same back.
    pub(crate) back: PixelMap,
}

/// `z' (x', y', 1) = z A (x, y, 1) + b`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PixelMap {
    pub(crate) a: [f32; 9],
    pub(crate) b: [f32; 3],
}

impl Pair {
    /// From one view (image and pose) to another.
    pub(crate) fn new(view: usize, from: (&LevelImage, &Pose), to: (&LevelImage, &Pose)) -> Self {
        let relative = to.1.compose(&from.1.inverse());
        Self {
            view,
            there: PixelMap::new(&from.0.camera, &to.0.camera, &relative),
            back: PixelMap::new(&to.0.camera, &from.0.camera, &relative.inverse()),
        }
    }
}

impl PixelMap {
    pub(crate) fn new(from: &Camera, to: &Camera, to_from_from: &Pose) -> Self {
        let k = intrinsics(to);
        let a = (k * to_from_from.matrix() * intrinsics(from).inverse()).transpose();
        let b = k * to_from_from.translation;
        let a = a.to_cols_array().map(|v| v as f32);
        Self { a, b: b.as_vec3().to_array() }
    }

    /// Pixel and depth of a pixel at a depth.
    #[inline(always)]
    pub(crate) fn apply(&self, [x, y]: [f32; 2], z: f32) -> ([f32; 2], f32) {
        let (a, b) = (&self.a, &self.b);
        let depth = z * (a[6] * x + a[7] * y + a[8]) + b[2];
        let inverse = 1.0 / depth;
        let u = (z * (a[0] * x + a[1] * y + a[2]) + b[0]) * inverse;
        let v = (z * (a[3] * x + a[4] * y + a[5]) + b[1]) * inverse;
        ([u, v], depth)
    }
}

fn intrinsics(camera: &Camera) -> DMat3 {
    let (f, c) = (camera.focal(), camera.principal_point());
    DMat3::from_cols(DVec3::new(f.x, 0.0, 0.0), DVec3::new(0.0, f.y, 0.0), DVec3::new(c.x, c.y, 1.0))
}
