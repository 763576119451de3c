//! Gaussian splatting: from posed images to Gaussians, and from Gaussians to images.
//!
//! The trainer works in a normalised frame (cameras within about one unit of the origin, [`Dataset`]); results
//! come back in the world frame of the reconstruction. Backends share the kernels' names and their image formation:
//! `reference` is the specification in f64, `cpu` the production path, `gpu` the same on graphics adapters.

pub mod adapter;
pub mod backend;
pub mod checkpoint;
pub mod clock;
pub mod config;
mod cpu;
pub mod dataset;
pub mod densify;
pub mod device;
pub mod error;
mod footprint;
pub mod fusion;
#[cfg(feature = "gpu")]
mod gpu;
pub mod hull;
pub mod init;
pub mod model;
pub mod pace;
#[cfg(test)]
mod parity;
pub mod reference;
pub mod render;
pub mod schedule;
pub mod smoothing;
pub mod surface;
pub mod train;

pub use adapter::{Adapter, AdapterKind, adapters};
pub use backend::{Backend, PinholeView};
pub use config::{PoseRefinement, Quality, Recipe, Selection, TrainConfig};
pub use dataset::{AlphaMode, Dataset, DatasetConfig, View};
pub use device::{BackendChoice, DeviceConfig};
pub use error::SplatError;
pub use render::{RenderOptions, RenderOutput, Renderer, render_view};
pub use train::{CurvePoint, Decision, TrainResult, train};
