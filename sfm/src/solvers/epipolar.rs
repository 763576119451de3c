//! Epipolar and transfer errors, squared.

use super::linalg::skew;
use glam::{DMat3, DVec2, DVec3};
use scene::Pose;

/// Sampson's squared distance of the pair from the epipolar geometry `bᵀ F a = 0`: a first-order
/// approximation of the smallest `‖δa‖² + ‖δb‖²` that satisfies it, in the unit of the points
/// squared. Hartley & Zisserman (2nd ed.), eq. 11.9. Infinite where the gradient vanishes.
#[inline]
pub(crate) fn sampson_sq(f: &DMat3, a: DVec2, b: DVec2) -> f64 {
    let fa = f.x_axis * a.x + f.y_axis * a.y + f.z_axis;
    let (bx, by) =
        (f.x_axis.x * b.x + f.x_axis.y * b.y + f.x_axis.z, f.y_axis.x * b.x + f.y_axis.y * b.y + f.y_axis.z);
    let c = fa.x * b.x + fa.y * b.y + fa.z;
    let gradient = fa.x * fa.x + fa.y * fa.y + bx * bx + by * by;
    if gradient > 0.0 { c * c / gradient } else { f64::INFINITY }
}

/// Squared transfer error `‖b − H a‖²`; infinite where `H a` is at or behind the plane at infinity.
#[inline]
pub(crate) fn transfer_sq(h: &DMat3, a: DVec2, b: DVec2) -> f64 {
    let p = h.x_axis * a.x + h.y_axis * a.y + h.z_axis;
    if p.z > 0.0 { (p.truncate() / p.z).distance_squared(b) } else { f64::INFINITY }
}

/// `E = [t]× R` of a relative pose; zero for a pure rotation.
pub(crate) fn essential_from_pose(b_from_a: &Pose) -> DMat3 {
    skew(b_from_a.translation) * b_from_a.matrix()
}

/// Depths `(λ_a, λ_b)` along the two rays at which they pass closest, in units of the baseline: the
/// solution of `λ_b b = λ_a R a + t` (least squares in the plane normal to `a × b`). `None` for
/// parallel rays.
pub(super) fn ray_depths(b_from_a: &Pose, ray_a: DVec3, ray_b: DVec3) -> Option<(f64, f64)> {
    let a = b_from_a.rotation * ray_a;
    let n = a.cross(ray_b);
    let n2 = n.length_squared();
    let t = b_from_a.translation;
    let crossing = n2 > 1e-24 * a.length_squared() * ray_b.length_squared();
    crossing.then(|| (ray_b.cross(t).dot(n) / n2, a.cross(t).dot(n) / n2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solvers::testing::{Shape, two_views};

    #[test]
    fn exact_pairs_have_no_error_and_true_depths() {
        for seed in 0..100 {
            let s = two_views(seed, 10, Shape::General, 1.0);
            let e = essential_from_pose(&s.b_from_a);
            for i in 0..10 {
                assert!(sampson_sq(&e, s.a[i], s.b[i]) < 1e-24, "seed {seed}");
                let (a, b) = ray_depths(&s.b_from_a, s.a[i].extend(1.0), s.b[i].extend(1.0)).unwrap();
                assert!((a - s.points[i].z).abs() < 1e-7, "seed {seed}");
                assert!((b - s.b_from_a.transform(s.points[i]).z).abs() < 1e-7, "seed {seed}");
            }
        }
    }

    #[test]
    fn a_small_shift_costs_its_distance_from_the_epipolar_line() {
        // Sideways motion: lines are rows, both images share the error, so half of the squared
        // offset remains.
        let e = essential_from_pose(&Pose { translation: DVec3::X, ..Pose::IDENTITY });
        let error = sampson_sq(&e, DVec2::new(0.1, 0.2), DVec2::new(0.3, 0.2 + 1e-3));
        assert!((error - 0.5e-6).abs() < 1e-12, "{error}");
    }

    #[test]
    fn parallel_rays_and_vanishing_gradients_have_no_answer() {
        let pose = Pose { translation: DVec3::X, ..Pose::IDENTITY };
        assert!(ray_depths(&pose, DVec3::Z, DVec3::Z).is_none());
        assert!(ray_depths(&pose, DVec3::NAN, DVec3::Z).is_none());
        assert_eq!(sampson_sq(&DMat3::ZERO, DVec2::ZERO, DVec2::ZERO), f64::INFINITY);
        assert_eq!(sampson_sq(&DMat3::NAN, DVec2::ZERO, DVec2::ZERO), f64::INFINITY);
        assert_eq!(transfer_sq(&(DMat3::IDENTITY * -1.0), DVec2::ZERO, DVec2::ZERO), f64::INFINITY);
    }
}
