//! What the solvers of circular motions are given.

use super::axis::Elevation;
use super::config::MotionConfig;
use super::initialize::key_frames::VideoTracks;
use super::model::CircularContext;
use super::motion::CircularMotion;
use super::prior::AnglePrior;
use super::vertical_lines::{self, Segment};
use crate::config::SfmConfig;
use crate::error::SfmError;
use crate::incremental::state::{MapState, MappingInput};
use crate::knowledge::Knowledge;
use crate::model_selection::camera::FreeIntrinsics;
use crate::skip::StepName;
use scene::{Camera, CameraModel, FrameSet, Progress};

/// The general model, as the general solver left it.
pub(crate) struct FreeModel<'a> {
    /// Poses, points, cameras.
    pub state: &'a MapState,
    /// Its camera model.
    pub intrinsics: FreeIntrinsics,
}

/// Everything the search for a circular motion needs beside the models.
pub(crate) struct MotionInput<'a> {
    pub input: &'a MappingInput<'a>,
    pub cameras: &'a [Camera],
    pub known: &'a [Knowledge],
    pub starts: &'a [Camera],
    pub named: Option<CameraModel>,
    pub config: &'a MotionConfig,
    pub features: &'a [usize],
    /// Images in which the room may be looked at.
    pub room: Option<&'a FrameSet>,
    pub progress: &'a Progress,
}

impl MotionInput<'_> {
    /// The context of adjustments under some priors on the angles.
    pub(crate) fn context<'a>(&'a self, priors: &'a [AnglePrior<'a>]) -> CircularContext<'a> {
        CircularContext {
            input: self.input,
            known: self.known,
            starts: self.starts,
            priors,
            elevation: self.config.known_elevation.map(Elevation::from_measurement),
            features: self.features,
            progress: self.progress,
        }
    }

    /// Lines of the room, where they are asked how the camera looks down.
    pub(crate) fn edges(&self, turn: &CircularMotion) -> Result<Vec<Segment>, SfmError> {
        let asked = !self.known[0].fixed
            && self.config.known_elevation.is_none()
            && !self.input.skips(StepName::VerticalLines);
        match self.room.filter(|_| asked) {
            Some(frames) => vertical_lines::room_edges(frames, turn),
            None => Ok(Vec::new()),
        }
    }
}

/// What a video is solved with.
pub(crate) struct VideoJob<'a> {
    pub frames: &'a FrameSet,
    pub config: &'a SfmConfig,
    pub cameras: &'a [Camera],
    pub camera_of: &'a [usize],
    pub known: &'a [Knowledge],
    pub progress: &'a Progress,
}

impl VideoJob<'_> {
    pub(crate) fn input<'a>(&'a self, material: &'a VideoTracks) -> MappingInput<'a> {
        MappingInput {
            sigmas: &[],
            keypoints: &material.keypoints,
            tracks: &material.tracks,
            camera_of: self.camera_of,
            geometries: &[],
            config: &self.config.mapper,
            is_video: true,
            skip: &self.config.skip,
            seed: self.config.seed,
        }
    }

    /// The context before features are matched: followed points alone.
    pub(crate) fn context<'a>(
        &'a self,
        input: &'a MappingInput<'a>,
        starts: &'a [Camera],
        priors: &'a [AnglePrior<'a>],
    ) -> CircularContext<'a> {
        CircularContext {
            input,
            known: self.known,
            starts,
            priors,
            elevation: None,
            features: &[],
            progress: self.progress,
        }
    }

    /// Presentation times, or the frames' numbers where they are not known.
    pub(crate) fn times(&self) -> Vec<f64> {
        self.frames.times().unwrap_or_else(|| (0..self.frames.len()).map(|i| i as f64).collect())
    }
}
