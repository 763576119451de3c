//! The specification: scalar f64, forward and backward, written from the equations.
//!
//! A cloud of N Gaussians is projected to the screen ([`project`]), coloured ([`sh`]), put in order of depth
//! ([`sort`]) and composited over a background ([`rasterise`]); the picture is compared with a target ([`loss`]) and
//! the parameters are moved against the gradient ([`adam`]). [`mod@render`] chains the first four, in both directions.
//! The other backends have the same kernels under the same names and are held to this one by the tests in `parity`.
//!
//! Nothing here is fast and nothing is approximate: there are no tiles, every pixel looks at every Gaussian.
//! Each backward function takes the derivative of a scalar loss L with respect to what its forward function returns
//! and gives the derivative with respect to what that took. Cut-offs (culling, skipped and clamped values) are
//! discontinuous or flat; there the derivative is zero by definition.
//!
//! # Sources
//! - Zwicker, Pfister, van Baar, Gross, "EWA Splatting", IEEE TVCG 8(3), 2002: projection of a Gaussian.
//! - Kerbl, Kopanas, Leimkühler, Drettakis, "3D Gaussian Splatting for Real-Time Radiance Field Rendering", ACM ToG
//!   42(4), 2023: parameters, 0.3 px² low-pass, compositing, loss.
//! - Yu, Chen, Huang, Sattler, Geiger, "Mip-Splatting", CVPR 2024, section 4.2: opacity under the low-pass.
//! - Wang, Bovik, Sheikh, Simoncelli, "Image Quality Assessment", IEEE TIP 13(4), 2004: SSIM.
//! - Kingma, Ba, "Adam", ICLR 2015.
//! - Ye, Li, Liu, Qiao, Dou, "AbsGS", ACM MM 2024: sums of absolute screen-space gradients.

pub mod adam;
pub mod loss;
pub mod project;
pub mod rasterise;
pub mod render;
pub mod sh;
pub mod sort;

#[cfg(test)]
mod finite_differences;

pub use render::{Gradients, ImageGradient, Rendered, backward, render};

use glam::{DMat3, DQuat, DVec2, DVec3};
use scene::Gaussians;

/// N Gaussians in f64, laid out as [`scene::Gaussians`]; also the gradient with respect to them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// \[N\] μ, world frame, scene units.
    pub means: Vec<DVec3>,
    /// \[N\] natural logarithms of the standard deviations along the local axes.
    pub log_scales: Vec<DVec3>,
    /// \[N\] local to world, any norm (normalised on use; zero means identity).
    pub rotations: Vec<DQuat>,
    /// \[N\] opacity = 1 / (1 + exp(−logit)).
    pub opacity_logits: Vec<f64>,
    /// [N × K × 3] coefficient-major, K = (degree + 1)².
    pub sh: Vec<f64>,
    /// Degree of `sh`, 0 to 3.
    pub sh_degree: u32,
}

impl Parameters {
    /// The same Gaussians in f64.
    pub fn from_gaussians(g: &Gaussians) -> Self {
        Self {
            means: g.means.iter().map(|v| v.as_dvec3()).collect(),
            log_scales: g.log_scales.iter().map(|v| v.as_dvec3()).collect(),
            rotations: g.rotations.iter().map(|q| q.as_dquat()).collect(),
            opacity_logits: g.opacity_logits.iter().map(|&v| f64::from(v)).collect(),
            sh: g.sh.iter().map(|&v| f64::from(v)).collect(),
            sh_degree: g.sh_degree,
        }
    }

    /// All zero, in the shape of `other`.
    pub fn zeros_like(other: &Self) -> Self {
        Self {
            means: vec![DVec3::ZERO; other.len()],
            log_scales: vec![DVec3::ZERO; other.len()],
            rotations: vec![DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0); other.len()],
            opacity_logits: vec![0.0; other.len()],
            sh: vec![0.0; other.sh.len()],
            sh_degree: other.sh_degree,
        }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Length of one Gaussian's part of `sh`: 3 (degree + 1)².
    pub fn sh_stride(&self) -> usize {
        3 * (self.sh_degree as usize + 1).pow(2)
    }

    /// Spherical-harmonic coefficients of Gaussian `i`, [K × 3].
    pub fn sh_of(&self, i: usize) -> &[f64] {
        let k = self.sh_stride();
        &self.sh[i * k..(i + 1) * k]
    }
}

/// A pinhole camera and its pose, f64.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// R of x_cam = R x_world + t.
    pub rotation: DMat3,
    /// t of x_cam = R x_world + t.
    pub translation: DVec3,
    /// Focal lengths fx, fy, pixels.
    pub focal: DVec2,
    /// Principal point cx, cy, pixels; pixel (column, row) has its centre at (column + 0.5, row + 0.5).
    pub centre: DVec2,
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
}

impl View {
    /// Where the camera stands in the world: −Rᵀ t.
    pub fn position(&self) -> DVec3 {
        -(self.rotation.transpose() * self.translation)
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// The view with a small motion in the camera frame after its pose: x_cam ← exp(\[ω\]×) x_cam + v.
    pub fn moved(&self, omega: DVec3, v: DVec3) -> Self {
        let rotation = DMat3::from_quat(DQuat::from_scaled_axis(omega));
        Self { rotation: rotation * self.rotation, translation: rotation * self.translation + v, ..*self }
    }
}

/// What the image formation can be told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Gaussians whose centre has a camera z below this are not drawn, scene units.
    pub near: f64,
    /// Scale opacity by what the low-pass takes away (Mip-Splatting's 2D filter).
    pub antialias: bool,
    /// Colour behind everything.
    pub background: DVec3,
    /// Spherical harmonics above this degree are left out.
    pub sh_degree: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self { near: 0.01, antialias: false, background: DVec3::ZERO, sh_degree: 3 }
    }
}

/// Derivative of L with respect to a small motion of the camera, see [`View::moved`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseGradient {
    /// With respect to ω, camera frame, a radian.
    pub omega: DVec3,
    /// With respect to v, camera frame, a scene unit.
    pub translation: DVec3,
}

impl std::ops::AddAssign for PoseGradient {
    fn add_assign(&mut self, other: Self) {
        self.omega += other.omega;
        self.translation += other.translation;
    }
}
