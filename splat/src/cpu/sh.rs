//! Real spherical harmonics to degree 3 in the sign convention of the 3DGS files. Values of Y_lm as
//! tabulated in Sloan, "Efficient Spherical Harmonic Evaluation", JCGT 2013, with the
//! Condon–Shortley sign.

use glam::Vec3;

/// Factors by degree. Source: Sloan 2013.
const C0: f32 = 0.282_094_79;
/// Source: Sloan 2013.
const C1: f32 = 0.488_602_51;
/// Source: Sloan 2013.
const C2: [f32; 5] = [1.092_548_4, -1.092_548_4, 0.315_391_57, -1.092_548_4, 0.546_274_2];
/// Source: Sloan 2013.
const C3: [f32; 7] =
    [-0.590_043_6, 2.890_611_4, -0.457_045_8, 0.373_176_33, -0.457_045_8, 1.445_305_7, -0.590_043_6];

/// Most coefficients a channel. Source: (3 + 1)² of degree 3.
pub(crate) const MAX_COEFFICIENTS: usize = 16;

/// `Y_k(dir)` for the (degree + 1)² coefficients; `dir` is unit.
#[inline(always)]
pub(crate) fn basis(dir: Vec3, degree: u32, y: &mut [f32; MAX_COEFFICIENTS]) {
    let (dx, dy, dz) = (dir.x, dir.y, dir.z);
    y[0] = C0;
    if degree == 0 {
        return;
    }
    (y[1], y[2], y[3]) = (-C1 * dy, C1 * dz, -C1 * dx);
    if degree == 1 {
        return;
    }
    let (xx, yy, zz, xy) = (dx * dx, dy * dy, dz * dz, dx * dy);
    y[4] = C2[0] * xy;
    y[5] = C2[1] * dy * dz;
    y[6] = C2[2] * (2.0 * zz - xx - yy);
    y[7] = C2[3] * dx * dz;
    y[8] = C2[4] * (xx - yy);
    if degree == 2 {
        return;
    }
    y[9] = C3[0] * dy * (3.0 * xx - yy);
    y[10] = C3[1] * xy * dz;
    y[11] = C3[2] * dy * (4.0 * zz - xx - yy);
    y[12] = C3[3] * dz * (2.0 * zz - 3.0 * xx - 3.0 * yy);
    y[13] = C3[4] * dx * (4.0 * zz - xx - yy);
    y[14] = C3[5] * dz * (xx - yy);
    y[15] = C3[6] * dx * (xx - 3.0 * yy);
}

/// `Σ_k w_k ∂Y_k/∂dir`, the gradient with respect to the (unconstrained) direction.
#[inline(always)]
pub(crate) fn basis_gradient(dir: Vec3, degree: u32, w: &[f32; MAX_COEFFICIENTS]) -> Vec3 {
    let (x, y, z) = (dir.x, dir.y, dir.z);
    if degree == 0 {
        return Vec3::ZERO;
    }
    let mut g = Vec3::new(-C1 * w[3], -C1 * w[1], C1 * w[2]);
    if degree == 1 {
        return g;
    }
    g.x += C2[0] * y * w[4] - 2.0 * C2[2] * x * w[6] + C2[3] * z * w[7] + 2.0 * C2[4] * x * w[8];
    g.y += C2[0] * x * w[4] + C2[1] * z * w[5] - 2.0 * C2[2] * y * w[6] - 2.0 * C2[4] * y * w[8];
    g.z += C2[1] * y * w[5] + 4.0 * C2[2] * z * w[6] + C2[3] * x * w[7];
    if degree == 2 {
        return g;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    g.x += C3[0] * 6.0 * x * y * w[9] + C3[1] * y * z * w[10]
        - 2.0 * C3[2] * x * y * w[11]
        - 6.0 * C3[3] * x * z * w[12]
        + C3[4] * (4.0 * zz - 3.0 * xx - yy) * w[13]
        + 2.0 * C3[5] * x * z * w[14]
        + 3.0 * C3[6] * (xx - yy) * w[15];
    g.y +=
        3.0 * C3[0] * (xx - yy) * w[9] + C3[1] * x * z * w[10] + C3[2] * (4.0 * zz - xx - 3.0 * yy) * w[11]
            - 6.0 * C3[3] * y * z * w[12]
            - 2.0 * C3[4] * x * y * w[13]
            - 2.0 * C3[5] * y * z * w[14]
            - 6.0 * C3[6] * x * y * w[15];
    g.z += C3[1] * x * y * w[10]
        + 8.0 * C3[2] * y * z * w[11]
        + C3[3] * (6.0 * zz - 3.0 * xx - 3.0 * yy) * w[12]
        + 8.0 * C3[4] * x * z * w[13]
        + C3[5] * (xx - yy) * w[14];
    g
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_of_the_basis_is_its_finite_difference() {
        let dir = Vec3::new(0.36, -0.48, 0.8);
        let w: [f32; 16] = std::array::from_fn(|k| (k as f32 * 0.7).sin());
        let value = |d: Vec3| {
            let mut y = [0.0; 16];
            basis(d, 3, &mut y);
            y.iter().zip(&w).map(|(a, b)| a * b).sum::<f32>()
        };
        let g = basis_gradient(dir, 3, &w);
        for (axis, analytic) in [(Vec3::X, g.x), (Vec3::Y, g.y), (Vec3::Z, g.z)] {
            let h = 1e-2;
            let numeric = (value(dir + axis * h) - value(dir - axis * h)) / (2.0 * h);
            assert!((numeric - analytic).abs() < 2e-3, "{axis} {numeric} {analytic}");
        }
    }

    #[test]
    fn the_basis_is_orthonormal_over_the_sphere() {
        let (rings, steps) = (60, 120);
        let mut gram = [[0.0f64; 16]; 16];
        for i in 0..rings {
            let z = (i as f32 + 0.5) / rings as f32 * 2.0 - 1.0;
            for j in 0..steps {
                let a = j as f32 / steps as f32 * std::f32::consts::TAU;
                let r = (1.0 - z * z).sqrt();
                let mut y = [0.0; 16];
                basis(Vec3::new(r * a.cos(), r * a.sin(), z), 3, &mut y);
                for (row, &a) in gram.iter_mut().zip(&y) {
                    for (g, &b) in row.iter_mut().zip(&y) {
                        *g += f64::from(a) * f64::from(b) * 4.0 * std::f64::consts::PI
                            / f64::from(rings * steps);
                    }
                }
            }
        }
        for (k, row) in gram.iter().enumerate() {
            for (l, &g) in row.iter().enumerate() {
                assert!((g - f64::from(u8::from(k == l))).abs() < 5e-3, "{k} {l} {g}");
            }
        }
    }
}
