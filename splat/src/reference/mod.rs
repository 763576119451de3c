//! The specification: scalar f64, forward and backward, written from the equations.
//!
//! A cloud of N Gaussians is projected to the screen ([`project`]), coloured ([`sh`]), put in order
//! of depth ([`sort`]) and composited over a background ([`rasterise`]); the picture is compared
//! with a target ([`loss`]) and the parameters are moved against the gradient ([`adam`]).
//! [`mod@render`] chains the first four, in both directions. The other backends have the same
//! kernels under the same names and are held to this one by the tests in `parity`.
//!
//! Nothing here is fast and nothing is approximate: there are no tiles, every pixel looks at every
//! Gaussian. Each backward function takes the derivative of a scalar loss L with respect to what
//! its forward function returns and gives the derivative with respect to what that took. Cut-offs
//! (culling, skipped and clamped values) are discontinuous or flat; there the derivative is zero by
//! definition.
//!
//! # Sources
//! - Zwicker, Pfister, van Baar, Gross, "EWA Splatting", IEEE TVCG 8(3), 2002: projection of a
//!   Gaussian.
//! - Kerbl, Kopanas, Leimkühler, Drettakis, "3D Gaussian Splatting for Real-Time Radiance Field
//!   Rendering", ACM ToG
//!   42(4), 2023: parameters, 0.3 px² low-pass, compositing, loss.
//! - Yu, Chen, Huang, Sattler, Geiger, "Mip-Splatting", CVPR 2024, section 4.2: opacity under the
//!   low-pass.
//! - Wang, Bovik, Sheikh, Simoncelli, "Image Quality Assessment", IEEE TIP 13(4), 2004: SSIM.
//! - Kingma, Ba, "Adam", ICLR 2015.
//! - Ye, Li, Liu, Qiao, Dou, "AbsGS", ACM MM 2024: sums of absolute screen-space gradients.

#[cfg(test)]
pub(crate) mod adam;
pub(crate) mod constants;
#[cfg(test)]
pub(crate) mod derivatives;
#[cfg(test)]
pub(crate) mod loss;
pub(crate) mod parameters;
pub(crate) mod project;
#[cfg(test)]
pub(crate) mod project_backward;
#[cfg(test)]
pub(crate) mod rasterise;
#[cfg(test)]
pub(crate) mod render;
#[cfg(test)]
pub(crate) mod sh;
pub(crate) mod sort;

#[cfg(test)]
mod finite_differences;

pub(crate) use parameters::{GaussianGeometry, Options, Parameters, ReferenceView};
#[cfg(test)]
pub(crate) use render::{Rendered, backward, render};
