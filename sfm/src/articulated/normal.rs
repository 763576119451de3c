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
    /// By unknown that it touches, in rising order: gradient and mixed derivatives.
    columns: Vec<(usize, f64, DVec3)>,
    /// By pairs of these, the first not before the second: the point eliminated.
    matrix: Vec<f64>,
}

/// The problem at some state.
pub(super) struct JointEquations {
    /// What is minimised.
    pub cost: f64,
    /// What of it is no track's.
    pub prior: f64,
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
                for (&j, (_, b)) in places.iter().zip(&row.columns).filter(|(j, _)| **j <= i) {
                    sum.matrix[i * k + j] += a * b * w;
                }
            }
        }
        sum.eliminate();
        sum
    }

    /// Adds what it has of the rows from `first` on, of `n` numbers each.
    fn add_to(&self, rows: &mut [f64], first: usize, n: usize) {
        let k = self.columns.len();
        let end = first + rows.len() / n;
        let own = self.columns.partition_point(|c| c.0 < first)..self.columns.partition_point(|c| c.0 < end);
        for i in own {
            let row = &mut rows[(self.columns[i].0 - first) * n..][..n];
            let values = &self.matrix[i * k..i * k + i + 1];
            values.iter().zip(&self.columns).for_each(|(value, c)| row[c.0] += value);
        }
    }

    /// Takes the point out.
    fn eliminate(&mut self) {
        let (eliminated, k) = (inverse(self.point), self.columns.len());
        for i in 0..k {
            let through = eliminated * self.columns[i].2;
            self.columns[i].1 -= through.dot(self.point_gradient);
            let row = &mut self.matrix[i * k..i * k + i + 1];
            row.iter_mut().zip(&self.columns).for_each(|(value, c)| *value -= through.dot(c.2));
        }
    }
}

impl JointEquations {
    /// Of the tracks' parts, for so many unknowns.
    pub(super) fn of(n: usize, blocks: Vec<Block>) -> Self {
        let mut all =
            Self { prior: 0.0, cost: 0.0, matrix: vec![0.0; n * n], gradient: vec![0.0; n], blocks };
        all.cost = all.blocks.iter().map(|b| b.cost).sum();
        for (row, gradient, _) in all.blocks.iter().flat_map(|b| &b.columns) {
            all.gradient[*row] += gradient;
        }
        let rows = n.div_ceil(2 * rayon::current_num_threads()).max(1);
        let parts = all.matrix.par_chunks_mut((rows * n).max(1)).enumerate();
        parts.for_each(|(i, part)| all.blocks.iter().for_each(|b| b.add_to(part, i * rows, n)));
        for i in 0..n {
            (0..i).for_each(|j| all.matrix[j * n + i] = all.matrix[i * n + j]);
        }
        all
    }

    /// A residual that depends on unknowns alone.
    pub(super) fn add(&mut self, terms: &[(usize, f64)], residual: f64, sigma: f64) {
        let n = self.gradient.len();
        let weight = 1.0 / (sigma * sigma);
        self.cost += weight * residual * residual;
        self.prior += weight * residual * residual;
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
