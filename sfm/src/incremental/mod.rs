//! Incremental mapping, and what it has in common with the other ways to a model: the growing
//! model, its adjustment, resection, and the last adjustments.

pub(crate) mod adjust;
pub(crate) mod aliasing;
mod config;
pub(crate) mod depths;
pub(crate) mod finish;
pub(crate) mod growth;
pub(crate) mod initial;
pub(crate) mod map;
mod merge;
pub(crate) mod resection;
pub(crate) mod state;
pub(crate) mod structureless_resection;

pub use config::{MapperChoice, MapperConfig};
