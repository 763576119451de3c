//! Which points of a mesh some camera sees: what no camera sees cannot be asked of a
//! reconstruction.

use super::Mesh;
use crate::{Camera, Pose};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// The nearest surface of a mesh by pixel: a z-buffer.
#[derive(Clone, Debug)]
pub struct DepthView {
    camera: Camera,
    pose: Pose,
    /// [height × width] camera z, infinite where there is nothing.
    pub depth: Vec<f64>,
}

impl DepthView {
    /// Draws the mesh, through the camera's lens. A pixel holds the depth at its centre,
    /// interpolated in 1 / z, which is exact for a plane up to the lens distortion within a
    /// triangle; triangles that reach behind the camera are left out.
    pub fn new(mesh: &Mesh, camera: &Camera, pose: &Pose) -> Self {
        let (w, h) = (camera.width as usize, camera.height as usize);
        let mut view = Self { camera: camera.clone(), pose: *pose, depth: vec![f64::INFINITY; w * h] };
        for i in 0..mesh.triangles.len() {
            view.draw(mesh.corners(i).map(|v| pose.transform(v)));
        }
        view
    }

    fn draw(&mut self, corners: [DVec3; 3]) {
        let [Some(a), Some(b), Some(c)] = corners.map(|x| self.camera.project(x)) else { return };
        let area = (b - a).perp_dot(c - a);
        if area == 0.0 || !area.is_finite() {
            return;
        }
        let (w, h) = (f64::from(self.camera.width), f64::from(self.camera.height));
        let (low, high) = (a.min(b).min(c).max(DVec2::ZERO), a.max(b).max(c).min(DVec2::new(w, h)));
        let inverse = corners.map(|x| 1.0 / x.z);
        for y in low.y as usize..high.y.ceil().max(0.0) as usize {
            for x in low.x as usize..high.x.ceil().max(0.0) as usize {
                let p = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let u = (c - b).perp_dot(p - b) / area;
                let v = (a - c).perp_dot(p - c) / area;
                let t = 1.0 - u - v;
                if u < 0.0 || v < 0.0 || t < 0.0 {
                    continue;
                }
                let z = 1.0 / (u * inverse[0] + v * inverse[1] + t * inverse[2]);
                let at = &mut self.depth[y * w as usize + x];
                *at = at.min(z);
            }
        }
    }

    /// Whether nothing lies before the point by more than `slack` (scene units).
    pub fn sees(&self, p: DVec3, slack: f64) -> bool {
        let x = self.pose.transform(p);
        let Some(pixel) = self.camera.project(x) else { return false };
        let (w, h) = (f64::from(self.camera.width), f64::from(self.camera.height));
        if !(0.0..w).contains(&pixel.x) || !(0.0..h).contains(&pixel.y) {
            return false;
        }
        x.z <= self.depth[pixel.y as usize * self.camera.width as usize + pixel.x as usize] + slack
    }
}

/// The points that at least one of the cameras sees; `slack` is in scene units.
pub fn seen_by(points: &[DVec3], mesh: &Mesh, cameras: &[(&Camera, Pose)], slack: f64) -> Vec<DVec3> {
    let views: Vec<DepthView> = cameras.par_iter().map(|(c, p)| DepthView::new(mesh, c, p)).collect();
    points.par_iter().copied().filter(|p| views.iter().any(|v| v.sees(*p, slack))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CameraModel;

    /// Two squares facing the camera, the farther one hidden but for its border.
    fn squares() -> Mesh {
        let mut mesh = Mesh::default();
        for (side, z) in [(1.0, 4.0), (2.0, 6.0)] {
            let n = mesh.vertices.len() as u32;
            mesh.vertices.extend(
                [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                    .map(|(x, y)| DVec3::new(side * x, side * y, z)),
            );
            mesh.triangles.extend([[n, n + 1, n + 2], [n, n + 2, n + 3]]);
        }
        mesh
    }

    #[test]
    fn what_lies_behind_is_not_seen() {
        let camera = Camera::centred(1, CameraModel::Pinhole, 200, 200, 200.0);
        let (mesh, pose) = (squares(), Pose::IDENTITY);
        let view = DepthView::new(&mesh, &camera, &pose);
        assert!((view.depth[100 * 200 + 100] - 4.0).abs() < 1e-12);
        assert!((view.depth[40 * 200 + 40] - 6.0).abs() < 1e-12);
        assert_eq!(view.depth[0], f64::INFINITY);
        let points = [
            DVec3::new(0.2, 0.3, 4.0),
            DVec3::new(0.2, 0.3, 6.0),
            DVec3::new(1.8, 0.0, 6.0),
            DVec3::new(0.0, 0.0, -1.0),
            DVec3::new(90.0, 0.0, 4.0),
        ];
        let seen = seen_by(&points, &mesh, &[(&camera, pose)], 0.01);
        assert_eq!(seen, [points[0], points[2]]);
    }

    #[test]
    fn a_slanted_plane_has_its_depth_at_every_pixel() {
        let camera = Camera::centred(1, CameraModel::Pinhole, 100, 80, 90.0);
        let at = |x: f64, y: f64| DVec3::new(x, y, 5.0 + 0.5 * x - 0.2 * y);
        let mesh = Mesh {
            vertices: vec![at(-3.0, -3.0), at(3.0, -3.0), at(0.0, 4.0)],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        let view = DepthView::new(&mesh, &camera, &Pose::IDENTITY);
        for (i, &z) in view.depth.iter().enumerate().filter(|(_, z)| z.is_finite()) {
            let pixel = DVec2::new((i % 100) as f64 + 0.5, (i / 100) as f64 + 0.5);
            let u = (pixel - camera.principal_point()) / 90.0;
            let expected = 5.0 / (1.0 - 0.5 * u.x + 0.2 * u.y);
            assert!((z - expected).abs() < 1e-9, "pixel {pixel}: {z} {expected}");
        }
        assert!(view.depth.iter().filter(|z| z.is_finite()).count() > 2000);
    }
}
