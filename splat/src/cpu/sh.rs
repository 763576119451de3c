//! Real spherical harmonics to degree 3 in the sign convention of the 3DGS files. Values of Y_lm as
//! tabulated in Sloan, "Efficient Spherical Harmonic Evaluation", JCGT 2013, with the
//! Condon–Shortley sign.

use glam::Vec3;
use scene::gaussians::{SH_2, SH_3, SH_LOW};
use scene::sh::SH_COUNT;

/// The factors with the signs of the files, by index l² + l + m. Source: [`scene::gaussians`],
/// derived.
const Y: [f32; SH_COUNT] = {
    let ([a, b], [c, d, e], [f, g, h, i, j]) = (SH_LOW, SH_2, SH_3);
    let all = [a, -b, b, -b, c, -c, d, -c, e, -f, g, -h, i, -h, j, -f];
    let (mut y, mut k) = ([0.0; SH_COUNT], 0);
    while k < SH_COUNT {
        y[k] = all[k] as f32;
        k += 1;
    }
    y
};

/// `Y_k(dir)` for the (degree + 1)² coefficients; `dir` is unit.
#[inline(always)]
pub(crate) fn basis(dir: Vec3, degree: u32, y: &mut [f32; SH_COUNT]) {
    let (dx, dy, dz) = (dir.x, dir.y, dir.z);
    y[0] = Y[0];
    if degree == 0 {
        return;
    }
    (y[1], y[2], y[3]) = (Y[1] * dy, Y[2] * dz, Y[3] * dx);
    if degree == 1 {
        return;
    }
    let (xx, yy, zz, xy) = (dx * dx, dy * dy, dz * dz, dx * dy);
    y[4] = Y[4] * xy;
    y[5] = Y[5] * dy * dz;
    y[6] = Y[6] * (2.0 * zz - xx - yy);
    y[7] = Y[7] * dx * dz;
    y[8] = Y[8] * (xx - yy);
    if degree == 2 {
        return;
    }
    y[9] = Y[9] * dy * (3.0 * xx - yy);
    y[10] = Y[10] * xy * dz;
    y[11] = Y[11] * dy * (4.0 * zz - xx - yy);
    y[12] = Y[12] * dz * (2.0 * zz - 3.0 * xx - 3.0 * yy);
    y[13] = Y[13] * dx * (4.0 * zz - xx - yy);
    y[14] = Y[14] * dz * (xx - yy);
    y[15] = Y[15] * dx * (xx - 3.0 * yy);
}

/// `Σ_k w_k ∂Y_k/∂dir`, the gradient with respect to the (unconstrained) direction.
#[inline(always)]
pub(crate) fn basis_gradient(dir: Vec3, degree: u32, w: &[f32; SH_COUNT]) -> Vec3 {
    let (x, y, z) = (dir.x, dir.y, dir.z);
    if degree == 0 {
        return Vec3::ZERO;
    }
    let mut g = Vec3::new(Y[3] * w[3], Y[1] * w[1], Y[2] * w[2]);
    if degree == 1 {
        return g;
    }
    g.x += Y[4] * y * w[4] - 2.0 * Y[6] * x * w[6] + Y[7] * z * w[7] + 2.0 * Y[8] * x * w[8];
    g.y += Y[4] * x * w[4] + Y[5] * z * w[5] - 2.0 * Y[6] * y * w[6] - 2.0 * Y[8] * y * w[8];
    g.z += Y[5] * y * w[5] + 4.0 * Y[6] * z * w[6] + Y[7] * x * w[7];
    if degree == 2 {
        return g;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    g.x += Y[9] * 6.0 * x * y * w[9] + Y[10] * y * z * w[10]
        - 2.0 * Y[11] * x * y * w[11]
        - 6.0 * Y[12] * x * z * w[12]
        + Y[13] * (4.0 * zz - 3.0 * xx - yy) * w[13]
        + 2.0 * Y[14] * x * z * w[14]
        + 3.0 * Y[15] * (xx - yy) * w[15];
    g.y += 3.0 * Y[9] * (xx - yy) * w[9] + Y[10] * x * z * w[10] + Y[11] * (4.0 * zz - xx - 3.0 * yy) * w[11]
        - 6.0 * Y[12] * y * z * w[12]
        - 2.0 * Y[13] * x * y * w[13]
        - 2.0 * Y[14] * y * z * w[14]
        - 6.0 * Y[15] * x * y * w[15];
    g.z += Y[10] * x * y * w[10]
        + 8.0 * Y[11] * y * z * w[11]
        + Y[12] * (6.0 * zz - 3.0 * xx - 3.0 * yy) * w[12]
        + 8.0 * Y[13] * x * z * w[13]
        + Y[14] * (xx - yy) * w[14];
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
