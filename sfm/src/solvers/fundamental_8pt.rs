//! Linear fits of epipolar matrices to many pairs.

use super::linalg::{mat3_from_rows, nearest_rank2, symmetric_eigen};
use glam::{DMat3, DVec2};

/// An isotropic change of coordinates `(x − centre) · scale` that puts points of any unit near the
/// origin at a mean distance of √2. Hartley, "In Defense of the Eight-Point Algorithm", PAMI 1997.
#[derive(Clone, Copy, Debug)]
pub(super) struct Normaliser {
    /// Mean of the points.
    pub centre: DVec2,
    /// √2 over their mean distance from it.
    pub scale: f64,
}

impl Normaliser {
    /// For these points; `None` where there are none, all coincide or one is not finite.
    pub(super) fn of(points: impl Iterator<Item = DVec2> + Clone) -> Option<Self> {
        let count = points.clone().count() as f64;
        let centre = points.clone().sum::<DVec2>() / count;
        let distance = points.map(|p| p.distance(centre)).sum::<f64>() / count;
        let scale = std::f64::consts::SQRT_2 / distance;
        (scale.is_finite() && scale > 0.0 && centre.is_finite()).then_some(Self { centre, scale })
    }

    /// The point in the new coordinates.
    pub(super) fn apply(&self, p: DVec2) -> DVec2 {
        (p - self.centre) * self.scale
    }

    /// The change of coordinates as a matrix on homogeneous points.
    pub(super) fn matrix(&self) -> DMat3 {
        let t = -self.centre * self.scale;
        DMat3::from_cols_array(&[self.scale, 0.0, 0.0, 0.0, self.scale, 0.0, t.x, t.y, 1.0])
    }
}

/// The fundamental matrix (rank 2, unit Frobenius norm) that minimises the algebraic error of
/// `b_iᵀ F a_i = 0` in normalised coordinates; `None` below eight pairs or where they do not
/// determine it. Hartley 1997.
pub(crate) fn fundamental_8pt(a: &[DVec2], b: &[DVec2]) -> Option<DMat3> {
    let n = a.len().min(b.len());
    if n < 8 {
        return None;
    }
    let na = Normaliser::of(a[..n].iter().copied())?;
    let nb = Normaliser::of(b[..n].iter().copied())?;
    let mut m = [[0.0; 9]; 9];
    for i in 0..n {
        let (p, q) = (na.apply(a[i]).extend(1.0).to_array(), nb.apply(b[i]).extend(1.0).to_array());
        let row: [f64; 9] = std::array::from_fn(|k| q[k / 3] * p[k % 3]);
        accumulate(&mut m, &row);
    }
    let (values, vectors) = symmetric_eigen(&m);
    if values[1].is_nan() || values[1] <= 1e-14 * values[8] {
        return None; // a family of solutions: too few independent pairs, or all on a plane
    }
    let f = nearest_rank2(&mat3_from_rows(&vectors[0]))?;
    let f = nb.matrix().transpose() * f * na.matrix();
    let norm = f.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt();
    let f = f * (1.0 / norm);
    f.is_finite().then_some(f)
}

/// `m += row rowᵀ`.
pub(super) fn accumulate<const N: usize>(m: &mut [[f64; N]; N], row: &[f64; N]) {
    for (line, x) in m.iter_mut().zip(row) {
        for (cell, y) in line.iter_mut().zip(row) {
            *cell += x * y;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solvers::sampson_sq;
    use crate::solvers::testing::{Shape, two_views};

    #[test]
    fn fits_exact_pairs_far_from_the_origin_and_in_any_unit() {
        for seed in 0..100 {
            for (scale, shift) in [(1.0, 0.0), (1e-6, 0.0), (1e6, 0.0), (1e3, 1e7)] {
                let s = two_views(seed, 30, Shape::General, 1.0);
                let change = |p: &DVec2| *p * scale + DVec2::splat(shift);
                let a: Vec<DVec2> = s.a.iter().map(change).collect();
                let b: Vec<DVec2> = s.b.iter().map(change).collect();
                let f = fundamental_8pt(&a, &b).unwrap_or_else(|| panic!("seed {seed} {scale} {shift}"));
                let worst = a.iter().zip(&b).map(|(a, b)| sampson_sq(&f, *a, *b)).fold(0.0, f64::max).sqrt();
                let rounding = 1e-7 * shift; // f of pixels around 1e7 keeps half of the digits
                assert!(worst < 1e-7 * scale + rounding, "seed {seed} {scale} {shift}: {worst}");
            }
        }
    }

    #[test]
    fn planes_lines_and_senseless_points_have_none() {
        for seed in 0..100 {
            for shape in [Shape::Plane, Shape::Line] {
                let s = two_views(seed, 30, shape, 1.0);
                assert!(fundamental_8pt(&s.a, &s.b).is_none(), "seed {seed} {shape:?}");
            }
        }
        for bad in [DVec2::NAN, DVec2::INFINITY, DVec2::ZERO] {
            assert!(fundamental_8pt(&[bad; 9], &[DVec2::ONE; 9]).is_none(), "{bad}");
        }
        assert!(fundamental_8pt(&[], &[]).is_none());
    }
}
