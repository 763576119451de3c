//! What is made of a triangle mesh: fewer triangles, no holes, a texture from the photos, measures.
//!
//! Any mesh will do. Triangles whose corners are not finite count as missing, and neither the unit
//! nor the place of a scene matters.

#![warn(clippy::undocumented_unsafe_blocks, unreachable_pub)]

mod decimate;
pub mod measure;
mod raster;
#[cfg(test)]
mod testing;
mod texture;
mod watertight;

pub use decimate::{Decimation, decimated};
pub use texture::{TextureOptions, textured};
pub use watertight::watertight;
