//! What light an object stands in, told from its splat and its photos, and the splat in another
//! light.
//!
//! On a turntable lamp and camera stand still, so that the lamp goes round the object and each
//! place is seen in light and in shade. In linear light its colour is modelled as
//! `albedo · (ambient + max(0, normal · lamp) · lit)`: one lamp at infinity that is fixed to the
//! camera, Lambert's law, and the shadows that the Gaussians cast on each other. What glints is not
//! modelled.

#![warn(clippy::undocumented_unsafe_blocks, unreachable_pub)]

mod colour;
mod fit;
mod lamp;
mod lighting;
mod shadows;
mod solid;
mod surface;
mod trial;

pub use lamp::{Lamp, direction};
pub use lighting::{LightError, Lighting};
pub use solid::SolidSplat;

#[cfg(test)]
mod tests;
