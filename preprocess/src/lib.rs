//! From a video or a folder of photos to upright frames with masks: the first stage.
//!
//! Video is decoded by `ffmpeg`; display rotation, time stamps and colour come from `ffprobe`.

#![warn(clippy::undocumented_unsafe_blocks, unreachable_pub)]

mod area;
mod config;
mod decode;
mod error;
mod film;
mod hdr;
mod masks;
mod matte;
pub mod matting;
mod memory;
mod names;
mod output;
mod photo_file;
mod photos;
mod pixels;
mod probe;
mod select;
mod tool;
mod video;
mod wide;

pub use config::{DEFAULT_FRAMES, FrameConfig, LensChoice};
pub use error::PreprocessError;
pub use matte::{contact_sheet, matte_frames};
pub use matting::KeyConfig;
pub use photos::{PHOTO_EXTENSIONS, listed_photo_frames, photo_frames};
pub use tool::versions;
pub use video::video_frames;
