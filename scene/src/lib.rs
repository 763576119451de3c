//! The types that cross the borders between stages, the geometry they need and the files they are
//! kept in.
//!
//! # Conventions
//! | thing | convention |
//! |---|---|
//! | pose | `cam_from_world`: `x_cam = R x_world + t`; variables are named `target_from_source` |
//! | axes | right-handed; camera x right, y down, z forward (COLMAP, OpenCV) |
//! | world | what is written: y down, object in the origin, its radius 1 ([`WorldFrame`]) |
//! | other worlds | y up in glTF and `.spz`, z up in `transforms.json` |
//! | pixel | (0, 0) is the image corner, the first pixel's centre is (0.5, 0.5) (COLMAP) |
//! | quaternion | Hamilton, unit; w x y z in files, x y z w in glam: converted by `io` only |
//! | units | `_px`, `_s`, radians in code, `_deg` in config and reports, else scene units |
//! | numbers | f64 here and in `sfm`; f32 in splat's production backends |
//! | colour | 8-bit sRGB in files; splats are trained on sRGB values in [0, 1] |
//! | gaussians | scale = exp(log_scale), opacity = sigmoid(logit), rgb = 0.5 + C0 sh0 + … |
//! | masks | white = keep, black = ignore (COLMAP) |

#![warn(clippy::undocumented_unsafe_blocks, unreachable_pub)]

pub mod camera;
pub mod clock;
mod cut;
pub mod decision;
pub mod features;
pub mod flag;
pub mod frames;
pub mod gaussians;
pub mod geometry;
pub mod image;
pub mod io;
pub mod lpips;
pub mod metrics;
pub mod morton;
pub mod motion_report;
pub mod orbit_path;
pub mod overview;
pub mod pose;
mod posed_photo;
pub mod progress;
pub mod reconstruction;
pub mod ring;
pub mod rng;
mod sector;
pub mod sh;
pub mod sim3;
mod simd;
pub mod synthetic;
pub mod up;
pub mod world;

pub use camera::{Camera, CameraModel};
pub use cut::SplatCut;
pub use decision::Decision;
pub use features::{Features, Keypoint, TwoViewGeometry, TwoViewKind};
pub use frames::{Film, Frame, FrameSet, WideLens};
pub use gaussians::Gaussians;
pub use image::FloatImage;
pub use orbit_path::OrbitPath;
pub use overview::Overview;
pub use pose::Pose;
pub use posed_photo::PosedPhoto;
pub use progress::{Cancelled, Preview, Progress};
pub use reconstruction::{Observation, PosedImage, Reconstruction, ScenePoint, TrackElement};
pub use ring::{Arc, Closure, Ring, RingClosure, RingSequence};
pub use sector::{focus, sector};
pub use world::{MetricScale, WorldFrame, WorldUnit};
