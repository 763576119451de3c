//! Relative poses and fundamental matrices that minimise a robust Sampson error.

use super::levenberg::{Normal, cauchy, minimise};
use super::linalg::{nearest_rank2, skew, svd3};
use glam::{DMat3, DQuat, DVec2, DVec3};
use scene::Pose;

/// The pairs to fit: `indices` into `a` and `b`.
#[derive(Clone, Copy)]
pub(crate) struct Pairs<'a> {
    /// Points of image a.
    pub a: &'a [DVec2],
    /// Points of image b.
    pub b: &'a [DVec2],
    /// Which of them count.
    pub indices: &'a [usize],
}

/// The relative pose (unit translation) near `b_from_a` that minimises Cauchy's loss, of width
/// `scale`, of the Sampson error. Points: ideal pixels from the principal point; `focal`: pixels,
/// of a and of b. Five unknowns: a rotation vector and two on the sphere of translations. The start
/// is returned where nothing is better.
pub(crate) fn refine_relative(
    b_from_a: &Pose,
    focal: [f64; 2],
    pairs: Pairs,
    scale: f64,
    max_iterations: usize,
) -> Pose {
    let inverse = focal.map(|f| DMat3::from_diagonal(DVec3::new(1.0 / f, 1.0 / f, 1.0)));
    let evaluate = |pose: &Pose| {
        let (r, t) = (pose.matrix(), pose.translation);
        let scaled = |m: DMat3| inverse[1] * m * inverse[0];
        let (u, v) = t.try_normalize()?.any_orthonormal_pair();
        let turned = |axis: DVec3| scaled(skew(t) * skew(axis) * r);
        let tangents =
            [turned(DVec3::X), turned(DVec3::Y), turned(DVec3::Z), scaled(skew(u) * r), scaled(skew(v) * r)];
        Some(sampson_normal(&scaled(skew(t) * r), &tangents, pairs, scale))
    };
    let moved = |pose: &Pose, step: &[f64; 5]| {
        let (u, v) = pose.translation.any_orthonormal_pair();
        Pose {
            rotation: (DQuat::from_scaled_axis(DVec3::new(step[0], step[1], step[2])) * pose.rotation)
                .normalize(),
            translation: (pose.translation + u * step[3] + v * step[4]).normalize(),
        }
    };
    let start = Pose { translation: b_from_a.translation.normalize_or_zero(), ..*b_from_a };
    minimise(start, max_iterations, evaluate, moved)
}

/// The fundamental matrix (rank 2, unit norm) near `f` that minimises the same loss in the unit of
/// the points. Seven unknowns, `F = U diag(cos θ, sin θ, 0) Vᵀ`: Bartoli & Sturm, "Nonlinear
/// Estimation of the Fundamental Matrix with Minimal Parameters", PAMI 2004. The points should be
/// of the order of 1 to 1000.
pub(crate) fn refine_fundamental(
    f: &DMat3,
    pairs: Pairs,
    scale: f64,
    max_iterations: usize,
) -> Option<DMat3> {
    let (u, s, v) = svd3(&nearest_rank2(f)?);
    let (u, v) = (u * u.determinant().signum(), v * v.determinant().signum());
    let matrix = |u: &DMat3, d: DVec3, v: &DMat3| *u * DMat3::from_diagonal(d) * v.transpose();
    let evaluate = |(u, v, theta): &(DMat3, DMat3, f64)| {
        let d = DVec3::new(theta.cos(), theta.sin(), 0.0);
        let on_u = |axis: DVec3| matrix(&(*u * skew(axis)), d, v);
        let on_v = |axis: DVec3| matrix(u, d, &(*v * skew(axis)));
        let on_theta = matrix(u, DVec3::new(-theta.sin(), theta.cos(), 0.0), v);
        let tangents = [
            on_u(DVec3::X),
            on_u(DVec3::Y),
            on_u(DVec3::Z),
            on_v(DVec3::X),
            on_v(DVec3::Y),
            on_v(DVec3::Z),
            on_theta,
        ];
        Some(sampson_normal(&matrix(u, d, v), &tangents, pairs, scale))
    };
    let moved = |(u, v, theta): &(DMat3, DMat3, f64), step: &[f64; 7]| {
        let turn = |x, y, z| DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(x, y, z)));
        (*u * turn(step[0], step[1], step[2]), *v * turn(step[3], step[4], step[5]), theta + step[6])
    };
    let (u, v, theta) = minimise((u, v, s.y.atan2(s.x)), max_iterations, evaluate, moved);
    let f = matrix(&u, DVec3::new(theta.cos(), theta.sin(), 0.0), &v);
    f.is_finite().then_some(f)
}

/// Sums the robust Sampson residuals of a matrix that moves along `tangents`.
fn sampson_normal<const D: usize>(f: &DMat3, tangents: &[DMat3; D], pairs: Pairs, scale: f64) -> Normal<D> {
    let mut normal = Normal::new();
    let directions = tangents.map(|t| t.to_cols_array());
    let ft = f.transpose();
    for &i in pairs.indices {
        let (a, b) = (pairs.a[i].extend(1.0), pairs.b[i].extend(1.0));
        let (fa, fb) = ((*f * a).truncate(), (ft * b).truncate());
        let c = b.dot(*f * a);
        let d = fa.length_squared() + fb.length_squared();
        if d.is_nan() || d <= 0.0 {
            continue;
        }
        let root = d.sqrt();
        let residual = c / root;
        // d residual / d F = (b aᵀ − (c/d) (P F a aᵀ + b (P Fᵀ b)ᵀ)) / √d, P dropping the third
        // coordinate.
        let left = (b - fa.extend(0.0) * (c / d)) / root;
        let right = fb.extend(0.0) * (c / (d * root));
        let g = [left * a.x - b * right.x, left * a.y - b * right.y, left * a.z - b * right.z];
        let g = [g[0].x, g[0].y, g[0].z, g[1].x, g[1].y, g[1].z, g[2].x, g[2].y, g[2].z];
        let mut gradient = [0.0; D];
        for (slot, direction) in gradient.iter_mut().zip(&directions) {
            *slot = g.iter().zip(direction).map(|(x, y)| x * y).sum();
        }
        let (cost, weight) = cauchy(residual * residual, scale);
        normal.add_cost(cost);
        normal.add(residual, &gradient, weight);
    }
    normal
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solvers::sampson_sq;
    use crate::solvers::testing::{Shape, angle, normal, two_views, unit_vector};
    use scene::pose::rotation_angle;
    use scene::rng::rng;

    const FOCAL: f64 = 700.0;

    fn pixels(points: &[DVec2], noise: f64, seed: u64) -> Vec<DVec2> {
        let mut r = rng(seed, "noise", points.len() as u64);
        points.iter().map(|p| *p * FOCAL + DVec2::new(normal(&mut r), normal(&mut r)) * noise).collect()
    }

    #[test]
    fn returns_to_the_exact_pose_from_a_few_degrees_away() {
        for seed in 0..100 {
            let s = two_views(seed, 60, Shape::General, 1.0);
            let (a, b) = (pixels(&s.a, 0.0, 0), pixels(&s.b, 0.0, 0));
            let mut r = rng(seed, "start", 0);
            let turn = |axis: DVec3, amount: f64| DQuat::from_scaled_axis(axis * amount);
            let start = Pose::new(
                turn(unit_vector(&mut r), 0.03) * s.b_from_a.rotation,
                turn(unit_vector(&mut r), 0.05) * s.b_from_a.translation,
            );
            let all: Vec<usize> = (0..60).collect();
            let pairs = Pairs { a: &a, b: &b, indices: &all };
            let found = refine_relative(&start, [FOCAL; 2], pairs, FOCAL, 50);
            assert!(rotation_angle(found.rotation, s.b_from_a.rotation) < 1e-6, "seed {seed}");
            assert!(angle(found.translation, s.b_from_a.translation) < 1e-5, "seed {seed}");
        }
    }

    #[test]
    fn a_refined_fundamental_matrix_fits_noisy_pairs_no_worse_than_the_linear_one() {
        for seed in 0..100 {
            let s = two_views(seed, 60, Shape::General, 1.0);
            let (a, b) = (pixels(&s.a, 0.5, 2 * seed), pixels(&s.b, 0.5, 2 * seed + 1));
            let (a, b): (Vec<DVec2>, Vec<DVec2>) =
                a.iter().zip(&b).map(|(a, b)| (*a / FOCAL, *b / FOCAL)).unzip();
            let linear = crate::solvers::fundamental_8pt(&a, &b).unwrap();
            let all: Vec<usize> = (0..60).collect();
            let refined =
                refine_fundamental(&linear, Pairs { a: &a, b: &b, indices: &all }, 1.0, 20).unwrap();
            let cost =
                |f: &DMat3| a.iter().zip(&b).map(|(a, b)| sampson_sq(f, *a, *b)).sum::<f64>().sqrt() * FOCAL;
            assert!(cost(&refined) <= cost(&linear) * (1.0 + 1e-9), "seed {seed}");
            assert!(cost(&refined) < 0.6 * 60f64.sqrt(), "seed {seed}: {}", cost(&refined));
            assert!(refined.determinant().abs() < 1e-12, "seed {seed}");
        }
    }

    #[test]
    fn senseless_pairs_return_the_start() {
        let start = Pose::new(DQuat::IDENTITY, DVec3::X);
        let (a, b) = ([DVec2::NAN; 6], [DVec2::ZERO; 6]);
        let pairs = Pairs { a: &a, b: &b, indices: &[0, 1, 2, 3, 4, 5] };
        assert_eq!(refine_relative(&start, [FOCAL; 2], pairs, 1.0, 10), start);
        let still = Pose::IDENTITY; // no baseline: nothing to refine
        assert_eq!(refine_relative(&still, [FOCAL; 2], pairs, 1.0, 10), still);
        assert!(refine_fundamental(&DMat3::ZERO, pairs, 1.0, 10).is_none());
        assert!(refine_fundamental(&DMat3::NAN, pairs, 1.0, 10).is_none());
    }
}
