//! Real spherical harmonics up to degree 3 as 3D Gaussian splatting uses them, and how they turn.

use crate::gaussians::{Gaussians, SH_2, SH_3, SH_LOW};
use crate::sim3::Sim3;
use glam::{DQuat, DVec3};

/// Number of functions up to degree 3. Source: derived, (3 + 1)².
pub const SH_COUNT: usize = 16;

/// The functions `Y_0 … Y_15` at a unit direction, with the Condon–Shortley phase: degree 1 is `−c
/// y, c z, −c x`, c = √(3/4π) (Ramamoorthi and Hanrahan 2001; the constants of
/// KHR_gaussian_splatting).
pub fn sh_basis(d: DVec3) -> [f64; SH_COUNT] {
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

/// The linear maps that turn coefficients of degree 1, 2 and 3.
#[derive(Clone, Debug)]
pub struct ShRotation {
    blocks: [Vec<f64>; 3],
}

impl ShRotation {
    /// For functions turned by `rotation`: `f'(d) = f(R⁻¹ d)`. The functions of one degree stay
    /// among themselves under rotation, so each block follows exactly from their values at
    /// directions spread over the sphere: with equal weights over a spherical design, `M_ij = Σ_k
    /// Y_i(d_k) Y_j(R⁻¹ d_k) · 4π / N`.
    pub fn new(rotation: DQuat) -> Self {
        let samples = quadrature();
        let back = rotation.conjugate();
        let blocks = [1, 2, 3].map(|degree| {
            let (first, n) = (degree * degree, 2 * degree + 1);
            let mut m = vec![0.0; n * n];
            for &(d, weight) in &samples {
                let (at, from) = (sh_basis(d), sh_basis(back * d));
                for i in 0..n {
                    for j in 0..n {
                        m[i * n + j] += weight * at[first + i] * from[first + j];
                    }
                }
            }
            m
        });
        Self { blocks }
    }

    /// Turns the coefficients of one Gaussian in place: `K × 3`, coefficient-major, K = 1, 4, 9 or
    /// 16.
    pub fn apply(&self, sh: &mut [f32]) {
        for (block, degree) in self.blocks.iter().zip(1..) {
            let (first, n) = (degree * degree, 2 * degree + 1);
            let Some(part) = sh.get_mut(first * 3..(first + n) * 3) else { return };
            let mut old = [0.0_f32; 21];
            old[..3 * n].copy_from_slice(part);
            for i in 0..n {
                for c in 0..3 {
                    let sum: f64 = (0..n).map(|j| block[i * n + j] * f64::from(old[j * 3 + c])).sum();
                    part[i * 3 + c] = sum as f32;
                }
            }
        }
    }
}

/// Directions and weights that integrate polynomials up to degree 7 over the sphere exactly: 4
/// Gauss–Legendre nodes in z times 8 equal angles.
fn quadrature() -> Vec<(DVec3, f64)> {
    let nodes = [
        (0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
        (0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
    ];
    let mut samples = Vec::with_capacity(32);
    for (z, weight) in nodes.into_iter().flat_map(|(z, w)| [(z, w), (-z, w)]) {
        for k in 0..8 {
            let angle = std::f64::consts::TAU * f64::from(k) / 8.0;
            let s = f64::sqrt(1.0 - z * z);
            samples.push((
                DVec3::new(s * angle.cos(), s * angle.sin(), z),
                weight * std::f64::consts::TAU / 8.0,
            ));
        }
    }
    samples
}

impl Gaussians {
    /// Moves, turns and scales the whole cloud: means, scales, rotations and view-dependent colour.
    pub fn transform(&mut self, target_from_source: &Sim3) {
        let log_scale = target_from_source.scale.ln() as f32;
        let turn = target_from_source.rotation;
        self.means.iter_mut().for_each(|m| *m = target_from_source.transform(m.as_dvec3()).as_vec3());
        self.log_scales.iter_mut().for_each(|s| *s += log_scale);
        for q in &mut self.rotations {
            // A quaternion of length zero means "not turned".
            let own = if q.length_squared() > 0.0 { q.as_dquat() } else { DQuat::IDENTITY };
            *q = (turn * own).as_quat();
        }
        let rotation = ShRotation::new(turn);
        let stride = self.sh_coefficients() * 3;
        self.sh.chunks_exact_mut(stride).for_each(|sh| rotation.apply(sh));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::rng;
    use rand::Rng;

    #[test]
    fn turned_coefficients_have_the_old_colour_in_the_turned_direction() {
        for seed in 0..50 {
            let mut r = rng(seed, "sh", 0);
            let mut v = || r.random_range(-1.0..1.0);
            let rotation = DQuat::from_xyzw(v(), v(), v(), v()).normalize();
            let d = DVec3::new(v(), v(), v()).normalize();
            let sh: Vec<f32> = (0..48).map(|_| v() as f32).collect();
            let mut turned = sh.clone();
            ShRotation::new(rotation).apply(&mut turned);
            let colour = |sh: &[f32], d: DVec3, c: usize| -> f64 {
                sh_basis(d).iter().enumerate().map(|(k, y)| y * f64::from(sh[k * 3 + c])).sum()
            };
            for c in 0..3 {
                let (old, new) = (colour(&sh, d, c), colour(&turned, rotation * d, c));
                assert!((old - new).abs() < 1e-5, "seed {seed}: {old} {new}");
            }
        }
    }

    #[test]
    fn the_functions_are_orthonormal() {
        // Degree 3 squared is degree 6, which the quadrature integrates exactly.
        for i in 0..SH_COUNT {
            for j in 0..SH_COUNT {
                let sum: f64 = quadrature().iter().map(|(d, w)| w * sh_basis(*d)[i] * sh_basis(*d)[j]).sum();
                assert!((sum - if i == j { 1.0 } else { 0.0 }).abs() < 1e-12, "{i} {j} {sum}");
            }
        }
    }

    #[test]
    fn turning_back_and_forth_changes_nothing() {
        let g = crate::io::ply::test_gaussians(20, 3);
        let sim = Sim3 {
            scale: 3.0,
            rotation: DQuat::from_rotation_y(1.1),
            translation: DVec3::new(1.0, 2.0, 3.0),
        };
        let mut moved = g.clone();
        moved.transform(&sim);
        moved.transform(&sim.inverse());
        let far = |a: &[f32], b: &[f32]| a.iter().zip(b).any(|(a, b)| (a - b).abs() > 1e-5);
        assert!(!far(&g.sh, &moved.sh));
        assert!(g.means.iter().zip(&moved.means).all(|(a, b)| (*a - *b).length() < 1e-5));
        assert!(g.rotations.iter().zip(&moved.rotations).all(|(a, b)| a.dot(*b).abs() > 1.0 - 1e-6));
    }
}
