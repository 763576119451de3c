//! Fundamental matrices of seven point pairs.

use super::linalg::{mat3_from_rows, null_space};
use super::polynomial::real_roots;
use glam::{DMat3, DVec2};

/// Fundamental matrices with `b_iᵀ F a_i = 0` and `det F = 0` (at most three, unit Frobenius norm). The points
/// should be of the order of 1 (see [`super::Normaliser`]). Hartley & Zisserman, "Multiple View Geometry"
/// (2nd ed.), §11.1.2. Not refined.
pub fn fundamental_7pt(a: &[DVec2; 7], b: &[DVec2; 7]) -> Vec<DMat3> {
    let rows: [[f64; 9]; 7] = std::array::from_fn(|i| {
        let (a, b) = (a[i].extend(1.0).to_array(), b[i].extend(1.0).to_array());
        std::array::from_fn(|k| b[k / 3] * a[k % 3])
    });
    let basis: [[f64; 9]; 2] = null_space(&rows);
    let (f, g) = (mat3_from_rows(&basis[0]), mat3_from_rows(&basis[1]));
    // det(x F + G) is a cubic in x; the coefficients are determinants with mixed columns.
    let mixed = |p: &DMat3, q: &DMat3| {
        p.x_axis.dot(p.y_axis.cross(q.z_axis))
            + p.x_axis.dot(q.y_axis.cross(p.z_axis))
            + q.x_axis.dot(p.y_axis.cross(p.z_axis))
    };
    let cubic = [g.determinant(), mixed(&g, &f), mixed(&f, &g), f.determinant()];
    let scale = cubic.iter().fold(0.0_f64, |m, c| m.max(c.abs()));
    let mut result = Vec::with_capacity(3);
    for &x in real_roots(&cubic).iter() {
        let m = if x.abs() <= 1.0 { f * x + g } else { f + g * (1.0 / x) };
        let norm = m.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt();
        if norm > 0.0 && norm.is_finite() {
            result.push(m * (1.0 / norm));
        }
    }
    if scale > 0.0 && cubic[3].abs() <= 1e-15 * scale {
        result.push(f); // the root at infinity
    }
    result
}
