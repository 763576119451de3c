//! Structure from motion: features, matching, verification, triangulation, bundle adjustment.

pub mod bundle;
pub mod ceres;
pub mod error;
pub mod incremental;
pub mod matching;
pub mod pairs;
pub mod ransac;
pub mod selection;
pub mod sift;
pub mod solvers;
pub mod tracks;
pub mod triangulation;
pub mod two_view;
pub mod undistort;

pub use error::SfmError;
