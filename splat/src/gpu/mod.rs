//! The backend for graphics adapters, through wgpu: one WGSL kernel a file in `wgsl/`, Rust twins
//! of its structs in [`layout`], pipelines in [`kernels`]; the model on the device in [`pages`],
//! photos in [`photos`], the view's results in [`buffers`]; steps under way in [`flight`]; the
//! adapter and its limits in [`context`].

mod backend;
mod bound;
mod buffers;
mod context;
mod densify;
mod flight;
mod gradients;
mod kernels;
mod layout;
mod limits;
mod pages;
mod photos;
mod pipelines;
#[cfg(test)]
mod probe;
mod room;

pub(crate) use backend::GpuBackend;
pub(crate) use context::{Gpu, Opening, adapters};
pub use limits::AdapterLimits;

#[cfg(test)]
mod tests;
