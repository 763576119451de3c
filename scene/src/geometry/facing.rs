//! How much aslant each pixel of a depth map sees the surface.

use super::depth_map::DepthMap;
use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;

/// Half the side of the square of pixels that tell how the surface in its middle is inclined.
/// Source: docs/decisions/16.
const AROUND: usize = 1;
/// What is seen more aslant is not told from a jump in depth: cosine of the angle between the ray
/// and the normal. Source: docs/decisions/16.
pub(super) const LEAST_COSINE: f64 = 0.05;
/// Depths are on a plane if they are off it by less than this across the ray, root mean square,
/// pixels. Source: docs/decisions/16.
const PLANE_PX: f64 = 0.3;

/// [height × width] cosine of the angle between each ray and the normal of the surface that it
/// meets, times 255; 255 where the depths around it are on no plane.
pub(super) fn cosines(map: &DepthMap<'_>) -> Vec<u8> {
    let of = |i: usize| {
        cosine(map, i).map_or(u8::MAX, |c| (f64::from(u8::MAX) * c.clamp(LEAST_COSINE, 1.0)) as u8)
    };
    (0..map.depth.len()).into_par_iter().map(of).collect()
}

/// Sums of a linear fit to inverse depths by the place in the picture, in units of one of them.
struct PlaneSums {
    normal: DMat3,
    right: DVec3,
    squares: f64,
    count: f64,
}

impl PlaneSums {
    fn add(&mut self, row: DVec3, value: f64) {
        self.normal += DMat3::from_cols(row * row.x, row * row.y, row * row.z);
        self.right += row * value;
        self.squares += value * value;
        self.count += 1.0;
    }

    /// The coefficients, and the root of the mean squared residual.
    fn fit(&self) -> Option<(DVec3, f64)> {
        // The determinant of the sums is a whole number; three depths more than unknowns check it.
        let enough = self.count > 5.0 && self.normal.determinant() > 0.5;
        let fit = enough.then(|| self.normal.inverse() * self.right)?;
        Some((fit, ((self.squares - fit.dot(self.right)).max(0.0) / self.count).sqrt()))
    }
}

/// Of one pixel; `None` where the depths around it are on no plane.
fn cosine(map: &DepthMap<'_>, i: usize) -> Option<f64> {
    let width = map.camera.width as usize;
    let here = f64::from(map.depth[i]);
    if !(here > 0.0 && here.is_finite()) {
        return None;
    }
    let (x, y, focal) = (i % width, i / width, map.camera.focal());
    let steepest = here / focal.min_element() / LEAST_COSINE;
    let mut sums = PlaneSums { normal: DMat3::ZERO, right: DVec3::ZERO, squares: 0.0, count: 0.0 };
    for v in y.saturating_sub(AROUND)..(y + AROUND + 1).min(map.depth.len() / width) {
        for u in x.saturating_sub(AROUND)..(x + AROUND + 1).min(width) {
            let z = f64::from(map.depth[v * width + u]);
            let row = DVec3::new(1.0, u as f64 - x as f64, v as f64 - y as f64);
            // What jumps farther is another surface.
            if z > 0.0 && z.is_finite() && (z - here).abs() <= steepest * (row.y.abs() + row.z.abs()) {
                sums.add(row, here / z);
            }
        }
    }
    let (fit, residual) = sums.fit()?;
    // here / z = fit · (1, du, dv) is the plane n · X = 1 of points X = z ray, times `here`.
    let ray = (DVec2::new(x as f64 + 0.5, y as f64 + 0.5) - map.camera.principal_point()) / focal;
    let [a, b] = [fit.y * focal.x, fit.z * focal.y];
    let normal = DVec3::new(a, b, fit.x - a * ray.x - b * ray.y);
    let cosine = normal.normalize().dot(ray.extend(1.0).normalize());
    (cosine > 0.0 && residual * cosine * focal.min_element() < PLANE_PX).then_some(cosine)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Camera, CameraModel, Pose};

    /// A camera that looks along a plane from 1 above it, this steeply, degrees.
    fn plane(down_deg: f64, size: f64) -> DepthMap<'static> {
        let camera = Camera::centred(1, CameraModel::Pinhole, 64, 48, 100.0);
        let (sin, cos) = down_deg.to_radians().sin_cos();
        let depth = (0..64 * 48).map(|i| {
            let y = (f64::from(i / 64) + 0.5 - 24.0) / 100.0;
            // A ray (x, y, 1) goes down by this much for each unit of depth.
            let down = y * cos + sin;
            if down > 0.0 { (size / down) as f32 } else { f32::INFINITY }
        });
        let depth: Vec<f32> = depth.collect();
        DepthMap {
            camera,
            pose: Pose::IDENTITY,
            depth,
            outline: Vec::new(),
            rgb: vec![0; 64 * 48 * 3].into(),
        }
    }

    fn middle(map: &DepthMap<'_>) -> f64 {
        f64::from(cosines(map)[24 * 64 + 32]) / 255.0
    }

    #[test]
    fn planes_are_seen_as_much_aslant_as_they_lie_at_any_size() {
        for size in [1e-6, 1.0, 1e6] {
            for down_deg in [5.0_f64, 10.0, 30.0, 60.0, 90.0] {
                let found = middle(&plane(down_deg, size));
                let expected = down_deg.to_radians().sin();
                assert!((found - expected).abs() < 0.01, "{size}, {down_deg}: {found}, not {expected}");
            }
        }
        // Still more aslant, a plane is like a jump in depth.
        assert_eq!(middle(&plane(1.5, 1.0)), 1.0);
    }

    #[test]
    fn what_is_on_no_plane_counts_as_seen_from_before() {
        let mut rough = plane(30.0, 1.0);
        for (i, z) in rough.depth.iter_mut().enumerate() {
            *z *= if (i / 64 + i % 64).is_multiple_of(2) { 0.98 } else { 1.02 };
        }
        assert_eq!(middle(&rough), 1.0);
        for nothing in [f32::NAN, f32::INFINITY, 0.0] {
            let mut map = plane(30.0, 1.0);
            map.depth.fill(nothing);
            assert!(cosines(&map).iter().all(|c| *c == u8::MAX));
            map.depth[24 * 64 + 32] = 1.0;
            assert!(cosines(&map).iter().all(|c| *c == u8::MAX));
        }
    }
}
