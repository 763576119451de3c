//! Pose of a camera from three rays and the points they see.

use super::linalg::{determinant_of_pencil, symmetric_eigen};
use super::polynomial::{quadratic_roots, real_roots};
use glam::{DMat3, DVec3};
use scene::Pose;

/// Poses with `λᵢ xᵢ = R Xᵢ + t`, `λᵢ > 0`: at most four; none where the points are collinear.
/// `rays`: unit vectors, camera frame. `points`: world frame, scene units. Each result is a
/// `cam_from_world`. Persson & Nordberg, "Lambda Twist", ECCV 2018; like Ding et al., "Revisiting
/// the P3P Problem", CVPR 2023, it intersects two conics by way of a degenerate one of their
/// pencil. The depths are polished, the pose is not.
pub(crate) fn p3p(rays: &[DVec3; 3], points: &[DVec3; 3]) -> Vec<Pose> {
    let mut poses = Vec::with_capacity(4);
    let unit = rays.map(DVec3::normalize_or_zero);
    let sides = [points[0] - points[1], points[0] - points[2], points[1] - points[2]];
    let size = sides.iter().fold(0.0_f64, |m, s| m.max(s.length()));
    let sensible = size > 0.0 && size.is_finite() && unit.iter().all(|r| r.length_squared() > 0.5);
    if !sensible {
        return poses;
    }
    let normal = (sides[0] / size).cross(sides[1] / size);
    if normal.length() < 1e-10 {
        return poses;
    }
    let squared = sides.map(|s| (s / size).length_squared());
    let cosines = [unit[0].dot(unit[1]), unit[0].dot(unit[2]), unit[1].dot(unit[2])];
    for depths in depths(&squared, &cosines) {
        let x = [unit[0] * depths.x, unit[1] * depths.y, unit[2] * depths.z];
        let (Some(camera), Some(world)) =
            (frame(x[0] - x[1], x[0] - x[2]), frame(sides[0] / size, sides[1] / size))
        else {
            continue;
        };
        let rotation = camera * world.transpose();
        // The mean of the three keeps the error of the translation small.
        let centroid_camera = (x[0] + x[1] + x[2]) * (size / 3.0);
        let centroid_offset = (sides[0] + sides[1]) / -3.0; // centroid − points[0]
        let pose = Pose::from_matrix(rotation, DVec3::ZERO);
        let translation = centroid_camera - pose.rotation * centroid_offset - pose.rotation * points[0];
        let pose = Pose { translation, ..pose };
        if pose.is_finite() {
            poses.push(pose);
        }
    }
    poses
}

/// Orthonormal frame (columns) spanned by two edges of a triangle.
fn frame(u: DVec3, v: DVec3) -> Option<DMat3> {
    let x = u.try_normalize()?;
    let z = u.cross(v).try_normalize()?;
    Some(DMat3::from_cols(x, z, x.cross(z)))
}

/// Symmetric matrix of the form `λᵢ² + λⱼ² − 2 c λᵢ λⱼ`.
fn form(i: usize, j: usize, cosine: f64) -> [[f64; 3]; 3] {
    let mut m = [[0.0; 3]; 3];
    m[i][i] = 1.0;
    m[j][j] = 1.0;
    m[i][j] = -cosine;
    m[j][i] = -cosine;
    m
}

fn combine(a: &[[f64; 3]; 3], s: f64, b: &[[f64; 3]; 3], t: f64) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| s * a[i][j] + t * b[i][j]))
}

fn as_mat(m: &[[f64; 3]; 3]) -> DMat3 {
    DMat3::from_cols_array_2d(m) // symmetric
}

/// Positive depths with `λᵢ² + λⱼ² − 2 cᵢⱼ λᵢ λⱼ = aᵢⱼ`; order of the pairs: 01, 02, 12.
fn depths(squared: &[f64; 3], cosines: &[f64; 3]) -> Vec<DVec3> {
    let forms = [form(0, 1, cosines[0]), form(0, 2, cosines[1]), form(1, 2, cosines[2])];
    // Two homogeneous conics; the longest side divides, so that none of them vanishes.
    let k = (0..3).max_by(|&i, &j| squared[i].total_cmp(&squared[j])).unwrap_or(0);
    let (i, j) = ((k + 1) % 3, (k + 2) % 3);
    let d1 = combine(&forms[i], squared[k], &forms[k], -squared[i]);
    let d2 = combine(&forms[j], squared[k], &forms[k], -squared[j]);
    let mut found: Vec<DVec3> = Vec::with_capacity(4);
    let Some(pair) = degenerate_conic(&d1, &d2) else { return found };
    for line in pair {
        for direction in on_line(line, &d1, &d2) {
            let direction = if direction.dot(DVec3::ONE) < 0.0 { -direction } else { direction };
            let value = direction.dot(as_mat(&forms[k]) * direction);
            if !(direction.min_element() > 0.0 && value > 0.0) {
                continue;
            }
            let Some(depths) = polish(direction * (squared[k] / value).sqrt(), squared, cosines) else {
                continue;
            };
            if !found.iter().any(|f| f.distance(depths) < 1e-9 * depths.length()) {
                found.push(depths);
            }
        }
    }
    found
}

/// The two lines into which a degenerate conic of the pencil `d1 + γ d2` falls: of all real ones
/// that whose lines are farthest from complex.
fn degenerate_conic(d1: &[[f64; 3]; 3], d2: &[[f64; 3]; 3]) -> Option<[DVec3; 2]> {
    let cubic = determinant_of_pencil(&as_mat(d1), &as_mat(d2));
    let mut best: Option<(f64, [DVec3; 2])> = None;
    for &gamma in real_roots(&cubic).iter() {
        let norm = (1.0 + gamma * gamma).sqrt();
        let (values, vectors) = symmetric_eigen(&combine(d1, 1.0 / norm, d2, gamma / norm));
        let largest = values[0].abs().max(values[2].abs());
        let quality = -values[0] * values[2] / (largest * largest);
        if quality > 1e-12 && best.as_ref().is_none_or(|(q, _)| quality > *q) {
            let (low, high) = (DVec3::from_array(vectors[0]), DVec3::from_array(vectors[2]));
            let (low, high) = (low * (-values[0]).sqrt(), high * values[2].sqrt());
            best = Some((quality, [high + low, high - low]));
        }
    }
    best.map(|(_, lines)| lines)
}

/// Where the plane `line · λ = 0` meets the conic of larger curvature along it: directions of λ.
fn on_line(line: DVec3, d1: &[[f64; 3]; 3], d2: &[[f64; 3]; 3]) -> Vec<DVec3> {
    let Some(n) = line.try_normalize() else { return Vec::new() };
    let (u, v) = n.any_orthonormal_pair();
    let [first, second] = [d1, d2].map(as_mat).map(|m| DVec3::new(u.dot(m * u), u.dot(m * v), v.dot(m * v)));
    let larger = if first.abs().element_sum() >= second.abs().element_sum() { first } else { second };
    let [a, b, c] = larger.to_array();
    if a.abs() >= c.abs() {
        quadratic_roots(a, 2.0 * b, c).iter().map(|s| u * *s + v).collect()
    } else {
        quadratic_roots(c, 2.0 * b, a).iter().map(|s| v * *s + u).collect()
    }
}

/// Gauss–Newton on the three equations; `None` where it does not end at a solution in front of the
/// camera.
fn polish(start: DVec3, squared: &[f64; 3], cosines: &[f64; 3]) -> Option<DVec3> {
    let residual = |l: DVec3| {
        DVec3::new(
            l.x * l.x + l.y * l.y - 2.0 * cosines[0] * l.x * l.y - squared[0],
            l.x * l.x + l.z * l.z - 2.0 * cosines[1] * l.x * l.z - squared[1],
            l.y * l.y + l.z * l.z - 2.0 * cosines[2] * l.y * l.z - squared[2],
        )
    };
    let (mut best, mut error) = (start, residual(start).length());
    for _ in 0..6 {
        let l = best;
        let transposed = DMat3::from_cols(
            DVec3::new(l.x - cosines[0] * l.y, l.y - cosines[0] * l.x, 0.0),
            DVec3::new(l.x - cosines[1] * l.z, 0.0, l.z - cosines[1] * l.x),
            DVec3::new(0.0, l.y - cosines[2] * l.z, l.z - cosines[2] * l.y),
        );
        let next = l - transposed.transpose().inverse() * residual(l) * 0.5;
        let next_error = residual(next).length();
        if next_error.is_nan() || next_error >= error {
            break;
        }
        (best, error) = (next, next_error);
    }
    // Squares of depths cancel in the equations: the tolerance grows with them.
    (error < 1e-9 * (1.0 + best.length_squared()) && best.min_element() > 0.0).then_some(best)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solvers::testing::{Shape, rotation, two_views};
    use rand::Rng as _;
    use scene::pose::rotation_angle;
    use scene::rng::rng;

    fn exact(seed: u64, unit: f64, offset: DVec3) -> (Pose, [DVec3; 3], [DVec3; 3]) {
        let mut r = rng(seed, "p3p", 0);
        let camera: [DVec3; 3] = std::array::from_fn(|_| {
            DVec3::new(r.random_range(-1.0..1.0), r.random_range(-1.0..1.0), r.random_range(1.0..6.0)) * unit
        });
        let rotation = rotation(&mut r, 3.0);
        let pose = Pose::from_centre(rotation, offset + DVec3::new(0.3, -2.0, 1.0) * unit);
        let inverse = pose.inverse();
        // The centre is kept exactly: the translation of a far camera is rounded.
        let points = camera.map(|x| inverse.rotation * x + inverse.translation);
        (pose, camera.map(|x| x.normalize()), points)
    }

    #[test]
    fn recovers_the_pose_from_three_exact_points_in_any_unit() {
        for unit in [1e-6, 1.0, 1e6] {
            for seed in 0..1000 {
                let (truth, rays, points) = exact(seed, unit, DVec3::ZERO);
                let poses = p3p(&rays, &points);
                assert!(poses.len() <= 4);
                let error = poses
                    .iter()
                    .map(|p| {
                        rotation_angle(p.rotation, truth.rotation)
                            + p.centre().distance(truth.centre()) / unit
                    })
                    .fold(f64::INFINITY, f64::min);
                assert!(error < 1e-5, "seed {seed} unit {unit}: {error}");
            }
        }
    }

    #[test]
    fn every_pose_sees_the_points_along_the_rays() {
        for seed in 0..1000 {
            let (_, rays, points) = exact(seed, 1.0, DVec3::ZERO);
            for pose in p3p(&rays, &points) {
                for (ray, point) in rays.iter().zip(&points) {
                    let x = pose.transform(*point);
                    assert!(x.normalize().dot(*ray) > 1.0 - 1e-12, "seed {seed}");
                }
            }
        }
    }

    #[test]
    fn coordinates_around_ten_million_cost_only_their_rounding() {
        for seed in 0..100 {
            let (truth, rays, points) = exact(seed, 1.0, DVec3::new(1e7, -1e7, 1e7));
            let error = p3p(&rays, &points)
                .iter()
                .map(|p| rotation_angle(p.rotation, truth.rotation))
                .fold(f64::INFINITY, f64::min);
            assert!(error < 1e-3, "seed {seed}: {error}");
        }
    }

    #[test]
    fn collinear_coincident_and_senseless_points_give_none() {
        let rays = [DVec3::Z, DVec3::new(0.1, 0.0, 1.0).normalize(), DVec3::new(0.2, 0.0, 1.0).normalize()];
        for seed in 0..100 {
            let line = two_views(seed, 3, Shape::Line, 1.0).points;
            assert!(p3p(&rays, &[line[0], line[1], line[2]]).is_empty(), "seed {seed}");
        }
        for bad in [DVec3::NAN, DVec3::INFINITY, DVec3::ZERO, DVec3::splat(1e300)] {
            assert!(p3p(&rays, &[bad; 3]).is_empty(), "{bad}");
            assert!(p3p(&[bad; 3], &[DVec3::X, DVec3::Y, DVec3::Z]).iter().all(Pose::is_finite), "{bad}");
        }
        assert!(p3p(&[DVec3::Z; 3], &[DVec3::X, DVec3::Y, DVec3::Z]).is_empty());
    }
}
