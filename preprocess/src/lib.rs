//! From a video or a folder of photos to upright frames with masks: the first stage.
//!
//! Video is decoded with OpenCV, its traps (display rotation, time stamps, silent damage, HDR, the colour
//! matrix) solved with the help of `ffprobe` and `ffmpeg`.

mod config;
mod decode;
mod error;
mod hdr;
mod output;
mod pixels;
mod probe;
mod select;
mod tool;
mod video;

pub use config::{FrameConfig, DEFAULT_FRAMES};
pub use error::PreprocessError;
pub use tool::versions;
pub use video::video_frames;
