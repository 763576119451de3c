//! Shapes against a true surface: triangle meshes, distances, and what is seen of them.

mod mesh;
mod metrics;
mod visible;

pub use mesh::{Mesh, Surface};
pub use metrics::{GeometryErrors, compare_points};
pub use visible::{DepthView, seen_by};
