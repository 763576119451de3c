use crate::PreprocessError;
use scene::flag::between;
use serde::{Deserialize, Serialize};

/// Frames aimed at where no rate is given. Source: chosen by hand, never measured.
pub const DEFAULT_FRAMES: usize = 100;
const DEFAULT_MASKS: &str = "auto";

/// Which frames of a video, or photos of a folder, become the images of the reconstruction.
#[derive(clap::Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FrameConfig {
    /// Number of frames to take from a video, evenly in time (100 where none of --frames, --fps,
    /// --every is given).
    #[arg(long, value_parser = between::<usize>(0, 100_000_000), value_name = "N", conflicts_with_all = ["fps", "every"], help_heading = "Frames")]
    pub frames: Option<usize>,
    /// Frames to take a second of video.
    #[arg(long, value_parser = between::<f64>(0.0, 1e6), value_name = "F", conflicts_with = "every", help_heading = "Frames")]
    pub fps: Option<f64>,
    /// Take one frame of every K.
    #[arg(long, value_parser = between::<usize>(0, 1_000_000_000), value_name = "K", help_heading = "Frames")]
    pub every: Option<usize>,
    /// Ignore what lies before this time, seconds.
    #[arg(long, value_parser = between::<f64>(-1e9, 1e9), value_name = "SECONDS", help_heading = "Frames")]
    pub start: Option<f64>,
    /// Ignore what lies after this time, seconds.
    #[arg(long, value_parser = between::<f64>(-1e9, 1e9), value_name = "SECONDS", help_heading = "Frames")]
    pub end: Option<f64>,
    /// Longest side of the images, pixels; larger ones are averaged down (0: leave them as they
    /// are).
    #[arg(long, value_parser = between::<u32>(0, 65_535), value_name = "PIXELS", default_value_t = 0, help_heading = "Frames")]
    pub max_size: u32,
    /// A frame that differs from the one before by less than this (in 199 of 200 pixels, 8-bit
    /// levels) is a duplicate and left out; 0 keeps all.
    #[arg(long, value_parser = between::<f32>(0.0, 256.0), value_name = "LEVELS", default_value_t = Self::default().duplicate_levels, help_heading = "Frames")]
    pub duplicate_levels: f32,
    /// Folder of masks for photos, white = keep; `auto` looks for `masks` in and beside the folder,
    /// `off` for none.
    #[arg(long, value_name = "auto|off|FOLDER", default_value = DEFAULT_MASKS, help_heading = "Frames")]
    pub masks: String,
    /// The masks are black where the object is.
    #[arg(long, help_heading = "Frames")]
    pub invert_masks: bool,
}

impl Default for FrameConfig {
    fn default() -> Self {
        Self {
            frames: None,
            fps: None,
            every: None,
            start: None,
            end: None,
            max_size: 0,
            // Chosen by hand, never measured.
            duplicate_levels: 2.0,
            masks: DEFAULT_MASKS.to_owned(),
            invert_masks: false,
        }
    }
}

impl FrameConfig {
    /// Refuses what cannot be meant.
    pub fn validate(&self) -> Result<(), PreprocessError> {
        if self.frames == Some(0) {
            return Err(PreprocessError::Config("--frames 0 takes no frame; give at least 2".to_owned()));
        }
        if self.every == Some(0) {
            return Err(PreprocessError::Config(
                "--every 0 means nothing; --every 1 takes all frames".to_owned(),
            ));
        }
        if let Some(fps) = self.fps
            && !(fps.is_finite() && fps > 0.0)
        {
            return Err(PreprocessError::Config(format!("--fps {fps} is not a positive number")));
        }
        for (name, value) in [("--start", self.start), ("--end", self.end)] {
            if let Some(v) = value
                && !v.is_finite()
            {
                return Err(PreprocessError::Config(format!("{name} {v} is not a time")));
            }
        }
        if self.max_size != 0 && self.max_size < 16 {
            return Err(PreprocessError::Config(format!(
                "--max-size {} is too small; give at least 16",
                self.max_size
            )));
        }
        if !(self.duplicate_levels.is_finite() && self.duplicate_levels >= 0.0) {
            return Err(PreprocessError::Config(format!(
                "--duplicate-levels {} is not 0 or more",
                self.duplicate_levels
            )));
        }
        Ok(())
    }
}
