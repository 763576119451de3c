//! The images a reconstruction starts from.

use crate::decision::Decision;
use crate::io::exif::GpsPosition;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// One input image: upright, on disk.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Frame {
    /// Name in models and reports: a plain file name or a relative path without `..`.
    pub name: String,
    /// Where the upright pixels lie.
    pub path: PathBuf,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// 8-bit mask of the same size, white = keep.
    pub mask: Option<PathBuf>,
    /// Presentation time, seconds from the start of the video.
    pub time_s: Option<f64>,
    /// Index in the source video, or in the sorted folder.
    pub source_index: usize,
    /// Focal length known beforehand (EXIF), pixels.
    pub focal_prior_px: Option<f64>,
    /// Where it was taken, where EXIF says it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gps: Option<GpsPosition>,
    /// The direction that is up, where its metadata say it: x right, y down, z forward, unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub up: Option<[f64; 3]>,
    /// Frames with the same group were taken by one physical camera with one setting.
    pub camera_group: u32,
}

/// A lens whose pictures are cut into perspective views before anything is made of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WideLens {
    /// All directions, equirectangular. The views' camera is known exactly: no distortion, the
    /// principal point in the middle, 90° wide.
    Panorama,
    /// A fisheye: the view's distortion is what the lens differs from an equidistant one by.
    Fisheye,
}

/// The frames in order (time for videos, sorted names for folders).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FrameSet {
    /// The frames.
    pub frames: Vec<Frame>,
    /// Whether the order is the order of time (a video).
    pub is_video: bool,
    /// What was found out or left out on the way, for the report: one sentence each.
    pub notes: Vec<String>,
    /// What was decided about the frames.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub decisions: Vec<Decision>,
    /// Of a video: all its frames, small.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub film: Option<Film>,
    /// The lens whose pictures the frames were cut from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wide_lens: Option<WideLens>,
}

/// Small grey pictures of the frames of a video, chosen or not, as coded (not turned): one below
/// the other in an 8-bit PNG.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Film {
    /// Where it lies.
    pub path: PathBuf,
    /// Width of a picture, pixels.
    pub width: u32,
    /// Height of a picture, pixels.
    pub height: u32,
    /// Presentation times from the start of the video, seconds, rising; one a picture.
    pub times_s: Vec<f64>,
}

impl FrameSet {
    /// Number of frames.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Presentation times of all frames, seconds; `None` where not all have one or they do not
    /// rise.
    pub fn times(&self) -> Option<Vec<f64>> {
        let times: Vec<f64> = self.frames.iter().filter_map(|f| f.time_s).collect();
        let rising = times.windows(2).all(|w| w[1] > w[0]);
        (self.is_video && rising && times.len() == self.len()).then_some(times)
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }
}
