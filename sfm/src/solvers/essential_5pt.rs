//! Essential matrices of five ray pairs.

use super::linalg::{mat3_from_rows, null_space};
use super::polynomial::{evaluate, real_roots_with_tolerance};
use glam::DMat3;
use glam::DVec3;

type Linear = [f64; 4]; // x y z 1
type Quadratic = [f64; 10]; // x² xy y² xz yz z² x y z 1
type Cubic = [f64; 20]; // x³ y³ x²y xy² x²z x² y²z y² xyz xy | xz² xz x yz² yz y z³ z² z 1

/// Essential matrices with `b_iᵀ E a_i = 0` (at most ten, Frobenius norm √2): none where the five
/// pairs do not determine finitely many. Rays of any length, camera frames. Nistér, "An Efficient
/// Solution to the Five-Point Relative Pose Problem", PAMI 2004 ( 3.1–3.2.3; roots by
/// [`super::polynomial::real_roots`] instead of Sturm chains). Not refined.
pub(crate) fn essential_5pt(a: &[DVec3; 5], b: &[DVec3; 5]) -> Vec<DMat3> {
    let rows: [[f64; 9]; 5] = std::array::from_fn(|i| {
        let (a, b) = (a[i].normalize_or_zero().to_array(), b[i].normalize_or_zero().to_array());
        std::array::from_fn(|k| b[k / 3] * a[k % 3])
    });
    let Some((basis, eliminated)) = best_elimination(null_space(&rows)) else { return Vec::new() };
    let b_matrix = polynomial_matrix(&eliminated);
    // Planes give double roots; the tolerance is the error that elimination leaves in the
    // coefficients.
    let roots = real_roots_with_tolerance(&determinant(&b_matrix), 1e-11);
    let mut result = Vec::with_capacity(roots.len());
    for &z in roots.iter() {
        let Some((x, y)) = solve_xy(&b_matrix, z) else { continue };
        let e: [f64; 9] =
            std::array::from_fn(|k| x * basis[0][k] + y * basis[1][k] + z * basis[2][k] + basis[3][k]);
        let norm = e.iter().map(|v| v * v).sum::<f64>().sqrt();
        if norm.is_finite() && norm > 0.0 {
            result.push(mat3_from_rows(&e) * (std::f64::consts::SQRT_2 / norm));
        }
    }
    result
}

fn times(a: &Linear, b: &Linear) -> Quadratic {
    [
        a[0] * b[0],
        a[0] * b[1] + a[1] * b[0],
        a[1] * b[1],
        a[0] * b[2] + a[2] * b[0],
        a[1] * b[2] + a[2] * b[1],
        a[2] * b[2],
        a[0] * b[3] + a[3] * b[0],
        a[1] * b[3] + a[3] * b[1],
        a[2] * b[3] + a[3] * b[2],
        a[3] * b[3],
    ]
}

fn times_linear(q: &Quadratic, l: &Linear) -> Cubic {
    [
        q[0] * l[0],
        q[2] * l[1],
        q[0] * l[1] + q[1] * l[0],
        q[1] * l[1] + q[2] * l[0],
        q[0] * l[2] + q[3] * l[0],
        q[0] * l[3] + q[6] * l[0],
        q[2] * l[2] + q[4] * l[1],
        q[2] * l[3] + q[7] * l[1],
        q[1] * l[2] + q[3] * l[1] + q[4] * l[0],
        q[1] * l[3] + q[6] * l[1] + q[7] * l[0],
        q[3] * l[2] + q[5] * l[0],
        q[3] * l[3] + q[6] * l[2] + q[8] * l[0],
        q[6] * l[3] + q[9] * l[0],
        q[4] * l[2] + q[5] * l[1],
        q[4] * l[3] + q[7] * l[2] + q[8] * l[1],
        q[7] * l[3] + q[9] * l[1],
        q[5] * l[2],
        q[5] * l[3] + q[8] * l[2],
        q[8] * l[3] + q[9] * l[2],
        q[9] * l[3],
    ]
}

fn add<const N: usize>(a: &mut [f64; N], b: &[f64; N], factor: f64) {
    for (a, b) in a.iter_mut().zip(b) {
        *a += factor * b;
    }
}

/// The ten cubics `E Eᵀ E − ½ tr(E Eᵀ) E = 0` and `det E = 0` in the coordinates of the null space.
fn constraints(basis: &[[f64; 9]; 4]) -> [Cubic; 10] {
    let e: [Linear; 9] = std::array::from_fn(|k| std::array::from_fn(|j| basis[j][k]));
    let mut lambda = [[[0.0; 10]; 3]; 3];
    for i in 0..3 {
        for j in 0..=i {
            let mut sum = [0.0; 10];
            for k in 0..3 {
                add(&mut sum, &times(&e[3 * i + k], &e[3 * j + k]), 1.0);
            }
            lambda[i][j] = sum;
            lambda[j][i] = sum;
        }
    }
    let mut trace = [0.0; 10];
    for (i, row) in lambda.iter().enumerate() {
        add(&mut trace, &row[i], 0.5);
    }
    for (i, row) in lambda.iter_mut().enumerate() {
        add(&mut row[i], &trace, -1.0);
    }
    let mut result = [[0.0; 20]; 10];
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                add(&mut result[3 * i + j], &times_linear(&lambda[i][k], &e[3 * k + j]), 1.0);
            }
        }
    }
    for (k, (p, q)) in [(0, (1, 2)), (1, (2, 0)), (2, (0, 1))] {
        let mut minor = times(&e[3 + p], &e[6 + q]);
        add(&mut minor, &times(&e[3 + q], &e[6 + p]), -1.0);
        add(&mut result[9], &times_linear(&minor, &e[k]), 1.0);
    }
    result
}

/// Eliminates with the basis as it is, or, where a pivot is small (the determinant of `B(z)` would
/// cancel to noise), with the basis vectors in another order. The basis used and the reduced
/// system.
fn best_elimination(mut basis: [[f64; 9]; 4]) -> Option<([[f64; 9]; 4], [Cubic; 10])> {
    /// Source: judgement: well above rounding, after division of cubics in f64.
    const GOOD_PIVOT: f64 = 2e-3;
    let mut best = None;
    let mut best_pivot = 0.0;
    for _ in 0..4 {
        if let Some((eliminated, pivot)) = eliminate(constraints(&basis))
            && pivot > best_pivot
        {
            best = Some((basis, eliminated));
            best_pivot = pivot;
        }
        if best_pivot > GOOD_PIVOT {
            break;
        }
        basis.rotate_left(1);
    }
    best
}

/// Gaussian elimination of the first ten monomials with partial pivoting; only the last six rows
/// are reduced above the diagonal, for only they are used. With the smallest pivot; `None` where
/// the system is singular.
fn eliminate(mut m: [Cubic; 10]) -> Option<([Cubic; 10], f64)> {
    let scale = m.iter().flatten().fold(0.0_f64, |s, x| s.max(x.abs()));
    let mut smallest = f64::INFINITY;
    for i in 0..10 {
        let pivot = (i..10).max_by(|&p, &q| m[p][i].abs().total_cmp(&m[q][i].abs()))?;
        m.swap(i, pivot);
        let p = m[i][i];
        if p.is_nan() || p.abs() <= 1e-13 * scale {
            return None;
        }
        smallest = smallest.min(p.abs());
        for x in &mut m[i][i..] {
            *x /= p;
        }
        let row = m[i];
        let first = if i < 4 { i + 1 } else { 4 };
        for (r, other) in m.iter_mut().enumerate().skip(first) {
            let factor = other[i];
            if r != i && factor != 0.0 {
                for (x, y) in other[i..].iter_mut().zip(&row[i..]) {
                    *x -= factor * y;
                }
            }
        }
    }
    Some((m, smallest))
}

/// The 3 × 3 matrix `B(z)` with `B (x, y, 1)ᵀ = 0`: coefficients ascending in z, of degree 3, 3 and
/// 4.
fn polynomial_matrix(m: &[Cubic; 10]) -> [[[f64; 5]; 3]; 3] {
    std::array::from_fn(|r| {
        // Rows 4, 6, 8 lead with x²z, y²z, xyz; rows 5, 7, 9 with x², y², xy: (first) − z (second).
        let (p, q) = (&m[4 + 2 * r], &m[5 + 2 * r]);
        let [x, y] = [10, 13].map(|i| [p[i + 2], p[i + 1] - q[i + 2], p[i] - q[i + 1], -q[i], 0.0]);
        [x, y, [p[19], p[18] - q[19], p[17] - q[18], p[16] - q[17], -q[16]]]
    })
}

fn multiply_add(a: &[f64], b: &[f64], sign: f64, out: &mut [f64; 11]) {
    for (i, a) in a.iter().enumerate() {
        for (j, b) in b.iter().enumerate() {
            out[i + j] += sign * a * b;
        }
    }
}

/// `det B(z)`, degree 10, ascending.
fn determinant(b: &[[[f64; 5]; 3]; 3]) -> [f64; 11] {
    let mut result = [0.0; 11];
    for (k, (p, q)) in [(0, (1, 2)), (1, (2, 0)), (2, (0, 1))] {
        let mut minor = [0.0; 11];
        multiply_add(&b[p][0][..4], &b[q][1][..4], 1.0, &mut minor);
        multiply_add(&b[q][0][..4], &b[p][1][..4], -1.0, &mut minor);
        multiply_add(&minor[..7], &b[k][2], 1.0, &mut result);
    }
    result
}

/// The null vector `(x, y, 1)` of `B(z)`: the longest cross product of two of its rows.
fn solve_xy(b: &[[[f64; 5]; 3]; 3], z: f64) -> Option<(f64, f64)> {
    let rows: [DVec3; 3] = std::array::from_fn(|r| {
        DVec3::from_array([0, 1, 2].map(|c| evaluate(&b[r][c], z))).normalize_or_zero()
    });
    let crosses = [rows[0].cross(rows[1]), rows[1].cross(rows[2]), rows[2].cross(rows[0])];
    let n = crosses.into_iter().max_by(|p, q| p.length_squared().total_cmp(&q.length_squared()))?;
    let (x, y) = (n.x / n.z, n.y / n.z);
    (x.is_finite() && y.is_finite()).then_some((x, y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solvers::testing::{Shape, TwoViews, array, two_views};
    use crate::solvers::{essential_from_pose, pose_from_essential};
    use scene::pose::rotation_angle;

    fn solve(s: &TwoViews) -> Vec<DMat3> {
        let (a, b): (Vec<_>, Vec<_>) =
            s.a.iter().zip(&s.b).map(|(a, b)| (a.extend(1.0), b.extend(1.0))).unzip();
        essential_5pt(&array(&a), &array(&b))
    }

    fn distance(e: &DMat3, truth: &DMat3) -> f64 {
        let unit = |m: &DMat3| *m * (1.0 / m.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt());
        let (e, t) = (unit(e), unit(truth));
        let norm = |m: DMat3| m.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt();
        norm(e - t).min(norm(e + t))
    }

    fn best(s: &TwoViews) -> f64 {
        let truth = essential_from_pose(&s.b_from_a);
        solve(s).iter().map(|e| distance(e, &truth)).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn recovers_the_essential_matrix_from_five_exact_pairs_in_any_unit() {
        let mut errors: Vec<f64> = Vec::new();
        for seed in 0..100 {
            for unit in [1e-6, 1.0, 1e6] {
                let error = best(&two_views(seed, 5, Shape::General, unit));
                assert!(error < 1e-4, "seed {seed} unit {unit}: {error}");
                errors.push(error);
            }
        }
        errors.sort_by(f64::total_cmp);
        assert!(errors[errors.len() / 2] < 1e-10, "median {}", errors[errors.len() / 2]);
    }

    #[test]
    fn a_plane_does_not_confuse_it() {
        for seed in 0..100 {
            let error = best(&two_views(seed, 5, Shape::Plane, 1.0));
            assert!(error < 1e-3, "seed {seed}: {error}");
        }
    }

    #[test]
    fn every_solution_is_an_essential_matrix_through_the_pairs() {
        for seed in 0..100 {
            let s = two_views(seed, 5, Shape::General, 1.0);
            for e in solve(&s) {
                let (_, values, _) = crate::solvers::linalg::svd3(&e);
                assert!((values.x - values.y).abs() < 1e-3 && values.z < 1e-3, "seed {seed}: {values}");
                for (a, b) in s.a.iter().zip(&s.b) {
                    assert!(b.extend(1.0).dot(e * a.extend(1.0)).abs() < 1e-10, "seed {seed}");
                }
            }
        }
    }

    #[test]
    fn degenerate_pairs_give_finite_matrices_or_none() {
        for seed in 0..100 {
            for shape in [Shape::Line, Shape::NoBaseline, Shape::Infinity] {
                let found = solve(&two_views(seed, 5, shape, 1.0));
                assert!(found.iter().all(|e| e.is_finite()), "seed {seed} {shape:?}");
            }
        }
        let same = [DVec3::Z; 5];
        assert!(essential_5pt(&same, &same).iter().all(|e| e.is_finite()));
        let nan = [DVec3::NAN; 5];
        assert!(essential_5pt(&nan, &same).is_empty());
        assert!(essential_5pt(&[DVec3::ZERO; 5], &same).iter().all(|e| e.is_finite()));
        let infinite = [DVec3::splat(f64::INFINITY); 5];
        assert!(essential_5pt(&infinite, &same).iter().all(|e| e.is_finite()));
    }

    #[test]
    fn its_pose_is_the_true_one() {
        for seed in 0..100 {
            let s = two_views(seed, 30, Shape::General, 1.0);
            let rays: Vec<_> = s.a.iter().zip(&s.b).map(|(a, b)| (a.extend(1.0), b.extend(1.0))).collect();
            let truth = essential_from_pose(&s.b_from_a);
            let found = solve(&s);
            let e = found.iter().min_by(|p, q| distance(p, &truth).total_cmp(&distance(q, &truth))).unwrap();
            let (pose, votes) = pose_from_essential(e, &rays).unwrap();
            assert_eq!(votes.in_front, 30, "seed {seed}");
            assert!(rotation_angle(pose.rotation, s.b_from_a.rotation) < 1e-4, "seed {seed}");
            assert!(
                crate::solvers::testing::angle(pose.translation, s.b_from_a.translation) < 1e-3,
                "seed {seed}"
            );
        }
    }
}
