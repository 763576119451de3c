//! First motions: from key frames of a video, from free poses, from a constant step between photos.

pub(crate) mod best_start;
pub(crate) mod constant_step;
#[cfg(test)]
mod constant_step_tests;
pub(crate) mod free_poses;
pub(crate) mod key_frames;
pub(crate) mod seed;
pub(crate) mod video_seed;
