//! The backend for graphics adapters, through wgpu: one WGSL kernel a file in `wgsl/`, Rust twins of its structs in
//! [`layout`], pipelines in [`kernels`]; the model on the device in [`pages`], photos in [`photos`], the view's results in
//! [`buffers`]; steps under way in [`flight`]; the adapter and its limits in [`context`].

mod backend;
pub mod bound;
pub mod buffers;
pub mod context;
mod densify;
pub mod flight;
pub mod kernels;
pub mod layout;
pub mod pages;
pub mod photos;
pub mod pipelines;
mod probe;
mod roof;
mod scores;

pub use backend::GpuBackend;
pub use context::{Gpu, Opening, adapters};
pub use probe::OnScreen;
pub use roof::{Roof, measure as roof};

#[cfg(test)]
mod tests;
