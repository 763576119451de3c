//! Fundamental matrices of seven point pairs.

use super::linalg::{determinant_of_pencil, mat3_from_rows, null_space};
use super::polynomial::real_roots;
use glam::{DMat3, DVec2};

/// Fundamental matrices with `b_iᵀ F a_i = 0` and `det F = 0` (at most three, unit Frobenius norm).
/// The points should be of the order of 1 (see [`super::fundamental_8pt::Normaliser`]). Hartley &
/// Zisserman, "Multiple View Geometry" (2nd ed.),  11.1.2. Not refined.
pub(crate) fn fundamental_7pt(a: &[DVec2; 7], b: &[DVec2; 7]) -> Vec<DMat3> {
    let rows: [[f64; 9]; 7] = std::array::from_fn(|i| {
        let (a, b) = (a[i].extend(1.0).to_array(), b[i].extend(1.0).to_array());
        std::array::from_fn(|k| b[k / 3] * a[k % 3])
    });
    let basis: [[f64; 9]; 2] = null_space(&rows);
    let (f, g) = (mat3_from_rows(&basis[0]), mat3_from_rows(&basis[1]));
    let cubic = determinant_of_pencil(&g, &f);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solvers::fundamental_8pt::Normaliser;
    use crate::solvers::sampson_sq;
    use crate::solvers::testing::{Shape, TwoViews, array, two_views};

    /// Largest Sampson distance of all pairs under the best solution of the first seven, relative
    /// to the extent.
    fn best(s: &TwoViews) -> f64 {
        let (na, nb) =
            (Normaliser::of(s.a.iter().copied()).unwrap(), Normaliser::of(s.b.iter().copied()).unwrap());
        let a: Vec<DVec2> = s.a.iter().map(|p| na.apply(*p)).collect();
        let b: Vec<DVec2> = s.b.iter().map(|p| nb.apply(*p)).collect();
        let worst =
            |f: &DMat3| a.iter().zip(&b).map(|(a, b)| sampson_sq(f, *a, *b)).fold(0.0, f64::max).sqrt();
        fundamental_7pt(&array(&a), &array(&b)).iter().map(worst).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn explains_all_other_exact_pairs_in_any_unit() {
        let mut errors = Vec::new();
        for seed in 0..100 {
            for unit in [1e-6, 1.0, 1e6] {
                let error = best(&two_views(seed, 30, Shape::General, unit));
                assert!(error < 1e-5, "seed {seed} unit {unit}: {error}");
                errors.push(error);
            }
        }
        errors.sort_by(f64::total_cmp);
        assert!(errors[errors.len() / 2] < 1e-11, "median {}", errors[errors.len() / 2]);
    }

    #[test]
    fn solutions_are_singular_and_pass_through_the_sample() {
        for seed in 0..100 {
            for shape in [Shape::General, Shape::Plane, Shape::Line, Shape::NoBaseline, Shape::Infinity] {
                let s = two_views(seed, 7, shape, 1.0);
                for f in fundamental_7pt(&array(&s.a), &array(&s.b)) {
                    assert!(f.is_finite() && f.determinant().abs() < 1e-9, "seed {seed} {shape:?}");
                    for (a, b) in s.a.iter().zip(&s.b) {
                        let c = b.extend(1.0).dot(f * a.extend(1.0));
                        assert!(c.abs() < 1e-9, "seed {seed} {shape:?}: {c}");
                    }
                }
            }
        }
    }

    #[test]
    fn senseless_points_give_no_senseless_matrix() {
        let zero = [DVec2::ZERO; 7];
        for bad in [DVec2::NAN, DVec2::INFINITY, DVec2::splat(1e300), DVec2::ZERO] {
            assert!(fundamental_7pt(&[bad; 7], &zero).iter().all(|f| f.is_finite()), "{bad}");
        }
    }
}
