//! The backend for graphics adapters, through wgpu: one WGSL kernel a file in `wgsl/`, Rust twins of its structs in
//! [`layout`], pipelines in [`kernels`], what lies on the device in [`buffers`], and the adapter and its limits in
//! [`context`].

mod backend;
pub mod bound;
pub mod buffers;
pub mod context;
pub mod kernels;
pub mod layout;
mod probe;

pub use backend::GpuBackend;
pub use context::{Gpu, adapters};
pub use probe::OnScreen;

#[cfg(test)]
mod tests;
