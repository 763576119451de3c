//! Fields on graphics adapters, through wgpu: [`device`] opens an adapter and runs kernels, [`kit`]
//! has the kernels (one WGSL file each in `wgsl`), [`stack`] networks of dense layers with their
//! optimiser, [`samples`] what lies between networks and rays. What each method does with them is
//! in its own folder.

pub(crate) mod device;
pub(crate) mod kit;
pub(crate) mod samples;
pub(crate) mod stack;

#[cfg(test)]
pub(crate) mod parity_tests;

pub(crate) use device::{DeviceArray, FieldBatch};
pub(crate) use kit::FieldKit;
