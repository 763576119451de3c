//! What a model is made of, and one that has grown from it.

use super::setup::Setup;
use super::steps::constant_step::ConstantStepStart;
use crate::incremental::state::{MapState, MappingInput};
use crate::tracks::{Tracks, build_tracks};
use crate::{SfmConfig, SfmError, circular, mapper};
use scene::{Camera, Decision, Features, FrameSet, Progress, TwoViewGeometry};

/// Power of a keypoint's scale with which its standard deviation grows.
const SIGMA_BY_SCALE: f32 = 1.0;

/// Standard deviations of an image's keypoints, 1 for the finest: blurred structure is found less exactly (Zeisl et al.,
/// "Estimation of Location Uncertainty for Scale Invariant Feature Points", BMVC 2009).
pub(crate) fn keypoint_sigmas(features: &Features) -> Vec<f32> {
    features.keypoints.iter().map(|k| k.scale.max(1.0).powf(SIGMA_BY_SCALE)).collect()
}

/// What is known before the first pose.
pub(crate) struct StepContext<'a> {
    /// The images, where more may be taken from them than the features.
    pub images: Option<&'a FrameSet>,
    pub config: &'a SfmConfig,
    pub setup: &'a Setup,
    pub is_video: bool,
    pub features: &'a [Features],
    pub sigmas: Vec<Vec<f32>>,
    /// The motion from each image to the next, where they go round evenly.
    pub start: Option<ConstantStepStart>,
}

impl<'a> StepContext<'a> {
    /// The same with other cameras, for a model that has grown.
    pub fn with_setup<'b>(&self, setup: &'b Setup) -> StepContext<'b>
    where
        'a: 'b,
    {
        StepContext { setup, sigmas: self.sigmas.clone(), start: None, ..*self }
    }

    pub fn input(
        &'a self,
        keypoints: &'a [Vec<glam::DVec2>],
        tracks: &'a Tracks,
        geometries: &'a [TwoViewGeometry],
    ) -> MappingInput<'a> {
        MappingInput {
            keypoints,
            sigmas: &self.sigmas,
            tracks,
            camera_of: &self.setup.camera_of,
            geometries,
            config: &self.config.mapper,
            may_be_rotated: !self.is_video,
            seed: self.config.seed,
        }
    }

    pub fn motion_input<'b>(
        &'b self,
        input: &'b MappingInput<'b>,
        starts: &'b [Camera],
        progress: &'b Progress,
    ) -> circular::MotionInput<'b> {
        circular::MotionInput {
            input,
            cameras: &self.setup.cameras,
            known: &self.setup.known,
            starts,
            named: self.config.camera_model.model(),
            config: &self.config.motion,
            features: &[],
            room: self.images,
            progress,
        }
    }
}

/// A model that has grown, with what it has grown from and which mapper made it, where there was a choice.
pub(crate) struct MappedModel {
    pub state: MapState,
    pub tracks: Tracks,
    pub mapper: Option<Decision>,
    /// It began with all images in their places on a ring, and is held by that.
    pub ringed: bool,
}

pub(crate) fn grow_model(
    given: &StepContext<'_>,
    keypoints: &[Vec<glam::DVec2>],
    geometries: &[TwoViewGeometry],
    progress: &Progress,
) -> Result<Option<MappedModel>, SfmError> {
    let tracks = build_tracks(given.features, geometries);
    let (cameras, known) = (&given.setup.cameras, &given.setup.known);
    let (state, mapper) =
        mapper::map(&given.input(keypoints, &tracks, geometries), cameras, known, progress)?;
    Ok(state.map(|state| MappedModel { state, tracks, mapper, ringed: false }))
}
