//! Structure from motion: features, matching, verification, triangulation, bundle adjustment.

pub mod bundle;
pub mod ceres;
pub mod config;
pub mod error;
mod global;
mod ground;
pub mod incremental;
pub mod klt;
pub mod knowledge;
pub mod mapper;
pub mod matching;
pub mod pairs;
pub mod pipeline;
pub mod ransac;
mod refinement;
pub mod result;
pub mod selection;
pub mod sift;
pub mod single_axis;
pub mod solvers;
pub mod tracks;
pub mod triangulation;
pub mod turned;
pub mod two_view;
pub mod undistort;

pub use config::{CameraModelChoice, CameraSharing, KeypointPlaces, SfmConfig};
pub use error::SfmError;
pub use knowledge::{Calibration, Knowledge};
pub use pipeline::{Supplied, reconstruct, reconstruct_features, reconstruct_from, triangulate_given};
pub use result::{Decision, PoseDeviation, SfmResult, SfmStats, StepTime, Uncertainty};
pub use undistort::undistort;
