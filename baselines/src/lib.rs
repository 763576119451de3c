//! Radiance fields other than Gaussians, behind one trait: what the splats are compared with.

#![warn(clippy::undocumented_unsafe_blocks, unreachable_pub)]

mod adam;
mod composite;
mod dense;
mod domain;
mod error;
mod field;
mod instant_ngp;
mod loss;
mod mlp;
mod rays;

pub use error::FieldError;
pub use field::{Kept, RadianceField, StepPlace, StepReport};
pub use rays::{Photos, Ray};

use splat::Dataset;

/// An untrained Instant NeRF of a data set.
pub fn instant_ngp(dataset: &Dataset, seed: u64) -> Box<dyn RadianceField> {
    let views: Vec<_> = dataset.training_views().iter().map(|&i| dataset.views[i].view).collect();
    let shape = instant_ngp::NgpShape::new(domain::Domain::of(dataset));
    Box::new(instant_ngp::InstantNgp::new(shape, &views, seed))
}
