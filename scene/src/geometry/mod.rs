//! Shapes: triangle meshes, their distances and what is seen of them, and their making from depth
//! maps.

mod cubes;
mod depth_map;
mod extract;
mod facing;
mod fusion;
mod mesh;
mod metrics;
mod parts;
mod settle;
mod textured;
mod thin;
mod visible;
mod volume;

pub use depth_map::{DepthMap, points_of};
pub use fusion::{FusionError, fuse};
pub use mesh::{Mesh, Surface};
pub use metrics::{GeometryErrors, compare_points};
pub use parts::JoinedSets;
pub use textured::TexturedMesh;
pub use thin::thin_parts;
pub use visible::{DepthView, seen_by};
pub use volume::FusionOptions;
