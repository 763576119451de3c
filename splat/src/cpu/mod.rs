//! The production backend: f32, 16 × 16 tiles over rayon, SIMD across pixels (rasterisation, loss) and across
//! Gaussians (projection, optimiser). Results do not depend on the number of threads: every sum has a fixed order.

pub mod adam;
pub mod limits;
pub mod loss;
pub mod project;
pub mod rasterise;
pub mod sh;
pub mod simd;
pub mod sort;
#[cfg(target_arch = "aarch64")]
pub mod simd_neon;
#[cfg(target_arch = "x86_64")]
pub mod simd_x86;

mod backend;
mod target;
mod workspace;

pub use backend::{CpuBackend, DEFAULT_NEAR, Gradients};
