//! The torque-free motion that attitudes show.

use super::dynamics::{RESPONSE, TorqueFreeBody, UNKNOWNS, of_eigenvalues};
use crate::solvers::levenberg::{Normal, cauchy, minimise};
use crate::solvers::linalg::solve_spd;
use crate::statistics::{MEDIAN_LENGTH, median};
use glam::{DMat3, DQuat, DVec3};

/// Turn over which a rate is first read, radians.
/// Source: derived: attitudes known to half a degree give it to a twentieth.
const TURN_FOR_RATE: f64 = 0.15;
/// Directions of the angular momentum that are tried.
/// Source: derived: every direction is within 10° of one.
const DIRECTIONS: usize = 200;
/// Of which so many, the best by their rates, are adjusted.
/// Source: chosen by hand, never measured.
const STARTS: usize = 4;
/// Standard deviation beforehand of the logarithms of a body's inertia about their mean.
/// Source: derived: a factor e, wider than the factor two between a plate's moments.
pub(super) const SHAPE_SIGMA: f64 = 1.0;
/// Half the width of the differences by which derivatives are taken: radians, logarithms, shares of
/// the distance.
/// Source: derived: the cube root of the precision of the integration.
pub(super) const DIFFERENCE: f64 = 1e-5;

/// An attitude at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Attitude {
    /// Seconds.
    pub time: f64,
    /// Camera from body.
    pub rotation: DQuat,
}

/// A motion with what it leaves.
#[derive(Clone, Debug)]
pub(super) struct TorqueFreeFit {
    pub body: TorqueFreeBody,
    /// When the body's time is 0, seconds.
    pub epoch: f64,
    /// Standard deviation of a coordinate of the residual rotations, radians.
    pub sigma: f64,
}

impl TorqueFreeFit {
    /// The motion nearest to some attitudes; `None` where there are too few or nothing turns.
    pub(super) fn of(attitudes: &[Attitude]) -> Option<Self> {
        if attitudes.len() < UNKNOWNS || !attitudes.iter().all(|a| a.rotation.is_finite()) {
            return None;
        }
        let epoch = attitudes[attitudes.len() / 2].time;
        let times = attitudes.iter().map(|a| a.time - epoch).collect();
        let data = Data { times, rotations: attitudes.iter().map(|a| a.rotation).collect() };
        let fits = data.starts().into_iter().map(|start| data.adjusted(start));
        let (body, sigma) = fits.min_by(|a, b| a.1.total_cmp(&b.1))?;
        Some(Self { body, epoch, sigma })
    }

    /// Attitudes at some times, seconds.
    pub(super) fn attitudes(&self, times: &[f64]) -> Vec<DQuat> {
        let times: Vec<f64> = times.iter().map(|t| t - self.epoch).collect();
        self.body.attitudes(&times)
    }
}

/// Attitudes with times counted from the epoch.
struct Data {
    times: Vec<f64>,
    rotations: Vec<DQuat>,
}

impl Data {
    /// Rotation vectors from the motion's attitudes to those seen, camera frame.
    fn residuals(&self, body: &TorqueFreeBody) -> Vec<DVec3> {
        let found = body.attitudes(&self.times);
        found.iter().zip(&self.rotations).map(|(q, seen)| rotation_vector(*seen * q.conjugate())).collect()
    }

    /// First guesses: for many directions of the angular momentum the response that explains the
    /// rates best, which is a linear problem.
    fn starts(&self) -> Vec<TorqueFreeBody> {
        let rates = self.rates();
        let middle = self.rotations.len() / 2;
        let Some(mean) = rates.iter().map(|(q, w)| *q * *w).sum::<DVec3>().try_normalize() else {
            return Vec::new();
        };
        let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
        let on_sphere = |k: usize| {
            let z = 1.0 - (2 * k + 1) as f64 / DIRECTIONS as f64;
            let (s, c) = (golden * k as f64).sin_cos();
            DVec3::new(c, s, 0.0) * (1.0 - z * z).sqrt() + DVec3::Z * z
        };
        let directions = (0..DIRECTIONS).map(on_sphere).chain([mean]);
        let mut found: Vec<(f64, TorqueFreeBody)> = Vec::new();
        for momentum in directions {
            let Some((response, misfit)) = response_to(&rates, momentum) else { continue };
            let body = TorqueFreeBody {
                attitude: self.rotations[middle],
                momentum,
                log_response: of_eigenvalues(&response, f64::ln),
            };
            found.push((misfit, body));
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found.into_iter().take(STARTS).map(|(_, body)| body).collect()
    }

    /// Attitudes half-way between two, and the body's rates there, body frame, rad/s.
    fn rates(&self) -> Vec<(DQuat, DVec3)> {
        let turns = self.rotations.windows(2).map(|w| rotation_vector(w[0].conjugate() * w[1]).length());
        let usual = median(turns.collect()).max(1e-6);
        let lag = ((TURN_FOR_RATE / usual).ceil() as usize).clamp(1, self.rotations.len() / 3);
        let pairs = (0..self.rotations.len() - lag).map(|i| (i, i + lag));
        let mut rates = Vec::new();
        for (i, k) in pairs {
            let turn = rotation_vector(self.rotations[i].conjugate() * self.rotations[k]);
            let span = self.times[k] - self.times[i];
            if span > 0.0 {
                rates.push((self.rotations[i] * DQuat::from_scaled_axis(0.5 * turn), turn / span));
            }
        }
        rates
    }

    /// The motion adjusted to all attitudes, robustly, and the noise that is left.
    fn adjusted(&self, start: TorqueFreeBody) -> (TorqueFreeBody, f64) {
        let mut body = start;
        let mut sigma = self.noise(&body);
        for _ in 0..4 {
            body = minimise(body, 60, |b| Some(self.normal(b, sigma)), TorqueFreeBody::stepped);
            let next = self.noise(&body);
            let stands = next > 0.9 * sigma;
            sigma = next;
            if stands {
                break;
            }
        }
        (body, sigma)
    }

    fn noise(&self, body: &TorqueFreeBody) -> f64 {
        let lengths = self.residuals(body).iter().map(|r| r.length()).collect();
        // Where a motion fits exactly: far below what any picture says.
        (median(lengths) / MEDIAN_LENGTH).max(f64::EPSILON.sqrt())
    }

    /// Robust cost and normal equations, in units of `sigma`.
    fn normal(&self, body: &TorqueFreeBody, sigma: f64) -> Normal<UNKNOWNS> {
        let residuals = self.residuals(body);
        let columns: Vec<Vec<DVec3>> = (0..UNKNOWNS).map(|k| self.derivative(body, k)).collect();
        let mut normal = Normal::new();
        for (i, r) in residuals.iter().enumerate() {
            let (cost, weight) = cauchy(r.length_squared() / (sigma * sigma), 2.0 * 3f64.sqrt());
            normal.add_cost(cost);
            for axis in 0..3 {
                let gradient: [f64; UNKNOWNS] = std::array::from_fn(|k| columns[k][i][axis] / sigma);
                normal.add(r[axis] / sigma, &gradient, weight);
            }
        }
        add_prior(&body.log_response, &mut normal);
        normal
    }

    /// Derivative of the residuals by one unknown.
    fn derivative(&self, body: &TorqueFreeBody, unknown: usize) -> Vec<DVec3> {
        let moved = |by: f64| {
            let step = std::array::from_fn(|k| if k == unknown { by } else { 0.0 });
            self.residuals(&body.stepped(&step))
        };
        let (high, low) = (moved(DIFFERENCE), moved(-DIFFERENCE));
        high.iter().zip(&low).map(|(h, l)| (*h - *l) / (2.0 * DIFFERENCE)).collect()
    }
}

/// Adds what is known beforehand of the body: its moments of inertia are alike, to
/// [`SHAPE_SIGMA`].
fn add_prior(log_response: &DMat3, normal: &mut Normal<UNKNOWNS>) {
    let s = log_response.transpose().to_cols_array_2d();
    let mean = (s[0][0] + s[1][1] + s[2][2]) / 3.0;
    let entries = [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]];
    for (unknown, [row, column]) in RESPONSE.zip(entries) {
        let (is_diagonal, scale) = (row == column, if row == column { 1.0 } else { 2f64.sqrt() });
        let value = if is_diagonal { s[row][column] - mean } else { scale * s[row][column] } / SHAPE_SIGMA;
        let mut gradient = [0.0; UNKNOWNS];
        gradient[unknown] = scale / SHAPE_SIGMA;
        if is_diagonal {
            for (other, [r, c]) in RESPONSE.zip(entries) {
                gradient[other] -= if r == c { 1.0 / 3.0 / SHAPE_SIGMA } else { 0.0 };
            }
        }
        normal.add(value, &gradient, 1.0);
        normal.add_cost(value * value);
    }
}

/// The symmetric positive definite K for which `K Rᵀ h` is nearest to the rates, and the share of
/// their squares that is left.
fn response_to(rates: &[(DQuat, DVec3)], momentum: DVec3) -> Option<(DMat3, f64)> {
    let mut jtj = [[0.0; 6]; 6];
    let mut jtr = [0.0; 6];
    let mut squares = 0.0;
    for (attitude, rate) in rates {
        let u = attitude.conjugate() * momentum;
        let rows =
            [[u.x, u.y, u.z, 0.0, 0.0, 0.0], [0.0, u.x, 0.0, u.y, u.z, 0.0], [0.0, 0.0, u.x, 0.0, u.y, u.z]];
        for (row, w) in rows.iter().zip(rate.to_array()) {
            squares += w * w;
            for i in 0..6 {
                jtr[i] += row[i] * w;
                for k in 0..6 {
                    jtj[i][k] += row[i] * row[k];
                }
            }
        }
    }
    let typical = (squares / rates.len().max(1) as f64).sqrt();
    // A turn about one axis says nothing of the others: there the response is that of a ball.
    let weak = 1e-3 * rates.len() as f64;
    for (i, value) in [1.0, 0.0, 0.0, 1.0, 0.0, 1.0].into_iter().enumerate() {
        jtj[i][i] += weak;
        jtr[i] += weak * value * typical;
    }
    let [xx, xy, xz, yy, yz, zz] = solve_spd(&jtj, &jtr)?;
    let found = DMat3::from_cols(DVec3::new(xx, xy, xz), DVec3::new(xy, yy, yz), DVec3::new(xz, yz, zz));
    let response = of_eigenvalues(&found, |v| v.clamp(0.1 * typical, 10.0 * typical));
    let left = rates.iter().map(|(q, w)| (*w - response * (q.conjugate() * momentum)).length_squared());
    let misfit = left.sum::<f64>() / squares.max(f64::MIN_POSITIVE);
    (typical > 0.0 && response.is_finite()).then_some((response, misfit))
}

/// Axis times angle of a rotation, the shorter way round.
pub(super) fn rotation_vector(q: DQuat) -> DVec3 {
    (if q.w < 0.0 { -q } else { q }).to_scaled_axis()
}

#[cfg(test)]
pub(super) mod tests;
