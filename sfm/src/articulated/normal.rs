//! Normal equations of unknowns and points, the points eliminated.

use crate::solvers::cholesky::{cholesky, solved, whiten};
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// One residual: derivatives by unknowns and by the point, weighted by its square root.
pub(super) struct NormalRow {
    /// Numbers of the unknowns that it depends on, and the derivatives by them.
    pub columns: Vec<(usize, f64)>,
    /// The derivatives by the point.
    pub point: DVec3,
    /// What is off.
    pub residual: f64,
    /// The inverse of its variance, less where it is robustly of little weight.
    pub weight: f64,
}

/// The part of one track in the normal equations.
#[derive(Default)]
pub(super) struct Block {
    cost: f64,
    point: DMat3,
    point_gradient: DVec3,
    /// By unknown that it touches: gradient and mixed derivatives.
    columns: Vec<(usize, f64, DVec3)>,
    matrix: Vec<f64>,
}

/// The problem at some state.
pub(super) struct JointEquations {
    /// What is minimised.
    pub cost: f64,
    /// [unknowns × unknowns], full.
    matrix: Vec<f64>,
    gradient: Vec<f64>,
    blocks: Vec<Block>,
}

impl Block {
    /// Of a track's rows, whose cost is known.
    pub(super) fn of(cost: f64, rows: &[NormalRow]) -> Self {
        let mut numbers: Vec<usize> = rows.iter().flat_map(|r| r.columns.iter().map(|c| c.0)).collect();
        numbers.sort_unstable();
        numbers.dedup();
        let k = numbers.len();
        let mut sum = Self { cost, matrix: vec![0.0; k * k], ..Self::default() };
        sum.columns = numbers.iter().map(|&n| (n, 0.0, DVec3::ZERO)).collect();
        for row in rows {
            let (p, w) = (row.point, row.weight);
            sum.point += DMat3::from_cols(p * p.x, p * p.y, p * p.z) * w;
            sum.point_gradient += p * (row.residual * w);
            let places: Vec<usize> =
                row.columns.iter().map(|c| numbers.binary_search(&c.0).unwrap_or(0)).collect();
            for (&i, (_, a)) in places.iter().zip(&row.columns) {
                sum.columns[i].1 += a * row.residual * w;
                sum.columns[i].2 += p * (a * w);
                for (&j, (_, b)) in places.iter().zip(&row.columns) {
                    sum.matrix[i * k + j] += a * b * w;
                }
            }
        }
        sum
    }
}

impl JointEquations {
    /// Of the tracks' parts, for so many unknowns.
    pub(super) fn of(n: usize, blocks: Vec<Block>) -> Self {
        let mut all = Self { cost: 0.0, matrix: vec![0.0; n * n], gradient: vec![0.0; n], blocks };
        for block in &all.blocks {
            all.cost += block.cost;
            let eliminated = inverse(block.point);
            let k = block.columns.len();
            for (i, (row, gradient, mixed)) in block.columns.iter().enumerate() {
                let through = eliminated * *mixed;
                all.gradient[*row] += gradient - through.dot(block.point_gradient);
                for (j, (column, _, other)) in block.columns.iter().enumerate() {
                    all.matrix[row * n + column] += block.matrix[i * k + j] - through.dot(*other);
                }
            }
        }
        all
    }

    /// A residual that depends on unknowns alone.
    pub(super) fn add(&mut self, terms: &[(usize, f64)], residual: f64, sigma: f64) {
        let n = self.gradient.len();
        let weight = 1.0 / (sigma * sigma);
        self.cost += weight * residual * residual;
        for &(row, a) in terms {
            self.gradient[row] += weight * a * residual;
            for &(column, b) in terms {
                self.matrix[row * n + column] += weight * a * b;
            }
        }
    }

    /// A step of the unknowns and of each point.
    pub(super) fn step(&self, lambda: f64) -> Option<(Vec<f64>, Vec<DVec3>)> {
        let n = self.gradient.len();
        let mut damped = self.matrix.clone();
        (0..n).for_each(|i| damped[i * n + i] *= 1.0 + lambda);
        let l = cholesky(damped, n)?;
        let step = solved(&l, &self.gradient.iter().map(|g| -g).collect::<Vec<f64>>());
        let moves = self.blocks.iter().map(|b| {
            let pulled: DVec3 = b.columns.iter().map(|(c, _, mixed)| *mixed * step[*c]).sum();
            inverse(b.point) * -(b.point_gradient + pulled)
        });
        let moves = moves.collect();
        step.iter().all(|s| s.is_finite()).then_some((step, moves))
    }

    /// Half of the logarithm of the matrix's determinant; `None` where something is not determined.
    pub(super) fn half_log_determinant(&self) -> Option<f64> {
        let n = self.gradient.len();
        let l = cholesky(self.matrix.clone(), n)?;
        Some((0..n).map(|i| l[i * n + i].ln()).sum())
    }

    /// Standard deviations of the unknowns; `None` where one is not determined.
    pub(super) fn sigmas(&self) -> Option<Vec<f64>> {
        let n = self.gradient.len();
        let l = cholesky(self.matrix.clone(), n)?;
        Some((0..n).into_par_iter().map(|k| sigma(&l, n, k)).collect())
    }
}

/// Standard deviation of one of `n` unknowns, from the lower triangular factor of their matrix.
fn sigma(l: &[f64], n: usize, unknown: usize) -> f64 {
    let mut unit = vec![0.0; n];
    unit[unknown] = 1.0;
    whiten(l, &unit).iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// Zero where nothing holds the point.
fn inverse(m: DMat3) -> DMat3 {
    if m.determinant() > 0.0 { m.inverse() } else { DMat3::ZERO }
}
