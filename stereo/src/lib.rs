//! Dense depths from photos whose cameras are known: multi-view stereo by PatchMatch.
//!
//! Each pixel holds a plane (a depth and a normal). Planes of neighbours, and small random changes
//! of its own, are tried in turn; the one stays under which the patch around the pixel looks most
//! alike in other views (bilaterally weighted normalised cross-correlation). From a quarter of the
//! resolution to the full one; then the views' depths must agree.
//!
//! Sources: Barnes et al., "PatchMatch", SIGGRAPH 2009; Bleyer et al., "PatchMatch Stereo", BMVC
//! 2011; Galliani et al., "Massively Parallel Multiview Stereopsis by Surface Normal Diffusion"
//! (Gipuma), ICCV 2015; Schönberger et al., "Pixelwise View Selection for Unstructured Multi-View
//! Stereo", ECCV 2016; Xu and Tao, "Multi-Scale Geometric Consistency Guided Multi-View Stereo"
//! (ACMM), CVPR 2019.

#![warn(clippy::undocumented_unsafe_blocks, unreachable_pub)]

mod agree;
mod cloud;
mod correlation;
mod depths;
mod field;
mod hull;
mod joined;
mod kept;
mod level;
mod neighbours;
mod outline;
mod pair;
mod seen_through;
mod settings;
mod sweep;
mod view;

pub use cloud::StereoPoint;
pub use depths::{DenseDepths, dense_depths};
pub use field::PlaneField;
pub use joined::DepthJoin;
pub use settings::{StereoSettings, Tolerance};
pub use view::StereoError;

#[cfg(test)]
mod tests;
