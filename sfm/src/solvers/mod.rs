//! Minimal and linear solvers of multiple view geometry: one problem, one file.

pub(crate) mod cholesky;
mod decompose;
mod epipolar;
mod essential_5pt;
mod fundamental_7pt;
mod fundamental_8pt;
mod homography_4pt;
pub(crate) mod levenberg;
pub(crate) mod linalg;
#[cfg(test)]
mod oracle_tests;
mod p3p;
mod polynomial;
mod refine_absolute;
mod refine_relative;
#[cfg(test)]
pub(crate) mod testing;

pub(crate) use decompose::{cheirality, motions_from_homography, pose_from_essential};
pub(crate) use epipolar::{essential_from_pose, sampson_sq, transfer_sq};
pub(crate) use essential_5pt::essential_5pt;
pub(crate) use fundamental_7pt::fundamental_7pt;
pub(crate) use fundamental_8pt::fundamental_8pt;
pub(crate) use homography_4pt::{homography_4pt, homography_dlt};
pub(crate) use p3p::p3p;
pub(crate) use refine_absolute::{AbsoluteRefinement, refine_absolute};
pub(crate) use refine_relative::{Pairs, refine_fundamental, refine_relative};
