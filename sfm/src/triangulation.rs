//! Points from the rays that see them.

use glam::{DMat3, DVec2, DVec3};
use scene::{Camera, Pose};

/// An observation to triangulate from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PointView<'a> {
    /// `cam_from_world`.
    pub pose: Pose,
    /// Its camera.
    pub camera: &'a Camera,
    /// Measured pixel.
    pub pixel: DVec2,
    /// Camera centre, world frame.
    pub centre: DVec3,
    /// Unit ray of the pixel, world frame.
    pub ray: DVec3,
}

impl<'a> PointView<'a> {
    /// An observation of `pixel` by a posed camera.
    pub(crate) fn new(pose: &Pose, camera: &'a Camera, pixel: DVec2) -> Self {
        let ray = pose.rotation.conjugate() * camera.ray(pixel);
        Self { pose: *pose, camera, pixel, centre: pose.centre(), ray }
    }

    /// Squared reprojection error, pixels²; infinite behind the camera.
    pub(crate) fn error_sq(&self, x: DVec3) -> f64 {
        let projected = self.camera.project(self.pose.transform(x));
        projected.map_or(f64::INFINITY, |p| p.distance_squared(self.pixel))
    }
}

/// What a triangulated point must satisfy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Gates {
    /// Largest reprojection error, pixels.
    pub max_error_px: f64,
    /// Smallest angle between some two of its rays, radians.
    pub min_angle: f64,
}

/// A triangulated point.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Triangulated {
    /// World frame.
    pub position: DVec3,
    /// Indices of the views that agree with it, ascending; at least two.
    pub inliers: Vec<usize>,
    /// Largest angle between two of their rays, radians.
    pub angle: f64,
}

/// Angle between two unit vectors, radians; accurate for small ones.
pub(crate) fn angle_between(a: DVec3, b: DVec3) -> f64 {
    a.cross(b).length().atan2(a.dot(b))
}

/// The point nearest to all rays, `Σ (I − d dᵀ) (x − c) = 0`; `None` where they are parallel.
/// Solved about the mean centre, so that the origin does not matter.
pub(crate) fn nearest_to_rays<'a>(views: impl Iterator<Item = &'a PointView<'a>> + Clone) -> Option<DVec3> {
    let n = views.clone().count();
    let origin = views.clone().map(|v| v.centre).sum::<DVec3>() / n.max(1) as f64;
    let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
    for view in views {
        let across = DMat3::IDENTITY
            - DMat3::from_cols(view.ray * view.ray.x, view.ray * view.ray.y, view.ray * view.ray.z);
        a += across;
        b += across * (view.centre - origin);
    }
    // For two unit rays at an angle α the determinant is 2 sin²α.
    let determinant = a.determinant();
    if !(determinant > 1e-13) {
        return None;
    }
    Some(a.inverse() * b + origin).filter(|x| x.is_finite())
}

/// Gauss–Newton on the reprojection error from `start`: the point of least squared error over
/// `views`. The start is returned where no step helps.
pub(crate) fn refine_point<'a>(
    start: DVec3,
    views: impl Iterator<Item = &'a PointView<'a>> + Clone,
    iterations: usize,
) -> DVec3 {
    let (mut x, mut best) = (start, total_error(start, views.clone()));
    for _ in 0..iterations {
        let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
        for view in views.clone() {
            let Some((residual, rows)) = linearise(view, x) else { continue };
            for (r, row) in residual.iter().zip(rows) {
                a += DMat3::from_cols(row * row.x, row * row.y, row * row.z);
                b -= row * *r;
            }
        }
        if a.determinant() == 0.0 {
            break; // nothing holds the point
        }
        let moved = x + a.inverse() * b;
        let after = if moved.is_finite() { total_error(moved, views.clone()) } else { f64::INFINITY };
        if !(after < best) {
            break;
        }
        let done = best - after < 1e-9 * best;
        (x, best) = (moved, after);
        if done {
            break;
        }
    }
    x
}

fn total_error<'a>(x: DVec3, views: impl Iterator<Item = &'a PointView<'a>>) -> f64 {
    views.map(|v| v.error_sq(x)).sum()
}

/// `Σ min(e², limit)`.
fn truncated_cost(x: DVec3, views: &[PointView<'_>], limit: f64) -> f64 {
    views.iter().map(|v| v.error_sq(x).min(limit)).sum()
}

/// Residual and its derivative by the point; the distortion's own derivative is taken as that of
/// its radial scale, which is enough for convergence.
pub(crate) fn linearise(view: &PointView<'_>, x: DVec3) -> Option<([f64; 2], [DVec3; 2])> {
    let local = view.pose.transform(x);
    let residual = view.camera.project(local)? - view.pixel;
    let (u, focal) = (local.truncate() / local.z, view.camera.focal());
    let scale = if u.length_squared() > 1e-18 { view.camera.distort(u).length() / u.length() } else { 1.0 };
    let back = view.pose.rotation.conjugate();
    let axes = [(DVec3::X, focal.x, u.x), (DVec3::Y, focal.y, u.y)];
    let rows = axes.map(|(axis, f, u)| back * ((axis - DVec3::Z * u) * (scale * f / local.z)));
    Some((residual.to_array(), rows))
}

/// Robust triangulation: hypotheses from pairs of views (all where few, a fixed spread where many),
/// the one with the least truncated squared error is refined on its inliers (LO-RANSAC over views;
/// Schönberger & Frahm 2016,  4.3).
pub(crate) fn triangulate(views: &[PointView<'_>], gates: &Gates) -> Option<Triangulated> {
    let limit = gates.max_error_px * gates.max_error_px;
    let mut best: Option<(f64, DVec3)> = None;
    for (i, k) in pairs(views.len()) {
        if angle_between(views[i].ray, views[k].ray) < gates.min_angle {
            continue;
        }
        let pair = [views[i], views[k]];
        let Some(x) = nearest_to_rays(pair.iter()) else { continue };
        let c = truncated_cost(x, views, limit);
        if best.is_none_or(|(least, _)| c < least) {
            best = Some((c, x));
        }
        if c < limit * 0.05 * views.len() as f64 {
            break; // as good as it gets: all agree
        }
    }
    let (mut least, mut x) = best?;
    let agreeing =
        |x: DVec3| (0..views.len()).filter(|&i| views[i].error_sq(x) <= limit).collect::<Vec<usize>>();
    let mut inliers = agreeing(x);
    for _ in 0..3 {
        let refined = refine_point(x, inliers.iter().map(|&i| &views[i]), 5);
        let c = truncated_cost(refined, views, limit);
        if !(c < least) {
            break;
        }
        (least, x) = (c, refined);
        inliers = agreeing(x);
    }
    let angle = widest_angle(x, inliers.iter().map(|&i| views[i].centre));
    (inliers.len() >= 2 && angle >= gates.min_angle).then_some(Triangulated { position: x, inliers, angle })
}

/// Largest angle at `x` between two of the centres, radians. For many centres against the first and
/// its farthest only.
pub(crate) fn widest_angle(x: DVec3, centres: impl Iterator<Item = DVec3>) -> f64 {
    let rays: Vec<DVec3> = centres.map(|c| (c - x).normalize_or_zero()).collect();
    let Some(&first) = rays.first() else { return 0.0 };
    let (_, far) = farthest_from(first, &rays);
    farthest_from(far, &rays).0
}

/// Angle to the ray farthest from one, radians, and that ray.
fn farthest_from(from: DVec3, rays: &[DVec3]) -> (f64, DVec3) {
    let angles = rays.iter().map(|r| (angle_between(from, *r), *r));
    angles.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, from))
}

/// Pairs of views to try: all up to six views, else each with the ones a third and a half of the
/// list away.
fn pairs(n: usize) -> Vec<(usize, usize)> {
    if n <= 6 {
        return (0..n).flat_map(|i| (i + 1..n).map(move |k| (i, k))).collect();
    }
    (0..n).flat_map(|i| [(i, (i + n / 2) % n), (i, (i + n / 3) % n)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::CameraModel;

    fn ring(camera: &Camera, n: usize, unit: f64, x: DVec3) -> Vec<PointView<'_>> {
        let eye = |i: usize| {
            let a = 0.2 * i as f64;
            DVec3::new(5.0 * a.cos(), 5.0 * a.sin(), 1.0) * unit
        };
        let poses = (0..n).map(|i| Pose::look_at(eye(i), DVec3::ZERO, DVec3::Z));
        poses.map(|p| PointView::new(&p, camera, camera.project(p.transform(x)).unwrap())).collect()
    }

    const GATES: Gates = Gates { max_error_px: 4.0, min_angle: 0.02 };

    #[test]
    fn exact_rays_meet_in_the_point_whatever_the_unit() {
        let mut camera = Camera::centred(1, CameraModel::Opencv, 640, 480, 700.0);
        camera.params[4..].copy_from_slice(&[-0.1, 0.02, 0.001, -0.001]);
        for unit in [1e-6, 1.0, 1e6] {
            let x = DVec3::new(0.3, -0.2, 0.4) * unit;
            for n in [2, 3, 12] {
                let found = triangulate(&ring(&camera, n, unit, x), &GATES).unwrap();
                assert!((found.position - x).length() < 1e-8 * unit, "{n} views, unit {unit}");
                assert_eq!(found.inliers.len(), n);
            }
        }
    }

    #[test]
    fn wrong_observations_are_told_apart() {
        let camera = Camera::centred(1, CameraModel::SimplePinhole, 640, 480, 700.0);
        let x = DVec3::new(0.1, 0.2, -0.3);
        let mut views = ring(&camera, 9, 1.0, x);
        for i in [0, 3, 4, 7] {
            views[i] = PointView::new(
                &views[i].pose,
                &camera,
                views[i].pixel + DVec2::new(30.0 + 9.0 * i as f64, -50.0),
            );
        }
        let found = triangulate(&views, &GATES).unwrap();
        assert_eq!(found.inliers, vec![1, 2, 5, 6, 8]);
        assert!((found.position - x).length() < 1e-8);
    }

    #[test]
    fn no_baseline_parallel_rays_and_points_behind_give_nothing() {
        let camera = Camera::centred(1, CameraModel::SimplePinhole, 640, 480, 700.0);
        let pose = Pose::IDENTITY;
        let still = [PointView::new(&pose, &camera, DVec2::splat(100.0)); 3];
        assert!(triangulate(&still, &GATES).is_none());
        let beside = Pose::from_centre(glam::DQuat::IDENTITY, DVec3::X);
        let parallel = [
            PointView::new(&pose, &camera, DVec2::splat(100.0)),
            PointView::new(&beside, &camera, DVec2::splat(100.0)),
        ];
        assert!(triangulate(&parallel, &GATES).is_none());
        let diverging = [
            PointView::new(&pose, &camera, DVec2::new(100.0, 240.0)),
            PointView::new(&beside, &camera, DVec2::new(500.0, 240.0)),
        ];
        assert!(triangulate(&diverging, &GATES).is_none());
        assert!(triangulate(&[], &GATES).is_none());
    }

    #[test]
    fn refinement_reaches_the_least_squares_point() {
        let camera = Camera::centred(1, CameraModel::SimplePinhole, 640, 480, 700.0);
        let x = DVec3::new(0.1, 0.2, -0.3);
        let views = ring(&camera, 8, 1.0, x);
        let found = refine_point(x + DVec3::splat(0.05), views.iter(), 20);
        assert!((found - x).length() < 1e-9);
    }
}
