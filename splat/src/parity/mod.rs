//! Every backend against the f64 reference: kernel by kernel, whole pictures, whole gradients,
//! whole training steps, and what happens at the extremes. The tests are generic over
//! [`subject::Subject`].

mod adam;
mod allocations;
#[cfg(feature = "gpu")]
mod device;
mod extremes;
#[cfg(feature = "gpu")]
mod gpu;
mod kernels;
mod pictures;
mod scenes;
mod scores;
mod steps;
pub(crate) mod subject;
#[cfg(feature = "gpu")]
mod training;
