//! Structure from motion: features, matching, verification, triangulation, bundle adjustment.

pub mod bundle;
pub mod ceres;
pub mod circular;
pub mod config;
mod disjoint_sets;
pub mod error;
mod global;
pub mod incremental;
pub mod klt;
pub mod knowledge;
pub mod matching;
pub mod model_selection;
pub mod pairs;
mod plane_tracks;
pub mod ransac;
mod reconstruct;
mod refinement;
pub mod result;
pub mod sift;
mod skip;
pub mod solvers;
mod statistics;
pub mod tracks;
pub mod triangulation;
pub mod two_view;
pub mod undistort;

pub use config::{CameraModelChoice, CameraSharing, KeypointPlaces, SfmConfig};
pub use error::SfmError;
pub use incremental::MapperChoice;
pub use knowledge::{Calibration, Knowledge};
pub use reconstruct::{Supplied, reconstruct, reconstruct_features, reconstruct_from, triangulate_given};
pub use result::{Decision, PoseDeviation, SfmResult, SfmStats, StepTime, Uncertainty};
pub use skip::StepName;
pub use undistort::undistort;
