//! A plane as each image shows it, seen from straight above, and what they show in common.

use super::plane::ScenePlane;
use crate::klt::pyramid::{Pyramid, PyramidLevel};
use crate::statistics::median;
use glam::{DMat2, DVec2, DVec3};
use rayon::prelude::*;
use scene::{Camera, Pose};

/// Fewest images that a square of the common picture stands on.
/// Source: with three, a floor is found in images of noise alone.
const FEWEST: usize = 5;
/// Most squares of the sheet in all images together, four bytes each.
/// Source: derivation, 160 MB.
const MOST_OF_ALL: usize = 40_000_000;
/// Images that see a square so much more narrowly than the sheet shows it (area) leave it out.
/// Source: docs/decisions/11; a third and a half changed nothing or made it worse.
const NARROW: f64 = 0.1;

/// Squares of a plane, side by side.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sheet {
    pub plane: ScenePlane,
    /// Side of a square, world units.
    pub unit: f64,
    /// Squares along each side.
    pub side: usize,
}

/// The sheet as one image shows it; NaN where it does not. [side × side].
pub(crate) type SheetPicture = Vec<f32>;

impl Sheet {
    /// With squares about as large as a pixel of a typical camera sees; `None` where no camera
    /// looks at it.
    pub(crate) fn new<'a>(
        plane: ScenePlane,
        views: impl Iterator<Item = (&'a Camera, Pose)>,
    ) -> Option<Self> {
        let scales: Vec<f64> = views
            .filter_map(|(camera, pose)| shape(camera, &pose, plane.origin, plane.axes))
            .map(|m| m.determinant().abs().sqrt())
            .collect();
        if scales.is_empty() {
            return None;
        }
        let most = (MOST_OF_ALL / scales.len()).isqrt();
        let unit = (1.0 / median(scales)).max(2.0 * plane.reach / most as f64);
        let side = (2.0 * plane.reach / unit).ceil() as usize;
        (unit.is_finite() && unit > 0.0 && (1..=most + 1).contains(&side)).then_some(Self {
            plane,
            unit,
            side,
        })
    }

    /// Place of a position on the sheet, squares from its corner; the middles of squares are at
    /// halves.
    pub(crate) fn place(&self, at: DVec2) -> DVec3 {
        let d = (at - DVec2::splat(0.5 * self.side as f64)) * self.unit;
        self.plane.origin + self.plane.axes[0] * d.x + self.plane.axes[1] * d.y
    }

    /// Derivatives of an image position by the position on the sheet, pixels a square.
    pub(crate) fn shape(&self, camera: &Camera, pose: &Pose, at: DVec2) -> Option<DMat2> {
        shape(camera, pose, self.place(at), self.plane.axes.map(|a| a * self.unit))
    }

    /// The sheet as an image shows it.
    pub(crate) fn seen_by(&self, camera: &Camera, pose: &Pose, pyramid: &Pyramid) -> SheetPicture {
        let middle = DVec2::splat(0.5 * self.side as f64);
        let pixels = self.shape(camera, pose, middle).map_or(1.0, |m| m.determinant().abs().sqrt());
        let deepest = pyramid.levels.len() - 1;
        let depth = (pixels.max(1.0).log2().round() as usize).min(deepest);
        let (level, size) = (&pyramid.levels[depth], f64::from(1u32 << depth));
        // A square's area in the image is f² u² h / z³, h the height of the camera above the plane,
        // but for distortion.
        let height = self.plane.normal().dot(pose.centre() - self.plane.origin).abs();
        let farthest = ((camera.mean_focal() * self.unit).powi(2) * height / NARROW).cbrt();
        let widest = widest_tangent(camera);
        let across = pose.rotation * self.plane.axes[0] * self.unit;
        let mut picture = vec![f32::NAN; self.side * self.side];
        for (y, line) in picture.chunks_exact_mut(self.side).enumerate() {
            let first = pose.transform(self.place(DVec2::new(0.5, y as f64 + 0.5)));
            for (x, out) in line.iter_mut().enumerate() {
                let p = first + across * x as f64;
                let is_near = p.z > 0.0 && p.z < farthest;
                let is_seen = is_near && p.truncate().length_squared() <= widest * p.z * p.z;
                let pixel = if is_seen { camera.project(p) } else { None };
                *out = pixel.map_or(f32::NAN, |p| between(level, p / size));
            }
        }
        picture
    }

    /// What most images show of each square: the median. NaN where few show it.
    pub(crate) fn common(&self, pictures: &[Option<SheetPicture>]) -> SheetPicture {
        let rows = (0..self.side).into_par_iter().map(|y| self.common_row(pictures, y));
        rows.collect::<Vec<_>>().concat()
    }

    fn common_row(&self, pictures: &[Option<SheetPicture>], y: usize) -> Vec<f32> {
        let mut values = Vec::with_capacity(pictures.len());
        let mut row = Vec::with_capacity(self.side);
        for at in y * self.side..(y + 1) * self.side {
            values.clear();
            values.extend(pictures.iter().flatten().map(|p| p[at]).filter(|v| v.is_finite()));
            let middle = values.len() / 2;
            row.push(if values.len() < FEWEST {
                f32::NAN
            } else {
                *values.select_nth_unstable_by(middle, f32::total_cmp).1
            });
        }
        row
    }
}

/// Square of the largest tangent between a ray of the image and the optical axis. Farther out
/// distortion may turn round and bring into the image what it does not show.
fn widest_tangent(camera: &Camera) -> f64 {
    let (w, h) = (f64::from(camera.width), f64::from(camera.height));
    let corners = [DVec2::ZERO, DVec2::new(w, 0.0), DVec2::new(0.0, h), DVec2::new(w, h)];
    corners.iter().map(|c| camera.unproject(*c).length_squared()).fold(0.0, f64::max)
}

/// Derivatives of an image position by steps from a point, pixels.
fn shape(camera: &Camera, pose: &Pose, x: DVec3, steps: [DVec3; 2]) -> Option<DMat2> {
    let h = 1e-3 * pose.transform(x).z.abs() / steps[0].length();
    let [u, v] = steps.map(|t| {
        let [ahead, behind] = [x + t * h, x - t * h].map(|x| camera.project(pose.transform(x)));
        Some((ahead? - behind?) / (2.0 * h))
    });
    let m = DMat2::from_cols(u?, v?);
    m.is_finite().then_some(m)
}

/// Bilinear; NaN outside.
fn between(level: &PyramidLevel, p: DVec2) -> f32 {
    let (x, y) = (p.x - 0.5, p.y - 0.5);
    let inside = x >= 0.0 && y >= 0.0 && x < (level.width - 1) as f64 && y < (level.height - 1) as f64;
    if !inside {
        return f32::NAN;
    }
    let (column, row) = (x as usize, y as usize);
    let (fx, fy) = ((x - column as f64) as f32, (y - row as f64) as f32);
    let i = row * level.width + column;
    let [above, below] =
        [i, i + level.width].map(|i| level.data[i] + fx * (level.data[i + 1] - level.data[i]));
    above + fy * (below - above)
}
