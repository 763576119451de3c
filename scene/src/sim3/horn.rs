//! The rotation that fits a 3×3 matrix best, by Horn's quaternion method.

use glam::{DMat3, DQuat, DVec3};

/// The rotation R that maximises `tr(Rᵀ M)`: the one nearest to `M` (and to any multiple `s M`, s >
/// 0) in the Frobenius norm. B. K. P. Horn, "Closed-form solution of absolute orientation using
/// unit quaternions", JOSA A 4(4), 1987: the eigenvector of the largest eigenvalue of a symmetric
/// 4×4 matrix. Never a reflection. The identity where `M` is zero or not finite.
pub fn nearest_rotation(m: DMat3) -> DQuat {
    let size = m.to_cols_array().iter().fold(0.0_f64, |a, v| a.max(v.abs()));
    if size <= 0.0 || !m.is_finite() {
        return DQuat::IDENTITY;
    }
    let m = DMat3::from_cols(m.x_axis / size, m.y_axis / size, m.z_axis / size); // safe at any scale
    // Entry (row, column) of M; glam stores columns.
    let e = |r: usize, c: usize| m.col(c)[r];
    let n = [
        [e(0, 0) + e(1, 1) + e(2, 2), e(2, 1) - e(1, 2), e(0, 2) - e(2, 0), e(1, 0) - e(0, 1)],
        [e(2, 1) - e(1, 2), e(0, 0) - e(1, 1) - e(2, 2), e(0, 1) + e(1, 0), e(0, 2) + e(2, 0)],
        [e(0, 2) - e(2, 0), e(0, 1) + e(1, 0), e(1, 1) - e(0, 0) - e(2, 2), e(1, 2) + e(2, 1)],
        [e(1, 0) - e(0, 1), e(0, 2) + e(2, 0), e(1, 2) + e(2, 1), e(2, 2) - e(0, 0) - e(1, 1)],
    ];
    let [w, x, y, z] = largest_eigenvector(n);
    DQuat::from_xyzw(x, y, z, w).normalize()
}

/// The unit eigenvector of the least eigenvalue of a symmetric matrix without negative ones.
pub(crate) fn least_eigenvector(m: DMat3) -> DVec3 {
    // Turned over, the least eigenvalue is the largest; the fourth row stands apart below all of
    // them.
    let top = m.x_axis.x + m.y_axis.y + m.z_axis.z;
    let mut turned = [[0.0; 4]; 4];
    for (r, row) in turned.iter_mut().take(3).enumerate() {
        for (c, v) in row.iter_mut().take(3).enumerate() {
            *v = if r == c { top } else { 0.0 } - m.col(c)[r];
        }
    }
    turned[3][3] = -1.0;
    let [x, y, z, _] = largest_eigenvector(turned);
    DVec3::new(x, y, z).normalize_or(DVec3::Z)
}

/// Cyclic Jacobi rotations (Golub and Van Loan, section 8.5) on a symmetric 4×4 matrix.
pub(crate) fn largest_eigenvector(mut a: [[f64; 4]; 4]) -> [f64; 4] {
    let mut v = [[0.0; 4]; 4]; // columns become the eigenvectors
    (0..4).for_each(|i| v[i][i] = 1.0);
    for _ in 0..30 {
        let off: f64 =
            (0..4).flat_map(|p| (p + 1..4).map(move |q| (p, q))).map(|(p, q)| a[p][q] * a[p][q]).sum();
        if off < 1e-34 {
            break;
        }
        for p in 0..3 {
            for q in p + 1..4 {
                if a[p][q] == 0.0 {
                    continue;
                }
                let tau = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let t = tau.signum() / (tau.abs() + tau.hypot(1.0));
                let c = 1.0 / t.hypot(1.0);
                rotate(&mut a, &mut v, p, q, c, t * c);
            }
        }
    }
    let best = (0..4).max_by(|&i, &j| a[i][i].total_cmp(&a[j][j])).unwrap_or(0);
    [v[0][best], v[1][best], v[2][best], v[3][best]]
}

/// `A ← Jᵀ A J`, `V ← V J` for the rotation in the plane (p, q).
fn rotate(a: &mut [[f64; 4]; 4], v: &mut [[f64; 4]; 4], p: usize, q: usize, c: f64, s: f64) {
    for row in a.iter_mut().chain(v.iter_mut()) {
        (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
    }
    let (row_p, row_q) = (a[p], a[q]);
    a[p] = std::array::from_fn(|k| c * row_p[k] - s * row_q[k]);
    a[q] = std::array::from_fn(|k| s * row_p[k] + c * row_q[k]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::rotation_angle;
    use crate::rng::rng;
    use rand::Rng;

    #[test]
    fn a_scaled_rotation_is_recovered_at_any_size() {
        for seed in 0..100 {
            let mut r = rng(seed, "horn", 0);
            let mut v = || r.random_range(-1.0..1.0);
            let q = DQuat::from_xyzw(v(), v(), v(), v()).normalize();
            for scale in [1e-200, 1e-6, 1.0, 1e200] {
                let found = nearest_rotation(DMat3::from_quat(q) * scale);
                assert!(rotation_angle(found, q) < 1e-14, "seed {seed}, scale {scale}");
            }
        }
        let half_turn = DQuat::from_axis_angle(DVec3::Y, std::f64::consts::PI);
        assert!(rotation_angle(nearest_rotation(DMat3::from_quat(half_turn)), half_turn) < 1e-14);
    }

    #[test]
    fn a_reflection_yields_a_rotation_and_nonsense_the_identity() {
        let found = nearest_rotation(DMat3::from_diagonal(DVec3::new(1.0, 1.0, -0.1)));
        assert!(rotation_angle(found, DQuat::IDENTITY) < 1e-12);
        assert_eq!(nearest_rotation(DMat3::ZERO), DQuat::IDENTITY);
        assert_eq!(nearest_rotation(DMat3::from_diagonal(DVec3::splat(f64::NAN))), DQuat::IDENTITY);
    }
}
