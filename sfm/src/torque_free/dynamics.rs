//! Attitude of a rigid body on which no torque acts.

use crate::solvers::linalg::symmetric_eigen;
use glam::{DMat3, DQuat, DVec3};
use std::ops::Range;

/// Most that the body turns in one step of the integration, radians.
/// Source: derived: the error of Runge–Kutta's method of order four grows by about 1e-9 radians a
/// step.
const STEP_RAD: f64 = 0.05;

/// Unknowns of a torque-free motion: attitude (3), direction of the angular momentum (2), logarithm
/// of the response (6).
/// Source: derived.
pub(super) const UNKNOWNS: usize = 11;

/// Where in the unknowns the logarithm of the response is, row-major from the diagonal on.
pub(super) const RESPONSE: Range<usize> = 5..UNKNOWNS;

/// Attitude of a torque-free rigid body before a camera that does not turn.
///
/// The angular momentum stands still in the camera's frame; seen from the body it is `Rᵀ h`, and
/// the body's rates are `ω = K Rᵀ h` with `K = |L| I⁻¹`: Euler's equations `I ω̇ = −ω × I ω`
/// (Landau & Lifshitz, Mechanics, § 36) without the principal axes, which need not be known.
/// `K = exp S`, so that every symmetric S is a body.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TorqueFreeBody {
    /// Camera from body at time 0.
    pub attitude: DQuat,
    /// Direction of the angular momentum, camera frame, unit length.
    pub momentum: DVec3,
    /// S, logarithm of the response K to a momentum of unit length (1/s), body frame.
    pub log_response: DMat3,
}

impl TorqueFreeBody {
    /// K, 1/s.
    pub(super) fn response(&self) -> DMat3 {
        of_eigenvalues(&self.log_response, f64::exp)
    }

    /// Eigenvalues of S in ascending order, and the principal axes that belong to them: columns,
    /// body frame, right-handed. The inertia is `exp(−S)` but for a factor.
    pub(super) fn principal_axes(&self) -> ([f64; 3], DMat3) {
        let (values, axes) = eigen(&self.log_response);
        (values, if axes.determinant() < 0.0 { -axes } else { axes })
    }

    /// How the logarithms of the response differ from a ball's: six entries of S without its mean,
    /// those beside the diagonal times √2, so that their squares sum up to those of the matrix.
    pub(super) fn shape(&self) -> [f64; 6] {
        let [[xx, xy, xz], [_, yy, yz], [_, _, zz]] = self.log_response.to_cols_array_2d();
        let (mean, root) = ((xx + yy + zz) / 3.0, std::f64::consts::SQRT_2);
        [xx - mean, root * xy, root * xz, yy - mean, root * yz, zz - mean]
    }

    /// The momentum along the principal axes at the epoch, in the order of
    /// [`TorqueFreeBody::principal_axes`].
    pub(super) fn momentum_in_principal_axes(&self) -> DVec3 {
        self.principal_axes().1.transpose() * (self.attitude.conjugate() * self.momentum)
    }

    /// The same after a step: rotation vector of the attitude and two coordinates of the momentum's
    /// turn, camera frame; the entries of S.
    pub(super) fn stepped(&self, step: &[f64; UNKNOWNS]) -> Self {
        let [a, b, c, u, v, xx, xy, xz, yy, yz, zz] = *step;
        let [first, second] = across(self.momentum);
        let change = DMat3::from_cols(DVec3::new(xx, xy, xz), DVec3::new(xy, yy, yz), DVec3::new(xz, yz, zz));
        Self {
            attitude: (DQuat::from_scaled_axis(DVec3::new(a, b, c)) * self.attitude).normalize(),
            momentum: (DQuat::from_scaled_axis(first * u + second * v) * self.momentum).normalize(),
            log_response: self.log_response + change,
        }
    }

    /// Attitudes at some times, seconds, in any order.
    pub(super) fn attitudes(&self, times: &[f64]) -> Vec<DQuat> {
        let response = self.response();
        let mut found = vec![self.attitude; times.len()];
        let mut order: Vec<usize> = (0..times.len()).collect();
        order.sort_by(|a, b| times[*a].total_cmp(&times[*b]));
        let middle = order.partition_point(|i| times[*i] < 0.0);
        let (before, after) = order.split_at(middle);
        let mut walk = |numbers: &mut dyn Iterator<Item = &usize>| {
            let (mut at, mut attitude) = (0.0, self.attitude);
            for &i in numbers {
                attitude = self.integrated(&response, attitude, times[i] - at);
                (at, found[i]) = (times[i], attitude);
            }
        };
        walk(&mut after.iter());
        walk(&mut before.iter().rev());
        found
    }

    /// Rates of the body at an attitude, body frame, rad/s.
    pub(super) fn rates(&self, attitude: DQuat) -> DVec3 {
        self.response() * (attitude.conjugate() * self.momentum)
    }

    /// `Q̇ = ½ Q ω` over `span` seconds by Runge and Kutta's method of order four.
    fn integrated(&self, response: &DMat3, attitude: DQuat, span: f64) -> DQuat {
        let fastest = response.x_axis.length().max(response.y_axis.length()).max(response.z_axis.length());
        // A body that turns several times between two images cannot be told from one that does not:
        // its attitudes need not be exact, but they must not take for ever.
        let turned = (fastest * span.abs()).min(4.0 * std::f64::consts::TAU);
        let steps = (turned / STEP_RAD).ceil().max(1.0) as usize;
        let h = span / steps as f64;
        let slope = |q: DQuat| {
            let w = *response * (q.normalize().conjugate() * self.momentum);
            q * DQuat::from_xyzw(w.x, w.y, w.z, 0.0) * 0.5
        };
        let mut q = attitude;
        for _ in 0..steps {
            let a = slope(q);
            let b = slope(q + a * (0.5 * h));
            let c = slope(q + b * (0.5 * h));
            let d = slope(q + c * h);
            q = (q + (a + (b + c) * 2.0 + d) * (h / 6.0)).normalize();
        }
        q
    }
}

/// Two unit vectors across `direction` and each other.
fn across(direction: DVec3) -> [DVec3; 2] {
    let first = direction.any_orthonormal_vector();
    [first, direction.cross(first)]
}

/// Eigenvalues of a symmetric matrix in ascending order, and its eigenvectors as columns.
fn eigen(matrix: &DMat3) -> ([f64; 3], DMat3) {
    let (values, vectors) = symmetric_eigen(&matrix.transpose().to_cols_array_2d());
    (values, DMat3::from_cols_array_2d(&vectors))
}

/// The symmetric matrix with the same eigenvectors and `f` of the eigenvalues.
pub(super) fn of_eigenvalues(matrix: &DMat3, f: impl Fn(f64) -> f64) -> DMat3 {
    let (values, vectors) = eigen(matrix);
    vectors * DMat3::from_diagonal(DVec3::from_array(values.map(f))) * vectors.transpose()
}

#[cfg(test)]
mod tests;
