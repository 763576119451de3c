//! What the specification's functions take: Gaussians, a camera, options; in f64.

use super::constants::DEFAULT_NEAR;
use glam::{DMat3, DQuat, DVec2, DVec3};
use scene::Gaussians;

/// N Gaussians in f64, laid out as [`scene::Gaussians`]; also the gradient with respect to them.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Parameters {
    /// \[N\] μ, world frame, scene units.
    pub(crate) means: Vec<DVec3>,
    /// \[N\] natural logarithms of the standard deviations along the local axes.
    pub(crate) log_scales: Vec<DVec3>,
    /// \[N\] local to world, any norm (normalised on use; zero means identity).
    pub(crate) rotations: Vec<DQuat>,
    /// \[N\] opacity = 1 / (1 + exp(−logit)).
    pub(crate) opacity_logits: Vec<f64>,
    /// [N × K × 3] coefficient-major, K = (degree + 1)².
    pub(crate) sh: Vec<f64>,
    /// Degree of `sh`, 0 to 3.
    pub(crate) sh_degree: u32,
}

impl Parameters {
    /// The same Gaussians in f64.
    pub(crate) fn from_gaussians(g: &Gaussians) -> Self {
        Self {
            means: g.means.iter().map(|v| v.as_dvec3()).collect(),
            log_scales: g.log_scales.iter().map(|v| v.as_dvec3()).collect(),
            rotations: g.rotations.iter().map(|q| q.as_dquat()).collect(),
            opacity_logits: g.opacity_logits.iter().map(|&v| f64::from(v)).collect(),
            sh: g.sh.iter().map(|&v| f64::from(v)).collect(),
            sh_degree: g.sh_degree,
        }
    }

    /// Number of Gaussians.
    pub(crate) fn len(&self) -> usize {
        self.means.len()
    }
}

/// A pinhole camera and its pose, f64.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ReferenceView {
    /// R of x_cam = R x_world + t.
    pub(crate) rotation: DMat3,
    /// t of x_cam = R x_world + t.
    pub(crate) translation: DVec3,
    /// Focal lengths fx, fy, pixels.
    pub(crate) focal: DVec2,
    /// Principal point cx, cy, pixels; pixel (column, row) has its centre at (column + 0.5, row +
    /// 0.5).
    pub(crate) centre: DVec2,
    /// Width, pixels.
    pub(crate) width: usize,
    /// Height, pixels.
    pub(crate) height: usize,
}

impl ReferenceView {
    /// Number of pixels.
    pub(crate) fn pixels(&self) -> usize {
        self.width * self.height
    }
}

impl Parameters {
    /// The geometry of Gaussian `i`.
    pub(crate) fn geometry(&self, i: usize) -> GaussianGeometry {
        GaussianGeometry {
            mean: self.means[i],
            log_scale: self.log_scales[i],
            rotation: self.rotations[i],
            logit: self.opacity_logits[i],
        }
    }
}

/// What the image formation can be told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Options {
    /// Gaussians whose centre has a camera z below this are not drawn, scene units.
    pub(crate) near: f64,
    /// Scale opacity by what the low-pass takes away (Mip-Splatting's 2D filter).
    pub(crate) antialias: bool,
    /// Colour behind everything.
    pub(crate) background: DVec3,
    /// Spherical harmonics above this degree are left out.
    pub(crate) sh_degree: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self { near: DEFAULT_NEAR, antialias: false, background: DVec3::ZERO, sh_degree: 3 }
    }
}

/// The parameters that decide where a Gaussian is seen; also the gradient with respect to them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct GaussianGeometry {
    /// μ, world frame.
    pub(crate) mean: DVec3,
    /// Logarithms of the standard deviations.
    pub(crate) log_scale: DVec3,
    /// Local to world, any norm.
    pub(crate) rotation: DQuat,
    /// Opacity logit.
    pub(crate) logit: f64,
}
