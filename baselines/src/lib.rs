//! Radiance fields other than Gaussians, behind one trait: what the splats are compared with.
//!
//! [`train()`] makes a [`TrainedField`] of a [`splat::Dataset`]; a field is a [`RadianceField`] in
//! the normalised frame of its data set.
//!
//! ```no_run
//! use baselines::{FieldConfig, Method, train};
//! use scene::Progress;
//! use splat::{Dataset, DatasetConfig};
//! use std::path::Path;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let model = scene::io::read_model(Path::new("out/sparse/0"))?;
//! let (data, progress) = (DatasetConfig::default(), Progress::silent());
//! let dataset = Dataset::load(Path::new("out/images"), None, &model, &data, &progress)?;
//! let config = FieldConfig::new(Method::InstantNgp, 4000);
//! let result = train(&dataset, &[], &config, None, &progress)?;
//! result.field.write(Path::new("out/field.bin"))?;
//! # Ok(())
//! # }
//! ```

#![warn(clippy::undocumented_unsafe_blocks, unreachable_pub)]

mod accelerator;
mod adam;
mod composite;
mod dense;
mod domain;
mod error;
mod field;
#[cfg(feature = "gpu")]
mod gpu;
mod instant_ngp;
mod kept;
mod loss;
mod method;
mod mlp;
mod moving;
mod nerf;
mod rays;
mod stack;
mod store;
mod train;
mod trained;

#[cfg(test)]
mod tests;
#[cfg(test)]
mod twin_tests;

pub use accelerator::Accelerator;
pub use error::FieldError;
pub use field::{Kept, RadianceField, StepPlace, StepReport};
pub use method::Method;
pub use rays::{PhotoRays, Ray};
pub use train::{FieldConfig, FieldResult, train};
pub use trained::TrainedField;
