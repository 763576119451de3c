//! Small dense linear algebra of fixed size: null spaces, symmetric eigenproblems, 3 × 3 singular
//! values and positive definite systems. Golub & Van Loan, "Matrix Computations" (4th ed.),  5.1,
//!  4.2,  8.5,  8.6.3.

use glam::{DMat3, DVec3};

/// `K = N − M` orthonormal vectors orthogonal to the `M` rows of `a`: Householder QR of `aᵀ`. Where
/// the rows are dependent the null space is larger and some basis of a part of it is returned.
pub(crate) fn null_space<const M: usize, const N: usize, const K: usize>(a: &[[f64; N]; M]) -> [[f64; N]; K] {
    let mut rows = *a;
    let mut beta = [0.0; M];
    for j in 0..M {
        let norm = rows[j][j..].iter().map(|x| x * x).sum::<f64>().sqrt();
        if norm == 0.0 || !norm.is_finite() {
            continue;
        }
        let mut v = rows[j];
        v[..j].fill(0.0);
        v[j] += if v[j] < 0.0 { -norm } else { norm };
        beta[j] = 2.0 / v.iter().map(|x| x * x).sum::<f64>();
        rows[j] = v; // the reflector takes the place of the row it was made from
        for row in rows[j + 1..].iter_mut() {
            reflect(row, &v, beta[j], j);
        }
    }
    let mut basis = [[0.0; N]; K];
    for (k, vector) in basis.iter_mut().enumerate() {
        vector[M + k] = 1.0;
        for j in (0..M).rev() {
            reflect(vector, &rows[j], beta[j], j);
        }
    }
    basis
}

#[inline]
fn reflect<const N: usize>(x: &mut [f64; N], v: &[f64; N], beta: f64, from: usize) {
    let dot: f64 = x[from..].iter().zip(&v[from..]).map(|(x, v)| x * v).sum();
    for (x, v) in x[from..].iter_mut().zip(&v[from..]) {
        *x -= beta * dot * v;
    }
}

/// Eigenvalues in ascending order and their unit eigenvectors (row `i` belongs to value `i`) of a
/// symmetric matrix: cyclic Jacobi rotations.
pub(crate) fn symmetric_eigen<const N: usize>(matrix: &[[f64; N]; N]) -> ([f64; N], [[f64; N]; N]) {
    let mut a = *matrix;
    let mut v = [[0.0; N]; N];
    for (i, row) in v.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    let scale: f64 = a.iter().flatten().map(|x| x * x).sum();
    for _ in 0..30 {
        let off: f64 =
            (0..N).flat_map(|p| (p + 1..N).map(move |q| (p, q))).map(|(p, q)| a[p][q] * a[p][q]).sum();
        if off <= 1e-34 * scale || !off.is_finite() {
            break;
        }
        for p in 0..N {
            for q in p + 1..N {
                rotate(&mut a, &mut v, p, q);
            }
        }
    }
    let mut order: [usize; N] = std::array::from_fn(|i| i);
    order.sort_by(|&i, &j| a[i][i].total_cmp(&a[j][j]));
    (order.map(|i| a[i][i]), order.map(|i| v[i]))
}

/// One Jacobi rotation that makes `a[p][q]` zero; rows of `v` are turned with it.
fn rotate<const N: usize>(a: &mut [[f64; N]; N], v: &mut [[f64; N]; N], p: usize, q: usize) {
    if a[p][q] == 0.0 {
        return;
    }
    let tau = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
    let t = if tau >= 0.0 { 1.0 } else { -1.0 } / (tau.abs() + (1.0 + tau * tau).sqrt());
    let c = 1.0 / (1.0 + t * t).sqrt();
    let s = t * c;
    for row in a.iter_mut() {
        let (x, y) = (row[p], row[q]);
        row[p] = c * x - s * y;
        row[q] = s * x + c * y;
    }
    let (low, high) = a.split_at_mut(q);
    turn(&mut low[p], &mut high[0], c, s);
    let (low, high) = v.split_at_mut(q);
    turn(&mut low[p], &mut high[0], c, s);
}

fn turn<const N: usize>(x: &mut [f64; N], y: &mut [f64; N], c: f64, s: f64) {
    for (x, y) in x.iter_mut().zip(y) {
        (*x, *y) = (c * *x - s * *y, s * *x + c * *y);
    }
}

/// Solution of `a x = b` for a symmetric positive definite `a`, of which only the lower triangle is
/// read: Cholesky. `None` where it is not.
pub(crate) fn solve_spd<const N: usize>(a: &[[f64; N]; N], b: &[f64; N]) -> Option<[f64; N]> {
    let mut l = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..=i {
            let sum = a[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            if i != j {
                l[i][j] = sum / l[j][j];
            } else if sum > 0.0 && sum.is_finite() {
                l[i][i] = sum.sqrt();
            } else {
                return None;
            }
        }
    }
    let mut x = *b;
    for i in 0..N {
        x[i] = (x[i] - (0..i).map(|k| l[i][k] * x[k]).sum::<f64>()) / l[i][i];
    }
    for i in (0..N).rev() {
        x[i] = (x[i] - (i + 1..N).map(|k| l[k][i] * x[k]).sum::<f64>()) / l[i][i];
    }
    x.iter().all(|v| v.is_finite()).then_some(x)
}

/// `Σ w v vᵀ` of weighted vectors.
pub(crate) fn moments(vectors: impl Iterator<Item = (f64, DVec3)>) -> [[f64; 3]; 3] {
    let mut sum = [[0.0; 3]; 3];
    for (w, v) in vectors.map(|(w, v)| (w, v.to_array())) {
        (0..9).for_each(|k| sum[k / 3][k % 3] += w * v[k / 3] * v[k % 3]);
    }
    sum
}

/// `m = u · diag(s) · vᵀ` with `s` descending and `u`, `v` orthogonal (their determinants may be
/// −1): one-sided Jacobi, accurate for small singular values too.
pub(crate) fn svd3(m: &DMat3) -> (DMat3, DVec3, DMat3) {
    let mut a = [m.x_axis, m.y_axis, m.z_axis];
    let mut v = [DVec3::X, DVec3::Y, DVec3::Z];
    for _ in 0..30 {
        let mut turned = false;
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let (alpha, beta, gamma) = (a[p].length_squared(), a[q].length_squared(), a[p].dot(a[q]));
            if gamma.abs() <= 1e-16 * (alpha * beta).sqrt() || !gamma.is_finite() {
                continue;
            }
            turned = true;
            let zeta = (beta - alpha) / (2.0 * gamma);
            let t = if zeta >= 0.0 { 1.0 } else { -1.0 } / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
            let c = 1.0 / (1.0 + t * t).sqrt();
            let s = c * t;
            (a[p], a[q]) = (a[p] * c - a[q] * s, a[p] * s + a[q] * c);
            (v[p], v[q]) = (v[p] * c - v[q] * s, v[p] * s + v[q] * c);
        }
        if !turned {
            break;
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| a[j].length_squared().total_cmp(&a[i].length_squared()));
    let s = DVec3::from_array(order.map(|i| a[i].length()));
    let [a0, a1, a2] = order.map(|i| a[i]);
    let u0 = a0.try_normalize().unwrap_or(DVec3::X);
    let tiny = s.x * 1e-15;
    let u1 = if s.y > tiny { a1 / s.y } else { u0.any_orthonormal_vector() };
    let u2 = if s.z > tiny { a2 / s.z } else { u0.cross(u1) };
    (DMat3::from_cols(u0, u1, u2), s, DMat3::from_cols(v[order[0]], v[order[1]], v[order[2]]))
}

/// The rank-2 matrix nearest to `m` (Frobenius norm), scaled to unit norm. `None` for zero or
/// non-finite `m`.
pub(crate) fn nearest_rank2(m: &DMat3) -> Option<DMat3> {
    let (u, s, v) = svd3(m);
    let norm = s.x.hypot(s.y);
    let f = DMat3::from_cols(u.x_axis * (s.x / norm), u.y_axis * (s.y / norm), DVec3::ZERO) * v.transpose();
    f.is_finite().then_some(f)
}

/// Coefficients of `det(p + x q)`, ascending: determinants with mixed columns.
pub(crate) fn determinant_of_pencil(p: &DMat3, q: &DMat3) -> [f64; 4] {
    [p.determinant(), mixed_determinant(p, q), mixed_determinant(q, p), q.determinant()]
}

/// The sum of the determinants of `p` with one of its columns taken from `q`.
fn mixed_determinant(p: &DMat3, q: &DMat3) -> f64 {
    p.x_axis.dot(p.y_axis.cross(q.z_axis))
        + p.x_axis.dot(q.y_axis.cross(p.z_axis))
        + q.x_axis.dot(p.y_axis.cross(p.z_axis))
}

/// `[v]×`: `skew(v) w = v × w`.
pub(crate) fn skew(v: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, v.z, -v.y), DVec3::new(-v.z, 0.0, v.x), DVec3::new(v.y, -v.x, 0.0))
}

/// The matrix whose rows, one after another, are the nine numbers.
pub(crate) fn mat3_from_rows(m: &[f64; 9]) -> DMat3 {
    DMat3::from_cols_array(m).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;
    use scene::rng::rng;

    #[test]
    fn null_vectors_are_orthonormal_and_orthogonal_to_every_row() {
        for seed in 0..100 {
            let mut r = rng(seed, "null", 0);
            let mut a: [[f64; 9]; 5] =
                std::array::from_fn(|_| std::array::from_fn(|_| r.random_range(-1.0..1.0)));
            if seed % 3 == 0 {
                a[3] = a[1]; // dependent rows
            }
            let basis: [[f64; 9]; 4] = null_space(&a);
            let dot = |x: &[f64; 9], y: &[f64; 9]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
            for (i, v) in basis.iter().enumerate() {
                assert!(a.iter().all(|row| dot(row, v).abs() < 1e-13), "seed {seed}");
                for (j, w) in basis.iter().enumerate() {
                    assert!((dot(v, w) - if i == j { 1.0 } else { 0.0 }).abs() < 1e-13, "seed {seed}");
                }
            }
        }
    }

    #[test]
    #[allow(clippy::needless_range_loop)] // rows and columns at once
    fn eigenvectors_rebuild_the_matrix() {
        for seed in 0..100 {
            let mut r = rng(seed, "eigen", 0);
            let mut a = [[0.0; 9]; 9];
            for i in 0..9 {
                for j in 0..=i {
                    a[i][j] = r.random_range(-1.0..1.0);
                    a[j][i] = a[i][j];
                }
            }
            let (values, v) = symmetric_eigen(&a);
            assert!(values.windows(2).all(|w| w[0] <= w[1]), "seed {seed}");
            for i in 0..9 {
                for j in 0..9 {
                    let sum: f64 = (0..9).map(|k| values[k] * v[k][i] * v[k][j]).sum();
                    assert!((sum - a[i][j]).abs() < 1e-13, "seed {seed}");
                }
            }
        }
    }

    #[test]
    fn singular_values_rebuild_the_matrix_whatever_its_rank_and_scale() {
        for seed in 0..100 {
            let mut r = rng(seed, "svd", 0);
            let mut m = DMat3::from_cols_array(&std::array::from_fn(|_| r.random_range(-1.0..1.0)));
            match seed % 5 {
                1 => m.y_axis = m.x_axis * 2.0,
                2 => m = DMat3::from_cols(m.x_axis, m.x_axis * 0.5, m.x_axis * -3.0),
                3 => m *= 1e-12,
                4 => m *= 1e12,
                _ => {}
            }
            let (u, s, v) = svd3(&m);
            let again = u * DMat3::from_diagonal(s) * v.transpose();
            assert!((again - m).abs_diff_eq(DMat3::ZERO, 1e-14 * s.x), "seed {seed}");
            assert!((u * u.transpose()).abs_diff_eq(DMat3::IDENTITY, 1e-12), "seed {seed}");
            assert!((v * v.transpose()).abs_diff_eq(DMat3::IDENTITY, 1e-12), "seed {seed}");
            assert!(s.x >= s.y && s.y >= s.z && s.z >= 0.0, "seed {seed}");
        }
    }

    #[test]
    fn cholesky_solves_and_refuses_what_is_not_positive_definite() {
        let a = [[4.0, 2.0, 0.0], [2.0, 5.0, 1.0], [0.0, 1.0, 3.0]];
        let x = solve_spd(&a, &[8.0, 15.0, 11.0]).unwrap();
        assert!(x.iter().zip([1.0, 2.0, 3.0]).all(|(x, y)| (x - y).abs() < 1e-14));
        assert!(solve_spd(&[[1.0, 2.0], [2.0, 1.0]], &[1.0, 1.0]).is_none());
        assert!(solve_spd(&[[f64::NAN, 0.0], [0.0, 1.0]], &[1.0, 1.0]).is_none());
    }
}
