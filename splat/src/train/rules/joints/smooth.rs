//! Angles that change their rate slowly, from readings of some of them: the least of
//! `Σ w_v (θ_v − y_v)² + Σ (Δrate)² / bend²`, an integrated random walk.
//!
//! How unsteady a joint is is not asked of its readings: they lie near the angles that the
//! Gaussians were trained with.

/// A reading of an angle: radians, and one over its variance (0: it says nothing).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reading {
    pub(super) angle: f64,
    pub(super) information: f64,
}

/// Standard deviation of the change of rate from frame to frame, radians. Source: chosen by hand: a
/// seventh of a degree, more than motors do at the usual rates.
const BEND: f64 = 2.43e-3;
/// What is left of a diagonal entry of a singular matrix is below this share of it.
/// Source: derived: the rounding of some hundred operations.
const ROUNDED: f64 = 1e-13;
/// Neighbours on either side that an angle is tied to. Source: derived: second differences.
const BAND: usize = 2;

/// A symmetric matrix whose entries farther than [`BAND`] from the diagonal are zero: the lower
/// half by rows, the diagonal first.
#[derive(Clone)]
struct Banded(Vec<[f64; BAND + 1]>);

/// The factor `L` of `L Lᵀ`, in the same form.
struct Factor(Banded);

impl Banded {
    fn add(&mut self, i: usize, j: usize, value: f64) {
        let (row, column) = (i.max(j), i.min(j));
        self.0[row][row - column] += value;
    }

    /// Cholesky's factor; `None` where the matrix is not positive definite.
    fn factor(mut self) -> Option<Factor> {
        for i in 0..self.0.len() {
            let least = self.0[i][0] * ROUNDED;
            for back in (0..=BAND.min(i)).rev() {
                let j = i - back;
                // Σ L_ik L_jk over the k < j that both rows have.
                let shared = (i.saturating_sub(BAND)..j).filter(|k| j - k <= BAND);
                let sum: f64 = shared.map(|k| self.0[i][i - k] * self.0[j][j - k]).sum();
                let rest = self.0[i][back] - sum;
                self.0[i][back] = if back > 0 { rest / self.0[j][0] } else { rest.sqrt() };
            }
            let left = self.0[i][0].powi(2);
            if !(left > least && left.is_finite()) {
                return None;
            }
        }
        Some(Factor(self))
    }
}

impl Factor {
    fn solve(&self, mut x: Vec<f64>) -> Vec<f64> {
        let rows = &self.0.0;
        for i in 0..x.len() {
            let known: f64 = (1..=BAND.min(i)).map(|back| rows[i][back] * x[i - back]).sum();
            x[i] = (x[i] - known) / rows[i][0];
        }
        for i in (0..x.len()).rev() {
            let ahead = (1..=BAND).filter(|k| i + k < x.len());
            let known: f64 = ahead.map(|k| rows[i + k][k] * x[i + k]).sum();
            x[i] = (x[i] - known) / rows[i][0];
        }
        x
    }

    /// The diagonal of the inverse.
    fn variances(&self) -> Vec<f64> {
        let n = self.0.0.len();
        let unit = |i: usize| (0..n).map(|k| f64::from(u8::from(k == i))).collect();
        (0..n).map(|i| self.solve(unit(i))[i]).collect()
    }
}

/// Angles of all views and their standard deviations from readings of some and the views' times;
/// `None` where the readings do not determine them.
pub(super) fn smoothed(readings: &[Reading], times: &[f64]) -> Option<[Vec<f64>; 2]> {
    let mut order: Vec<usize> = (0..readings.len()).collect();
    order.sort_by(|&a, &b| times[a].total_cmp(&times[b]));
    let sorted: Vec<Reading> = order.iter().map(|&i| readings[i]).collect();
    let moments: Vec<f64> = order.iter().map(|&i| times[i]).collect();
    let (angles, factor) = steady(&sorted, &moments)?;
    let mut out = [readings.iter().map(|r| r.angle).collect::<Vec<f64>>(), vec![0.0; readings.len()]];
    let variances = factor.variances();
    for (k, &i) in order.iter().enumerate() {
        out[0][i] = angles[k];
        out[1][i] = variances[k].sqrt();
    }
    Some(out)
}

/// Angles in the order of time, and the factor of their information.
fn steady(readings: &[Reading], times: &[f64]) -> Option<(Vec<f64>, Factor)> {
    let n = readings.len();
    let mut matrix = Banded(vec![[0.0; BAND + 1]; n]);
    for (i, r) in readings.iter().enumerate() {
        matrix.add(i, i, r.information);
    }
    for i in 0..n.saturating_sub(2) {
        let (first, second) = (times[i + 1] - times[i], times[i + 2] - times[i + 1]);
        let row = [1.0 / first, -1.0 / first - 1.0 / second, 1.0 / second];
        for a in 0..3 {
            (0..=a).for_each(|b| matrix.add(i + a, i + b, row[a] * row[b] / (BEND * BEND)));
        }
    }
    let factor = matrix.factor()?;
    let angles = factor.solve(readings.iter().map(|r| r.information * r.angle).collect());
    angles.iter().all(|a| a.is_finite()).then_some((angles, factor))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;

    #[test]
    fn a_steady_rate_is_found_through_frames_that_say_nothing() {
        let mut rng = scene::rng::rng(3, "angles", 0);
        let truth = |k: usize| 0.02 * k as f64 - 0.3;
        let noise: [f64; 3] = [0.02, 0.01, 0.05];
        let readings: Vec<Reading> = (0..100)
            .map(|k| {
                let sigma = noise[k % 3];
                let normal: f64 = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
                let known = !(40..60).contains(&k) && k > 8;
                let information = if known { sigma.powi(-2) } else { 0.0 };
                Reading { angle: if known { truth(k) + sigma * normal } else { 9.0 }, information }
            })
            .collect();
        let times: Vec<f64> = (0..100).map(|k| k as f64).collect();
        let [angles, sigmas] = smoothed(&readings, &times).unwrap();
        let beyond = (0..100).filter(|&k| (angles[k] - truth(k)).abs() > 3.0 * sigmas[k]).count();
        assert!(beyond <= 2, "{beyond} angles are farther off than three deviations");
        let worst = (0..100).map(|k| (angles[k] - truth(k)).abs()).fold(0.0, f64::max);
        assert!(worst < 0.05, "{worst}");
    }

    #[test]
    fn a_jerk_is_followed_where_readings_are_exact() {
        let truth = |k: usize| if k < 30 { 0.0 } else { 0.05 * (k - 30) as f64 };
        let readings: Vec<Reading> = (0..60).map(|k| Reading { angle: truth(k), information: 1e6 }).collect();
        let times: Vec<f64> = (0..60).map(|k| 2.0 * k as f64).collect();
        let [angles, _] = smoothed(&readings, &times).unwrap();
        let worst = (0..60).map(|k| (angles[k] - truth(k)).abs()).fold(0.0, f64::max);
        assert!(worst < 5e-3, "{worst}");
    }

    #[test]
    fn one_reading_determines_nothing() {
        let nothing = Reading { angle: 0.0, information: 0.0 };
        let readings = [nothing, Reading { angle: 0.1, information: 1.0 }, nothing];
        assert!(smoothed(&readings, &[0.0, 1.0, 2.0]).is_none());
        assert!(smoothed(&[nothing; 5], &[0.0, 1.0, 2.0, 3.0, 4.0]).is_none());
    }

    #[test]
    fn banded_systems_are_solved() {
        let mut matrix = Banded(vec![[0.0; 3]; 5]);
        for i in 0..5 {
            matrix.add(i, i, 4.0 + i as f64);
            (1..=2).filter(|k| i + k < 5).for_each(|k| matrix.add(i, i + k, 1.0 / k as f64));
        }
        let whole = |i: usize, j: usize| {
            let (row, column) = (i.max(j), i.min(j));
            if row - column > 2 { 0.0 } else { matrix.0[row][row - column] }
        };
        let x = [1.0, -2.0, 3.0, 0.5, 4.0];
        let b: Vec<f64> = (0..5).map(|i| (0..5).map(|j| whole(i, j) * x[j]).sum()).collect();
        let solved = matrix.clone().factor().unwrap().solve(b);
        solved.iter().zip(x).for_each(|(a, b)| assert!((a - b).abs() < 1e-12));
    }
}
