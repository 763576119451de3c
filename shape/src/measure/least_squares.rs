//! Weighted least squares in a few unknowns, with deviations that hold where errors are alike
//! nearby.

use std::collections::BTreeMap;

/// A residual with its derivatives, its weight, and the patch of surface from which it is.
pub(crate) struct ResidualRow<const P: usize> {
    pub(crate) derivatives: [f64; P],
    pub(crate) residual: f64,
    pub(crate) weight: f64,
    pub(crate) patch: [i64; 3],
}

/// What least squares say of `P` unknowns.
pub(crate) struct Solution<const P: usize> {
    /// The step that makes the squares least.
    pub(crate) step: [f64; P],
    /// Covariance of the unknowns.
    pub(crate) covariance: [[f64; P]; P],
}

/// The step −(JᵀWJ)⁻¹ JᵀWe, and its covariance by patches (Liang and Zeger, Biometrika 1986): the
/// errors of a patch may be one and the same, those of different patches are independent. With no
/// more patches than unknowns nothing is known of the errors and the covariance is NaN. `None`
/// where the unknowns are not determined.
pub(crate) fn solve<const P: usize>(rows: &[ResidualRow<P>]) -> Option<Solution<P>> {
    let (mut a, mut b) = ([[0.0; P]; P], [0.0; P]);
    for row in rows {
        for ((a, b), d) in a.iter_mut().zip(&mut b).zip(row.derivatives) {
            *b -= row.weight * d * row.residual;
            a.iter_mut().zip(row.derivatives).for_each(|(a, e)| *a += row.weight * d * e);
        }
    }
    let inverse = inverse(a)?;
    let step = times(&inverse, &b);
    let mut patches: BTreeMap<[i64; 3], [f64; P]> = BTreeMap::new();
    for row in rows {
        let change: f64 = row.derivatives.iter().zip(step).map(|(d, s)| d * s).sum();
        let score = patches.entry(row.patch).or_insert([0.0; P]);
        for (s, d) in score.iter_mut().zip(row.derivatives) {
            *s += row.weight * d * (row.residual + change);
        }
    }
    let g = patches.len();
    let small_sample = if g > P { g as f64 / (g - P) as f64 } else { f64::NAN };
    let mut covariance = [[0.0; P]; P];
    for score in patches.values() {
        let moved = times(&inverse, score);
        for (row, m) in covariance.iter_mut().zip(moved) {
            row.iter_mut().zip(moved).for_each(|(c, n)| *c += small_sample * m * n);
        }
    }
    Some(Solution { step, covariance })
}

fn times<const P: usize>(m: &[[f64; P]; P], v: &[f64; P]) -> [f64; P] {
    std::array::from_fn(|i| m[i].iter().zip(v).map(|(a, b)| a * b).sum())
}

/// Of a symmetric positive definite matrix, by Gauss and Jordan with pivots; `None` where it is
/// singular.
fn inverse<const P: usize>(mut a: [[f64; P]; P]) -> Option<[[f64; P]; P]> {
    let mut inverse: [[f64; P]; P] =
        std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))));
    let diagonal: [f64; P] = std::array::from_fn(|i| a[i][i]);
    for k in 0..P {
        let pivot = (k..P).max_by(|&i, &j| a[i][k].abs().total_cmp(&a[j][k].abs()))?;
        // What is left of a column that others explain.
        if !(a[pivot][k].abs() > 1e-12 * diagonal[k]) {
            return None;
        }
        a.swap(k, pivot);
        inverse.swap(k, pivot);
        let p = a[k][k];
        a[k].iter_mut().chain(&mut inverse[k]).for_each(|v| *v /= p);
        for i in (0..P).filter(|&i| i != k) {
            let f = a[i][k];
            for j in 0..P {
                a[i][j] -= f * a[k][j];
                inverse[i][j] -= f * inverse[k][j];
            }
        }
    }
    Some(inverse)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;
    use scene::rng::rng;

    /// Rows of a line through points with errors that are the same within ten neighbours.
    fn line(seed: u64) -> Vec<ResidualRow<2>> {
        let mut random = rng(seed, "line", 0);
        let mut error = 0.0;
        (0..400)
            .map(|i| {
                if i % 10 == 0 {
                    error = random.random_range(-1.0..1.0);
                }
                let x = f64::from(i) / 400.0;
                let derivatives = [1.0, x];
                ResidualRow {
                    derivatives,
                    residual: -(2.0 + 3.0 * x + error),
                    weight: 1.0,
                    patch: [i64::from(i) / 10, 0, 0],
                }
            })
            .collect()
    }

    #[test]
    fn deviations_hold_where_neighbours_err_alike() {
        let trials = 400;
        let (mut within, mut within_naive) = (0, 0);
        for seed in 0..trials {
            let rows = line(seed);
            let found = solve(&rows).unwrap();
            let sd = found.covariance[1][1].sqrt();
            within += u32::from((found.step[1] - 3.0).abs() < 2.0 * sd);
            // As if all 400 errors were independent: variance 1/3 over n times that of x.
            let naive = (1.0_f64 / 3.0 / 400.0 * 12.0).sqrt();
            within_naive += u32::from((found.step[1] - 3.0).abs() < 2.0 * naive);
        }
        let share = f64::from(within) / trials as f64;
        assert!((0.90..0.99).contains(&share), "{share} of the slopes lie within two deviations");
        assert!(within_naive * 10 < trials as u32 * 7, "{within_naive} without patches");
    }

    #[test]
    fn what_is_not_determined_is_not_solved() {
        let row =
            |x: f64| ResidualRow { derivatives: [x, 2.0 * x], residual: 1.0, weight: 1.0, patch: [0; 3] };
        assert!(solve(&[row(1.0), row(2.0), row(3.0)]).is_none());
        assert!(solve::<2>(&[]).is_none());
        let mut rows = line(0);
        rows.iter_mut().for_each(|r| r.patch = [0; 3]);
        assert!(solve(&rows).unwrap().covariance[0][0].is_nan());
        rows[0].residual = f64::NAN;
        assert!(solve(&rows).unwrap().step[0].is_nan());
    }
}
