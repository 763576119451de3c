//! Circular motion: an object that turns about one axis before a camera that stands still, or a
//! camera that goes round on a circle.
//!
//! Frame i sees the point X of the turntable at `x_i = D_i (R Z(θ_i) X + t)`: one axis (R, t), one
//! angle θ a frame, shared intrinsics and points, and small motions D of standard deviation σ. A
//! single axis has σ = 0, an orbit a small σ, free poses an infinite one.
//!
//! | file | what it does |
//! |---|---|
//! | `motion`, `problem`, `prior` | the motion, its adjustment, what is known of the angles |
//! | `initialize` | first motions: of key frames, of free poses, of a constant step |
//! | `model`, `register` | a growing model, frame by frame |
//! | `loop_closure` | where a whole turn comes round again |
//! | `angle_process` | how steadily an object turns, a Gaussian process |
//! | `intrinsics`, `vertical_lines`, `axis` | principal point and elevation of the camera |
//! | `evidence`, `choose` | single axis, orbit or free |
//! | `video`, `photos`, `ring`, `orbit` | videos, unordered photos, photos in order, orbits |
//!
//! Fitzgibbon, Cross & Zisserman, "Automatic 3D model construction for turn-table sequences"
//! (SMILE 1998).

mod angle_process;
mod axis;
mod axis_report;
#[cfg(test)]
mod axis_tests;
mod choose;
mod config;
mod deviations;
pub(crate) mod evidence;
#[cfg(test)]
mod extreme_tests;
pub(crate) mod initialize;
mod intrinsics;
mod job;
mod learnt_motion;
pub(crate) mod limits;
mod loop_closure;
mod model;
pub(crate) mod motion;
mod motion_report;
#[cfg(test)]
mod motion_tests;
mod orbit;
mod photos;
mod prior;
pub(crate) mod problem;
mod register;
pub(crate) mod ring;
mod solution;
#[cfg(test)]
mod tests;
pub(crate) mod vertical_lines;
mod video;

pub(crate) use choose::consider;
pub use config::{Motion, MotionConfig};
pub(crate) use job::{FreeModel, MotionInput, VideoJob};
pub(crate) use solution::CircularSolution;
pub(crate) use video::solve_video;
