//! Real roots of polynomials of low degree.

/// Highest degree that [`real_roots`] takes.
/// Source: Nistér, PAMI 2004: the polynomial of five pairs has degree 10.
pub(super) const MAX_DEGREE: usize = 10;

/// At most [`MAX_DEGREE`] real numbers.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Roots {
    values: [f64; MAX_DEGREE],
    len: usize,
}

impl Roots {
    fn push(&mut self, x: f64) {
        if self.len < MAX_DEGREE && x.is_finite() {
            self.values[self.len] = x;
            self.len += 1;
        }
    }
}

impl std::ops::Deref for Roots {
    type Target = [f64];

    fn deref(&self) -> &[f64] {
        &self.values[..self.len]
    }
}

/// Real roots of `Σ c[i] xⁱ` (degree ≤ 10), each once, in no special order. Roots within [−1, 1]
/// come from the polynomial itself, the others from the reversed one, so that huge roots and
/// vanishing leading coefficients do no harm. Between neighbouring extrema there is at most one
/// root (Yuksel, "High-Performance Polynomial Root Finding for Graphics", 2022): the extrema are
/// the roots of the derivative, found in the same way. Empty for constants and for coefficients
/// that are not finite.
pub(super) fn real_roots(c: &[f64]) -> Roots {
    real_roots_with_tolerance(c, 1e-14)
}

/// Like [`real_roots`]; an extremum counts as a double root where the value is below `tolerance`
/// times the sum of the absolute terms: the relative error of the coefficients.
pub(super) fn real_roots_with_tolerance(c: &[f64], tolerance: f64) -> Roots {
    let mut roots = Roots::default();
    let scale = c.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    if c.len() < 2 || c.len() > MAX_DEGREE + 1 || scale == 0.0 || !c.iter().all(|x| x.is_finite()) {
        return roots;
    }
    let n = c.len();
    let mut forward = [0.0; MAX_DEGREE + 1];
    let mut reversed = [0.0; MAX_DEGREE + 1];
    for (i, x) in c.iter().enumerate() {
        forward[i] = x / scale;
        reversed[n - 1 - i] = x / scale;
    }
    for &x in roots_in_unit_interval(&forward[..n], tolerance).iter() {
        roots.push(x);
    }
    for &y in roots_in_unit_interval(&reversed[..n], tolerance).iter() {
        if y.abs() < 1.0 && y.abs() > 1e-300 {
            roots.push(1.0 / y);
        }
    }
    roots
}

/// Real roots of `a x² + b x + c`, without cancellation; none, one (where `a` vanishes) or two.
pub(super) fn quadratic_roots(a: f64, b: f64, c: f64) -> Roots {
    let mut roots = Roots::default();
    let discriminant = b * b - 4.0 * a * c;
    // A double root may come out slightly negative: within rounding of the terms it counts as zero.
    if discriminant < -1e-14 * (b * b + (4.0 * a * c).abs()) || !discriminant.is_finite() {
        return roots;
    }
    let q = -0.5 * (b + if b < 0.0 { -1.0 } else { 1.0 } * discriminant.max(0.0).sqrt());
    if a != 0.0 {
        roots.push(q / a);
    }
    if q != 0.0 {
        roots.push(c / q);
    } else if a != 0.0 {
        roots.push(0.0);
    }
    roots
}

/// `Σ c[i] xⁱ`.
pub(super) fn evaluate(c: &[f64], x: f64) -> f64 {
    c.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// Roots of `c` within [−1, 1]. `c` has at least two coefficients.
fn roots_in_unit_interval(c: &[f64], tolerance: f64) -> Roots {
    let degree = c.len() - 1;
    // derivatives[k] is the k-th derivative up to a factor; its coefficients are used to degree −
    // k.
    let mut derivatives = [[0.0; MAX_DEGREE + 1]; MAX_DEGREE + 1];
    derivatives[0][..=degree].copy_from_slice(c);
    for k in 1..degree {
        for i in 0..=degree - k {
            derivatives[k][i] = derivatives[k - 1][i + 1] * (i + 1) as f64 / (degree - k + 1) as f64;
        }
    }
    let mut roots = Roots::default();
    for k in (0..degree).rev() {
        let p = &derivatives[k][..=degree - k];
        let slope = (degree - k > 1).then(|| &derivatives[k + 1][..degree - k]);
        roots = refine_level(p, slope, (degree - k) as f64, &roots, (k == 0).then_some(tolerance));
    }
    roots
}

/// Roots of `p` in [−1, 1] between its `extrema`; `slope · factor` is its derivative (`None`: p is
/// linear). Extrema that are zero within `double` count too, where it is given.
fn refine_level(
    p: &[f64],
    slope: Option<&[f64]>,
    factor: f64,
    extrema: &Roots,
    double: Option<f64>,
) -> Roots {
    let mut roots = Roots::default();
    let (mut left, mut at_left) = (-1.0, evaluate(p, -1.0));
    for i in 0..=extrema.len {
        let right = if i < extrema.len { extrema.values[i] } else { 1.0 };
        let at_right = evaluate(p, right);
        if (at_left < 0.0) != (at_right < 0.0) {
            roots.push(bracketed_root(p, slope, factor, (left, right), at_left < 0.0));
        } else if i < extrema.len && double.is_some_and(|t| at_right.abs() <= t * magnitude(p, right)) {
            roots.push(right);
        }
        (left, at_left) = (right, at_right);
    }
    roots
}

/// `Σ |cᵢ xⁱ|`.
fn magnitude(p: &[f64], x: f64) -> f64 {
    p.iter().rev().fold(0.0, |sum, c| sum * x.abs() + c.abs())
}

/// The one root between two points of opposite sign: Newton's method kept inside a shrinking
/// bracket.
fn bracketed_root(p: &[f64], slope: Option<&[f64]>, factor: f64, bracket: (f64, f64), rises: bool) -> f64 {
    let Some(slope) = slope else { return (-p[0] / p[1]).clamp(bracket.0, bracket.1) };
    let (mut low, mut high) = bracket;
    let mut x = 0.5 * (low + high);
    for _ in 0..100 {
        let value = evaluate(p, x);
        if value == 0.0 {
            return x;
        }
        if (value < 0.0) == rises {
            low = x
        } else {
            high = x
        }
        let newton = x - value / (factor * evaluate(slope, x));
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - x).abs() <= 1e-16 + 2e-16 * x.abs() {
            return next;
        }
        x = next;
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;
    use scene::rng::rng;

    fn from_roots(roots: &[f64]) -> Vec<f64> {
        let mut c = vec![1.0];
        for r in roots {
            let mut next = vec![0.0; c.len() + 1];
            for (i, a) in c.iter().enumerate() {
                next[i + 1] += a;
                next[i] -= r * a;
            }
            c = next;
        }
        c
    }

    fn sorted(roots: &Roots) -> Vec<f64> {
        let mut r = roots.to_vec();
        r.sort_by(f64::total_cmp);
        r
    }

    #[test]
    fn finds_every_real_root_of_random_polynomials() {
        for seed in 0..100 {
            let mut r = rng(seed, "roots", 0);
            let degree = 2 + seed as usize % 9;
            let mut truth: Vec<f64> =
                (0..degree).map(|i| i as f64 - 4.3 + r.random_range(0.0..0.5)).collect();
            let found = sorted(&real_roots(&from_roots(&truth)));
            truth.sort_by(f64::total_cmp);
            assert_eq!(found.len(), truth.len(), "seed {seed}");
            for (x, y) in found.iter().zip(&truth) {
                assert!((x - y).abs() < 1e-6, "seed {seed}: {x} {y}");
            }
        }
    }

    #[test]
    fn huge_tiny_and_vanishing_leading_coefficients_do_no_harm() {
        let roots = sorted(&real_roots(&[-1e8, 1.0, 0.0, 0.0]));
        assert_eq!(roots.len(), 1);
        assert!((roots[0] / 1e8 - 1.0).abs() < 1e-12);
        let roots = sorted(&real_roots(&from_roots(&[1e-7, 1e7, -3.0])));
        assert!((roots[1] / 1e-7 - 1.0).abs() < 1e-6 && (roots[2] / 1e7 - 1.0).abs() < 1e-12);
        assert_eq!(real_roots(&[-2e-300, 1e-300]).to_vec(), [2.0]);
        assert_eq!(real_roots(&[-2e300, 1e300]).to_vec(), [2.0]);
    }

    #[test]
    fn double_roots_are_found_and_complex_ones_are_not() {
        let roots = sorted(&real_roots(&from_roots(&[0.5, 0.5, 3.0])));
        assert!(roots.len() >= 2 && (roots[0] - 0.5).abs() < 1e-6);
        assert!(real_roots(&[1.0, 0.0, 1.0]).is_empty());
        assert!(real_roots(&[1.0, 0.0, 0.0, 0.0, 1.0]).is_empty());
    }

    #[test]
    fn senseless_input_has_no_roots() {
        assert!(real_roots(&[]).is_empty());
        assert!(real_roots(&[1.0]).is_empty());
        assert!(real_roots(&[0.0; 5]).is_empty());
        assert!(real_roots(&[1.0, f64::NAN, 2.0]).is_empty());
        assert!(real_roots(&[1.0, f64::INFINITY]).is_empty());
        assert!(quadratic_roots(f64::NAN, 1.0, 1.0).is_empty());
        assert!(quadratic_roots(0.0, 0.0, 1.0).is_empty());
    }

    #[test]
    fn quadratic_roots_do_not_cancel() {
        let roots = sorted(&quadratic_roots(1.0, -1e8, 1.0));
        assert!((roots[0] / 1e-8 - 1.0).abs() < 1e-12);
        assert_eq!(sorted(&quadratic_roots(0.0, 2.0, -1.0)), [0.5]);
    }
}
