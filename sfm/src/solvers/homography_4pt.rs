//! Homographies of four and of many point pairs.

use super::fundamental_8pt::{Normaliser, accumulate};
use super::linalg::{mat3_from_rows, symmetric_eigen};
use glam::{DMat3, DVec2, DVec3};

/// The homography `b_i ~ H a_i` (unit Frobenius norm): both quadruples are taken to the projective
/// basis. `None` where three points of a side are collinear, or where no plane seen from one side
/// by both cameras can give the four pairs (a weight would be negative). Hartley & Zisserman (2nd
/// ed.),  4.1,  21.4.
pub(crate) fn homography_4pt(a: &[DVec2; 4], b: &[DVec2; 4]) -> Option<DMat3> {
    let (origin_a, origin_b) = (a[0], b[0]); // far from the origin the determinants below would cancel
    let (basis_a, weights_a) = projective_basis(&a.map(|p| p - origin_a))?;
    let (basis_b, weights_b) = projective_basis(&b.map(|p| p - origin_b))?;
    let ratio = weights_b / weights_a;
    let h = basis_b * DMat3::from_diagonal(ratio) * basis_a.inverse();
    if !(ratio.min_element() > 0.0 && h.determinant() > 0.0) {
        return None;
    }
    unit(translation(origin_b) * h * translation(-origin_a))
}

fn translation(t: DVec2) -> DMat3 {
    DMat3::from_cols(DVec3::X, DVec3::Y, t.extend(1.0))
}

/// The first three points as columns, and the weights with which they sum to the fourth.
fn projective_basis(p: &[DVec2; 4]) -> Option<(DMat3, DVec3)> {
    let m = DMat3::from_cols(p[0].extend(1.0), p[1].extend(1.0), p[2].extend(1.0));
    let area = m.determinant();
    let size = (p[1] - p[0])
        .length_squared()
        .max((p[2] - p[0]).length_squared())
        .max((p[3] - p[0]).length_squared());
    let q = p[3].extend(1.0);
    let parts = DVec3::new(
        DMat3::from_cols(q, m.y_axis, m.z_axis).determinant(),
        DMat3::from_cols(m.x_axis, q, m.z_axis).determinant(),
        DMat3::from_cols(m.x_axis, m.y_axis, q).determinant(),
    );
    let smallest = area.abs().min(parts.abs().min_element());
    (smallest > 1e-10 * size).then(|| (m, parts / area))
}

/// The homography that minimises the algebraic error of `b_i × H a_i = 0` in normalised coordinates
/// (unit Frobenius norm); `None` below four pairs or where they do not determine it. Hartley &
/// Zisserman, alg. 4.2.
pub(crate) fn homography_dlt(a: &[DVec2], b: &[DVec2]) -> Option<DMat3> {
    let n = a.len().min(b.len());
    if n < 4 {
        return None;
    }
    let na = Normaliser::of(a[..n].iter().copied())?;
    let nb = Normaliser::of(b[..n].iter().copied())?;
    let mut m = [[0.0; 9]; 9];
    for i in 0..n {
        let (p, q) = (na.apply(a[i]), nb.apply(b[i]));
        accumulate(&mut m, &[p.x, p.y, 1.0, 0.0, 0.0, 0.0, -q.x * p.x, -q.x * p.y, -q.x]);
        accumulate(&mut m, &[0.0, 0.0, 0.0, p.x, p.y, 1.0, -q.y * p.x, -q.y * p.y, -q.y]);
    }
    let (values, vectors) = symmetric_eigen(&m);
    if values[1].is_nan() || values[1] <= 1e-12 * values[8] {
        return None;
    }
    let back = DMat3::from_diagonal(DVec3::new(1.0 / nb.scale, 1.0 / nb.scale, 1.0));
    unit(translation(nb.centre) * back * mat3_from_rows(&vectors[0]) * na.matrix())
}

/// Scaled to unit norm, sign such that the determinant is positive; `None` where singular.
fn unit(h: DMat3) -> Option<DMat3> {
    let norm = h.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt();
    let h = h * (h.determinant().signum() / norm);
    (h.is_finite() && h.determinant() > 0.0).then_some(h)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solvers::testing::{Shape, array, two_views};
    use crate::solvers::transfer_sq;

    #[test]
    fn transfers_all_other_points_of_the_plane_far_from_the_origin_and_in_any_unit() {
        for seed in 0..100 {
            for (scale, shift) in [(1.0, 0.0), (1e-6, 0.0), (1e6, 0.0), (1e3, 1e7)] {
                let s = two_views(seed, 30, Shape::Plane, 1.0);
                let change = |p: &DVec2| *p * scale + DVec2::splat(shift);
                let a: Vec<DVec2> = s.a.iter().map(change).collect();
                let b: Vec<DVec2> = s.b.iter().map(change).collect();
                let minimal = homography_4pt(&array(&a), &array(&b));
                for h in [minimal, homography_dlt(&a, &b)] {
                    let h = h.unwrap_or_else(|| panic!("seed {seed} scale {scale}"));
                    let worst =
                        a.iter().zip(&b).map(|(a, b)| transfer_sq(&h, *a, *b)).fold(0.0, f64::max).sqrt();
                    assert!(
                        worst < 1e-5 * scale + 1e-6 * shift / 1e5,
                        "seed {seed} {scale} {shift}: {worst}"
                    );
                }
            }
        }
    }

    #[test]
    fn collinear_and_senseless_points_have_none() {
        for seed in 0..100 {
            let s = two_views(seed, 8, Shape::Line, 1.0);
            assert!(homography_4pt(&array(&s.a), &array(&s.b)).is_none(), "seed {seed}");
            assert!(homography_dlt(&s.a, &s.b).is_none(), "seed {seed}");
        }
        let square = [DVec2::ZERO, DVec2::X, DVec2::Y, DVec2::ONE];
        for bad in [DVec2::NAN, DVec2::INFINITY, DVec2::splat(1e300), DVec2::ZERO] {
            assert!(homography_4pt(&[bad; 4], &square).is_none(), "{bad}");
            assert!(homography_dlt(&[bad; 8], &[DVec2::ONE; 8]).is_none(), "{bad}");
        }
        assert!(homography_dlt(&square[..3], &square[..3]).is_none());
    }

    #[test]
    fn refuses_a_plane_seen_from_behind() {
        let square = [DVec2::ZERO, DVec2::X, DVec2::Y, DVec2::ONE];
        let mirrored = square.map(|p| DVec2::new(-p.x, p.y));
        assert!(homography_4pt(&square, &mirrored).is_none());
        let crossed = [square[0], square[1], square[3], square[2]];
        assert!(homography_4pt(&square, &crossed).is_none());
    }
}
