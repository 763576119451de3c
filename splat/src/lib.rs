//! Gaussian splatting: from posed images to Gaussians, and from Gaussians to images.
//!
//! The trainer works in a normalised frame (cameras within about one unit of the origin, [`Dataset`]); results
//! come back in the world frame of the reconstruction. Backends share the kernels' names and their image formation:
//! `reference` is the specification in f64, `cpu` the production path, `gpu` the same on graphics adapters.

pub mod adapter;
pub mod backend;
mod camera;
pub mod checkpoint;
pub mod clock;
pub mod config;
mod cpu;
pub mod dataset;
mod decision;
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
pub mod profile;
mod reference;
pub mod render;
pub mod schedule;
pub mod smoothing;
pub mod statistics;
pub mod surface;
pub mod train;
mod view;

pub use adapter::{Adapter, AdapterKind};
pub use backend::Backend;
pub use config::{PoseRefinement, Quality, Recipe, TrainConfig};
pub use dataset::{AlphaMode, Dataset, DatasetConfig, View};
pub use decision::Decision;
pub use device::{BackendChoice, DeviceConfig, adapters};
pub use error::SplatError;
pub use render::{Renderer, render_view};
pub use train::{CurvePoint, TrainResult, train};
pub use view::{PinholeView, RenderOptions, RenderOutput};
