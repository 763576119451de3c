//! Minimal and linear solvers of multiple view geometry: one problem, one file.

pub mod decompose;
pub mod epipolar;
pub mod essential_5pt;
pub mod fundamental_7pt;
pub mod fundamental_8pt;
pub mod homography_4pt;
pub(crate) mod levenberg;
pub(crate) mod linalg;
#[cfg(test)]
mod oracle_tests;
pub mod p3p;
pub mod polynomial;
pub mod refine_absolute;
pub mod refine_relative;
#[cfg(test)]
pub(crate) mod testing;

pub use decompose::{
    Cheirality, PlanarMotion, cheirality, motions_from_homography, pose_from_essential, poses_from_essential,
};
pub use epipolar::{essential_from_pose, ray_depths, sampson_sq, transfer_sq};
pub use essential_5pt::essential_5pt;
pub use fundamental_7pt::fundamental_7pt;
pub use fundamental_8pt::{Normaliser, fundamental_8pt};
pub use homography_4pt::{homography_4pt, homography_dlt};
pub use p3p::p3p;
pub use refine_absolute::{AbsoluteRefinement, refine_absolute};
pub use refine_relative::{Pairs, refine_fundamental, refine_relative};
