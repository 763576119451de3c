//! Gaussian splatting: from posed images to Gaussians, and from Gaussians to images.
//!
//! The trainer works in a normalised frame (cameras within about one unit of the origin,
//! [`Dataset`]); results come back in the world frame of the reconstruction. Backends share the
//! kernels' names and their image formation: `reference` is the specification in f64, `cpu` the
//! production path, `gpu` the same on graphics adapters.
//!
//! [`train()`] makes Gaussians of a [`Dataset`], [`Renderer`] pictures of Gaussians, [`fusion`] a
//! mesh.

#![warn(clippy::undocumented_unsafe_blocks, unreachable_pub)]

mod adapter;
pub mod backend;
mod camera;
pub mod config;
mod cpu;
mod dataset;
pub mod device;
mod error;
mod footprint;
pub mod fusion;
#[cfg(feature = "gpu")]
mod gpu;
mod hull;
mod init;
pub mod model;
pub mod moved;
mod outline;
#[cfg(test)]
mod parity;
mod parts;
pub mod profile;
mod quantile;
mod reference;
mod render;
pub mod simd;
mod sky;
pub mod statistics;
pub mod surface;
pub mod train;
mod view;

pub use adapter::{Adapter, AdapterKind};
pub use config::{PoseRefinement, Quality, TrainConfig};
pub use dataset::{
    AlphaMode, Dataset, DatasetConfig, MovingParts, NormalisedFrame, Pixels, View, joint::Joint, pyramid,
};
pub use device::{BackendChoice, DeviceConfig, adapters};
pub use error::SplatError;
pub use render::Renderer;
pub use train::{CurvePoint, TrainResult, train};
pub use view::{PinholeView, RenderOptions, RenderOutput};
