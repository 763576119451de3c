//! What kernels cost, and what the machine could do at best: for the examples that measure.
//!
//! ```
//! use splat::profile::ProfiledProcessor;
//!
//! let processor = ProfiledProcessor::new(splat::model::Model::default(),
//! scene::clock::cpu_seconds)?;
//! assert_eq!(processor.times().forward, 0.0);
//! # Ok::<(), splat::SplatError>(())
//! ```

use crate::backend::{Backend as _, KernelTimes, StepInput, StepOutput};
use crate::config::TrainConfig;
use crate::cpu::{CpuBackend, limits};
use crate::dataset::Dataset;
use crate::error::SplatError;
use crate::init::initial_model;
use crate::model::Model;
use crate::statistics::Statistics;
use scene::Gaussians;

#[cfg(feature = "gpu")]
pub use crate::gpu::AdapterLimits;

/// What one core does at best.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoreLimits {
    /// Multiply-adds of f32 a second: vectors times lanes, of the widest instruction set.
    pub multiply_adds: f64,
    /// Bytes read and written a second where nothing fits into the caches.
    pub bytes: f64,
}

impl CoreLimits {
    /// Measures them, in about a second.
    pub fn measure() -> Self {
        Self { multiply_adds: limits::multiply_adds(), bytes: limits::bytes() }
    }
}

/// Measures what a graphics adapter does at best: the first one whose name contains `name`, or the
/// first at all.
#[cfg(feature = "gpu")]
pub fn measure_adapter(name: Option<&str>) -> Result<AdapterLimits, SplatError> {
    let opening = crate::gpu::Opening { name: name.map(str::to_owned), ..Default::default() };
    AdapterLimits::measure(&crate::gpu::Gpu::open(&opening)?)
}

/// The Gaussians that training begins with, normalised frame: for exports to another trainer.
pub fn first_gaussians(dataset: &Dataset, config: &TrainConfig) -> Result<Gaussians, SplatError> {
    Ok(initial_model(dataset, config.max_gaussians, config.seed)?.to_gaussians())
}

/// Training steps on the processor whose kernels are timed by a clock of choice.
pub struct ProfiledProcessor(CpuBackend);

impl ProfiledProcessor {
    /// Of a model; `clock` gives seconds, such as [`scene::clock::cpu_seconds`].
    pub fn new(model: Model, clock: fn() -> f64) -> Result<Self, SplatError> {
        let mut backend = CpuBackend::default();
        backend.set_clock(clock);
        backend.upload(model, Statistics::default())?;
        Ok(Self(backend))
    }

    /// Takes a step.
    pub fn step(&mut self, input: &StepInput) -> Result<StepOutput, SplatError> {
        self.0.step(input)
    }

    /// Seconds by kernel so far.
    pub fn times(&self) -> KernelTimes {
        self.0.times()
    }

    /// Gaussian–pixel pairs that the last picture took, with the unused lanes of vectors.
    pub fn gaussian_pixels(&self) -> u64 {
        self.0.gaussian_pixels()
    }
}
