//! Levenberg–Marquardt for problems of a handful of unknowns.

use super::linalg::solve_spd;

/// Robust cost with the normal equations of its quadratic model.
pub(crate) struct Normal<const D: usize> {
    cost: f64,
    jtj: [[f64; D]; D],
    jtr: [f64; D],
}

impl<const D: usize> Normal<D> {
    /// Nothing summed yet.
    pub(crate) fn new() -> Self {
        Self { cost: 0.0, jtj: [[0.0; D]; D], jtr: [0.0; D] }
    }

    /// Adds a residual with its gradient under a weight (of iterative reweighting).
    #[inline]
    pub(crate) fn add(&mut self, residual: f64, gradient: &[f64; D], weight: f64) {
        for i in 0..D {
            let wg = weight * gradient[i];
            self.jtr[i] += wg * residual;
            for (cell, g) in self.jtj[i].iter_mut().zip(&gradient[..=i]) {
                *cell += wg * g;
            }
        }
    }

    /// Adds to the cost.
    #[inline]
    pub(crate) fn add_cost(&mut self, cost: f64) {
        self.cost += cost;
    }
}

/// Cauchy's loss `s² ln(1 + r²/s²)` of a squared residual and its derivative by `r²`.
#[inline]
pub(crate) fn cauchy(squared: f64, scale: f64) -> (f64, f64) {
    let x = squared / (scale * scale);
    (scale * scale * x.ln_1p(), 1.0 / (1.0 + x))
}

/// Minimises from `state`: `evaluate` gives cost and normal equations (`None` where the state is
/// not allowed), `apply_step` applies a step in the tangent space. Returns the best state; the
/// start where nothing is better. Marquardt's diagonal scaling, so that units do not matter.
/// Madsen, Nielsen & Tingleff 2004,  3.2.
pub(crate) fn minimise<const D: usize, S: Clone>(
    state: S,
    max_iterations: usize,
    evaluate: impl Fn(&S) -> Option<Normal<D>>,
    apply_step: impl Fn(&S, &[f64; D]) -> S,
) -> S {
    let mut best = state;
    let Some(mut normal) = evaluate(&best) else { return best };
    let mut lambda = 1e-4;
    for _ in 0..max_iterations {
        let mut damped = normal.jtj;
        for (i, row) in damped.iter_mut().enumerate() {
            row[i] += lambda * row[i] + f64::MIN_POSITIVE; // solve_spd reads the lower triangle only
        }
        let step = solve_spd(&damped, &normal.jtr.map(|x| -x));
        let trial = step.map(|step| apply_step(&best, &step));
        let result = trial.and_then(|trial| evaluate(&trial).map(|n| (trial, n)));
        match result {
            Some((trial, next)) if next.cost < normal.cost => {
                let gain = normal.cost - next.cost;
                let small = gain <= 1e-10 * normal.cost;
                (best, normal) = (trial, next);
                lambda = (lambda * 0.1).max(1e-12);
                if small {
                    break;
                }
            }
            _ => {
                lambda *= 10.0;
                if lambda > 1e6 {
                    break;
                }
            }
        }
    }
    best
}
