//! The kernels, compiled once for all fields of a run.

use super::device::{FieldDevice, FieldKernel, FieldSource};
use crate::error::FieldError;
use splat::DeviceConfig;
use std::sync::Arc;

const DENSE: &str = include_str!("wgsl/dense.wgsl");
const SAMPLES: &str = include_str!("wgsl/samples.wgsl");
const FIXED: &str = include_str!("wgsl/fixed.wgsl");

/// All modules, in the order of the fields of [`FieldKit`].
pub(crate) const SOURCES: [FieldSource; 8] = [
    FieldSource {
        name: "dense forward",
        parts: &[DENSE, include_str!("wgsl/dense_forward.wgsl")],
        bindings: "rrrw",
        entries: &["forward"],
    },
    FieldSource {
        name: "dense backward",
        parts: &[DENSE, include_str!("wgsl/dense_backward.wgsl")],
        bindings: "rrrww",
        entries: &["backward"],
    },
    FieldSource {
        name: "dense weights",
        parts: &[DENSE, include_str!("wgsl/dense_weights.wgsl")],
        bindings: "rrrrww",
        entries: &["weights", "biases", "total"],
    },
    FieldSource {
        name: "adam",
        parts: &[include_str!("wgsl/adam.wgsl"), FIXED],
        bindings: "wwwwww",
        entries: &["all", "touched"],
    },
    FieldSource {
        name: "rays",
        parts: &[SAMPLES, include_str!("wgsl/rays.wgsl")],
        bindings: "rrwwww",
        entries: &["spread", "shade"],
    },
    FieldSource {
        name: "composite",
        parts: &[SAMPLES, include_str!("wgsl/composite.wgsl")],
        bindings: "rrwwww",
        entries: &["composite"],
    },
    FieldSource {
        name: "hash",
        parts: &[include_str!("wgsl/hash.wgsl"), FIXED],
        bindings: "rrrww",
        entries: &["encode", "scatter"],
    },
    FieldSource {
        name: "waves",
        parts: &[include_str!("wgsl/waves.wgsl")],
        bindings: "rwwww",
        entries: &["with_times", "moved", "backward"],
    },
];

/// An adapter and its kernels.
pub(crate) struct FieldKit {
    pub(crate) device: FieldDevice,
    pub(crate) forward: FieldKernel,
    pub(crate) backward: FieldKernel,
    pub(crate) weights: FieldKernel,
    pub(crate) adam: FieldKernel,
    pub(crate) rays: FieldKernel,
    pub(crate) composite: FieldKernel,
    pub(crate) hash: FieldKernel,
    pub(crate) waves: FieldKernel,
}

impl FieldKit {
    /// What the configuration asks for; `None` is the processor.
    pub(crate) fn open(config: &DeviceConfig) -> Result<Option<Arc<Self>>, FieldError> {
        let Some(device) = FieldDevice::open(config)? else { return Ok(None) };
        let compiled: Result<Vec<FieldKernel>, FieldError> =
            SOURCES.iter().map(|source| device.kernel(source)).collect();
        let mut kernels = compiled?.into_iter();
        let mut next = || kernels.next().ok_or_else(|| device.error("a kernel is missing"));
        let [forward, backward, weights] = [next()?, next()?, next()?];
        let [adam, rays, composite, hash, waves] = [next()?, next()?, next()?, next()?, next()?];
        Ok(Some(Arc::new(Self { forward, backward, weights, adam, rays, composite, hash, waves, device })))
    }
}
