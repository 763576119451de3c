use crate::PreprocessError;
use scene::WideLens;
use scene::flag::between;
use serde::{Deserialize, Serialize};

/// Frames aimed at where no rate is given. Source: chosen by hand, never measured.
pub const DEFAULT_FRAMES: usize = 100;
const DEFAULT_MASKS: &str = "auto";

/// With which lens the pictures were taken.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LensChoice {
    /// A panorama where the file says so, else an ordinary lens
    #[default]
    Auto,
    /// An ordinary lens
    Perspective,
    /// A fisheye: one view of up to 100° is cut from each picture
    Fisheye,
    /// Equirectangular panoramas: eight views of 90° round the horizon are cut from each
    Panorama,
}

impl LensChoice {
    /// The wide lens that is meant. `is_panorama`: whether the files say that they are panoramas.
    pub(crate) fn wide(self, is_panorama: impl FnOnce() -> bool) -> Option<WideLens> {
        match self {
            Self::Auto => is_panorama().then_some(WideLens::Panorama),
            Self::Perspective => None,
            Self::Fisheye => Some(WideLens::Fisheye),
            Self::Panorama => Some(WideLens::Panorama),
        }
    }
}

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
    /// With which lens the pictures were taken: of a fisheye one view of up to 100° is cut from
    /// each, of panoramas (equirectangular; `auto`: where the files say so) eight of 90°.
    #[arg(long, value_enum, default_value_t = LensChoice::Auto, hide_possible_values = true, value_name = "auto|perspective|fisheye|panorama", help_heading = "Frames")]
    pub lens: LensChoice,
    /// Degrees that a fisheye covers across its circle, where that lies inside the picture, or else
    /// across the diagonal (by EXIF where it is not said, or 180).
    #[arg(long, value_parser = between::<f64>(30.0, 300.0), value_name = "DEGREES", help_heading = "Frames")]
    pub fisheye_field: Option<f64>,
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
            lens: LensChoice::Auto,
            fisheye_field: None,
            // Chosen by hand, never measured.
            duplicate_levels: 2.0,
            masks: DEFAULT_MASKS.to_owned(),
            invert_masks: false,
        }
    }
}

impl FrameConfig {
    /// How pictures are taken that a wide lens' views are cut from: whole, and of panoramas, which
    /// show more each, fewer.
    pub(crate) fn before_cutting(&self, lens: Option<WideLens>) -> Self {
        let Some(lens) = lens else { return self.clone() };
        let says = self.frames.is_some() || self.fps.is_some() || self.every.is_some();
        let fewer = lens == WideLens::Panorama && !says;
        let frames = if fewer { Some(DEFAULT_FRAMES / 4) } else { self.frames };
        Self { max_size: 0, frames, ..self.clone() }
    }

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
        if self.fisheye_field.is_some() && self.lens != LensChoice::Fisheye {
            return Err(PreprocessError::Config(
                "--fisheye-field is said of a fisheye: add --lens fisheye".to_owned(),
            ));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_is_asked_only_where_the_user_does_not_say() {
        assert_eq!(LensChoice::Auto.wide(|| true), Some(WideLens::Panorama));
        assert_eq!(LensChoice::Auto.wide(|| false), None);
        assert_eq!(LensChoice::Perspective.wide(|| true), None);
        assert_eq!(LensChoice::Fisheye.wide(|| true), Some(WideLens::Fisheye));
    }
}
