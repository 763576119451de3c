//! Structure from motion: features, matching, verification, mapping, bundle adjustment.
//!
//! ```no_run
//! # fn main() -> Result<(), sfm::SfmError> {
//! let frames = scene::FrameSet::default();
//! let result = sfm::reconstruct(&frames, &sfm::SfmConfig::default(), &scene::Progress::silent())?;
//! println!("{} of {} images have a pose", result.stats.registered, result.stats.images);
//! # Ok(())
//! # }
//! ```

#![warn(unreachable_pub)]

mod articulated;
mod bundle;
mod ceres;
mod circular;
mod config;
mod disjoint_sets;
mod error;
mod global;
mod incremental;
mod klt;
mod knowledge;
mod limits;
pub mod matching;
mod metric;
mod model_selection;
mod outline_pieces;
mod pairs;
mod plane_tracks;
mod plausibility;
mod ransac;
mod reconstruct;
mod refinement;
mod result;
pub mod sift;
mod skip;
mod solvers;
mod statistics;
mod torque_free;
mod tracks;
mod triangulation;
pub mod two_view;
mod undistort;
mod upright;

pub use articulated::{
    Articulation, LooseJoint, LoosePiece, MovingPart, frame_times, loose_joints, moving_parts,
};
pub use circular::{Motion, MotionConfig};
pub use config::{CameraModelChoice, CameraSharing, KeypointPlaces, SfmConfig};
pub use error::SfmError;
pub use incremental::{MapperChoice, MapperConfig};
pub use klt::KltConfig;
pub use knowledge::Calibration;
pub use metric::{LengthEnds, ScaleConfig, metric_scale};
pub use pairs::PairConfig;
pub use reconstruct::{
    GivenCheck, MatchedBlock, PairBlock, Supplied, check_given, match_block, reconstruct,
    reconstruct_features, reconstruct_from, triangulate_given,
};
pub use result::{FramePose, PoseDeviation, SfmResult, SfmStats, StepTime, Uncertainty};
pub use skip::StepName;
pub use undistort::{Undistorted, undistort};
pub use upright::{VerticalDirection, vertical_direction};
