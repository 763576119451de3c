//! The production backend: f32, 16 × 16 tiles over rayon, SIMD across pixels (rasterisation, loss)
//! and across Gaussians (projection, optimiser). Results do not depend on the number of threads:
//! every sum has a fixed order.

mod adam;
mod backend;
mod bounds;
pub(crate) mod densify;
pub(crate) mod dispatch;
pub(crate) mod limits;
pub(crate) mod loss;
mod model_part;
pub(crate) mod project;
mod project_backward;
mod rasterise;
pub(crate) mod sh;
mod shared;
pub(crate) mod simd;
#[cfg(target_arch = "aarch64")]
pub(crate) mod simd_neon;
pub(crate) mod simd_portable;
#[cfg(target_arch = "x86_64")]
pub(crate) mod simd_x86;
mod sort;
mod target;
pub(crate) mod tile;
mod workspace;

pub(crate) use backend::CpuBackend;
#[cfg(test)]
pub(crate) use model_part::ModelGradient;
pub(crate) use tile::TILE;
