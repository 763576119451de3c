//! sh: colour of a Gaussian seen from a direction.
//!
//! in: coefficients [K × 3], direction · out: rgb = max(0, 0.5 + Σ_k Y_k(dir) sh_k)
//!
//! Y are the real spherical harmonics up to degree 3 with the Condon–Shortley phase, l² + l + m
//! being the index (Ramamoorthi & Hanrahan 2001; the signs are those of the 3DGS paper's PLY
//! files).

use glam::DVec3;
use scene::gaussians::{SH_2, SH_3, SH_LOW};

/// Y_0 … Y_15 at a unit vector.
pub(crate) fn basis(d: DVec3) -> [f64; 16] {
    let (x, y, z) = (d.x, d.y, d.z);
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        SH_LOW[0],
        -SH_LOW[1] * y,
        SH_LOW[1] * z,
        -SH_LOW[1] * x,
        SH_2[0] * x * y,
        -SH_2[0] * y * z,
        SH_2[1] * (2.0 * zz - xx - yy),
        -SH_2[0] * x * z,
        SH_2[2] * (xx - yy),
        -SH_3[0] * y * (3.0 * xx - yy),
        SH_3[1] * x * y * z,
        -SH_3[2] * y * (4.0 * zz - xx - yy),
        SH_3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -SH_3[2] * x * (4.0 * zz - xx - yy),
        SH_3[4] * z * (xx - yy),
        -SH_3[0] * x * (xx - 3.0 * yy),
    ]
}

/// ∇Y_0 … ∇Y_15 of the polynomials in [`basis`], taken as functions of any x, y, z.
pub(crate) fn basis_gradient(d: DVec3) -> [DVec3; 16] {
    let (x, y, z) = (d.x, d.y, d.z);
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let v = DVec3::new;
    [
        DVec3::ZERO,
        v(0.0, -SH_LOW[1], 0.0),
        v(0.0, 0.0, SH_LOW[1]),
        v(-SH_LOW[1], 0.0, 0.0),
        SH_2[0] * v(y, x, 0.0),
        -SH_2[0] * v(0.0, z, y),
        SH_2[1] * v(-2.0 * x, -2.0 * y, 4.0 * z),
        -SH_2[0] * v(z, 0.0, x),
        SH_2[2] * v(2.0 * x, -2.0 * y, 0.0),
        -SH_3[0] * v(6.0 * x * y, 3.0 * (xx - yy), 0.0),
        SH_3[1] * v(y * z, x * z, x * y),
        -SH_3[2] * v(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z),
        SH_3[3] * v(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy),
        -SH_3[2] * v(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z),
        SH_3[4] * v(2.0 * x * z, -2.0 * y * z, xx - yy),
        -SH_3[0] * v(3.0 * (xx - yy), -6.0 * x * y, 0.0),
    ]
}

/// Colour of a Gaussian at `mean` seen from `position`; coefficients [K × 3] above `degree` are
/// left out.
pub(crate) fn sh(coefficients: &[f64], degree: u32, mean: DVec3, position: DVec3) -> DVec3 {
    raw(coefficients, degree, mean, position).max(DVec3::ZERO)
}

fn raw(coefficients: &[f64], degree: u32, mean: DVec3, position: DVec3) -> DVec3 {
    let y = basis((mean - position).normalize_or_zero());
    let used = coefficients.chunks_exact(3).take((degree as usize + 1).pow(2));
    used.zip(y).fold(DVec3::splat(0.5), |sum, (c, y)| sum + DVec3::from_slice(c) * y)
}

/// From `d` = ∂L/∂rgb: adds ∂L/∂coefficients to `d_coefficients` and returns ∂L/∂mean =
/// −∂L/∂position through the direction. Zero for a channel that the maximum holds at 0.
pub(crate) fn sh_backward(
    coefficients: &[f64],
    degree: u32,
    mean: DVec3,
    position: DVec3,
    d: DVec3,
    d_coefficients: &mut [f64],
) -> DVec3 {
    let open = raw(coefficients, degree, mean, position);
    let d = DVec3::select(open.cmpgt(DVec3::ZERO), d, DVec3::ZERO);
    let offset = mean - position;
    let direction = offset.normalize_or_zero();
    let (y, dy) = (basis(direction), basis_gradient(direction));
    let mut d_direction = DVec3::ZERO;
    let used = coefficients
        .chunks_exact(3)
        .zip(d_coefficients.chunks_exact_mut(3))
        .take((degree as usize + 1).pow(2));
    for (k, (c, dc)) in used.enumerate() {
        d_direction += dy[k] * d.dot(DVec3::from_slice(c));
        for channel in 0..3 {
            dc[channel] += y[k] * d[channel];
        }
    }
    if direction == DVec3::ZERO {
        return DVec3::ZERO;
    }
    (d_direction - direction * direction.dot(d_direction)) / offset.length()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_basis_is_orthonormal_on_the_sphere() {
        // Midpoint rule in cos θ and φ: exact to 1e-4 with 200 × 200 points.
        let n = 200;
        let mut gram = [[0.0; 16]; 16];
        for i in 0..n {
            let z = -1.0 + (f64::from(i) + 0.5) * 2.0 / f64::from(n);
            for j in 0..n {
                let phi = (f64::from(j) + 0.5) * std::f64::consts::TAU / f64::from(n);
                let r = (1.0 - z * z).sqrt();
                let y = basis(DVec3::new(r * phi.cos(), r * phi.sin(), z));
                for (row, a) in gram.iter_mut().zip(y) {
                    for (cell, b) in row.iter_mut().zip(y) {
                        *cell += a * b * 2.0 * std::f64::consts::TAU / f64::from(n * n);
                    }
                }
            }
        }
        for (i, row) in gram.iter().enumerate() {
            for (j, &value) in row.iter().enumerate() {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((value - expected).abs() < 1e-3, "{i} {j} {value}");
            }
        }
    }

    #[test]
    fn a_camera_inside_the_gaussian_sees_a_finite_colour_and_no_direction_gradient() {
        let coefficients = [0.3; 48];
        let mut d = [0.0; 48];
        assert!(sh(&coefficients, 3, DVec3::ONE, DVec3::ONE).is_finite());
        assert_eq!(sh_backward(&coefficients, 3, DVec3::ONE, DVec3::ONE, DVec3::ONE, &mut d), DVec3::ZERO);
        assert!(d.iter().all(|v| v.is_finite()));
    }
}
