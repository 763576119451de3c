//! What goes through the steps: the one model of a reconstruction, from its features to its
//! covariances.

use super::context::StepContext;
use super::setup::Setup;
use crate::bundle::ExpectedPoses;
use crate::circular::initialize::constant_step::{ConstantStepMotion, hold_on_ring};
use crate::circular::{CircularSolution, MotionInput};
use crate::config::SfmConfig;
use crate::error::SfmError;
use crate::incremental::finish::{FinalAdjustment, converge};
use crate::incremental::state::{MapState, MappingInput};
use crate::matching::PairMatches;
use crate::model_selection::camera::{self, FreeIntrinsics};
use crate::result::{FramePose, PoseDeviation, SfmResult, SfmStats, Uncertainty};
use crate::tracks::Tracks;
use glam::DVec2;
use scene::motion_report::MotionReport;
use scene::{Camera, Decision, Features, FrameSet, Reconstruction, TwoViewGeometry};

/// How far a model has come; says which steps it takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum ModelStage {
    /// No image has a pose.
    #[default]
    Unposed,
    /// Images have poses, free of each other.
    Posed,
    /// All images have one angle each about one axis; nothing is solved for any more.
    OneAxis,
}

/// What a step hands on: the model, and what the evidence decided.
pub(crate) type StepResult = Result<(SfmModel, Vec<Decision>), SfmError>;

/// A constant-step circular motion, and the pairs matched along it.
pub(crate) struct ConstantStepStart {
    pub motion: ConstantStepMotion,
    pub geometries: Vec<TwoViewGeometry>,
    /// Whether these pairs are to take the others' place.
    pub instead: bool,
    pub decision: Decision,
}

/// Poses and points with the tracks and pairs that they come from.
pub(crate) struct MappedModel {
    pub state: MapState,
    pub tracks: Tracks,
    pub geometries: Vec<TwoViewGeometry>,
    /// It began with all images in their places on a ring, and is held by that.
    pub on_ring: bool,
    /// How it was made, where there was a choice.
    pub decision: Option<Decision>,
}

/// The model of a reconstruction. Vectors have one entry an image unless said otherwise.
#[derive(Default)]
pub(crate) struct SfmModel {
    pub stage: ModelStage,
    /// Cameras as they are known beforehand, and which image was taken with which.
    pub setup: Setup,
    pub features: Vec<Features>,
    /// Matches before verification, a pair of images each; `None` until they are known.
    pub matches: Option<Vec<PairMatches>>,
    /// The same of weakly tied images with the features of blurred copies, where those are used.
    pub blurred_matches: Option<Vec<PairMatches>>,
    /// Images that share few matches with any other.
    pub weakly_tied: Vec<bool>,
    /// That and why the search for one axis along a video found none.
    pub no_video_motion: Option<Decision>,
    pub constant_step: Option<ConstantStepStart>,
    /// Verified pairs, as the solver sees the images.
    pub geometries: Vec<TwoViewGeometry>,
    /// Verified pairs of the images as they are, where `geometries` are others by now.
    pub verified: Option<Vec<TwoViewGeometry>>,
    /// Positions of keypoints as the solver sees the images, pixels.
    pub keypoints: Vec<Vec<DVec2>>,
    /// Standard deviations of keypoints relative to each other's.
    pub sigmas: Vec<Vec<f32>>,
    pub tracks: Tracks,
    /// Poses and points; of no image before the mapping.
    pub state: MapState,
    /// The images were placed on a ring, and poses are held near it.
    pub on_ring: bool,
    /// Intrinsics that priors refer to, one a camera.
    pub starts: Vec<Camera>,
    /// What is solved for of the cameras.
    pub intrinsics: FreeIntrinsics,
    /// What the motion says of the poses, by image.
    pub expected: Option<ExpectedPoses>,
    /// What the motion says the poses are known to, by image.
    pub deviations: Option<Vec<PoseDeviation>>,
    /// What was found about the cameras of free poses.
    pub camera_decisions: Vec<Decision>,
    /// Images that the solver sees rotated by 180°.
    pub rotated: Vec<bool>,
    pub uncertainty: Option<Uncertainty>,
    /// How the object moves, where that is more than free poses.
    pub motion: Option<MotionReport>,
    /// Of a video: poses of all its frames.
    pub frames: Vec<FramePose>,
    pub stats: SfmStats,
    pub reconstruction: Option<Reconstruction>,
    /// Images without a pose: name, and why.
    pub missing: Vec<(String, String)>,
    /// Weakly constrained images: name, and why.
    pub weak_images: Vec<(String, String)>,
}

impl SfmModel {
    /// Nothing but what is known before the images are looked at.
    pub(crate) fn new(frames: &FrameSet, config: &SfmConfig) -> Result<Self, SfmError> {
        let setup = Setup::new(frames, config)?;
        Ok(Self {
            starts: setup.cameras.clone(),
            setup,
            weakly_tied: vec![false; frames.len()],
            intrinsics: camera::before_the_choice(config.camera_model.model()),
            rotated: vec![false; frames.len()],
            stats: SfmStats { images: frames.len(), ..SfmStats::default() },
            ..Self::default()
        })
    }

    /// What mappers and adjustments see of it.
    pub(crate) fn input<'a>(&'a self, context: &'a StepContext<'_>) -> MappingInput<'a> {
        self.input_from(&self.tracks, &self.geometries, context)
    }

    /// The same with other pairs.
    pub(crate) fn input_from<'a>(
        &'a self,
        tracks: &'a Tracks,
        geometries: &'a [TwoViewGeometry],
        context: &'a StepContext<'_>,
    ) -> MappingInput<'a> {
        MappingInput {
            keypoints: &self.keypoints,
            sigmas: &self.sigmas,
            tracks,
            camera_of: &self.setup.camera_of,
            geometries,
            config: &context.config.mapper,
            is_video: context.frames.is_video,
            skip: &context.config.skip,
            seed: context.config.seed,
        }
    }

    /// What the search for circular motion sees beside `input`.
    pub(crate) fn motion_input<'a>(
        &'a self,
        input: &'a MappingInput<'a>,
        context: &'a StepContext<'_>,
    ) -> MotionInput<'a> {
        MotionInput {
            input,
            cameras: &self.setup.cameras,
            known: &self.setup.known,
            starts: &self.starts,
            named: context.config.camera_model.model(),
            config: &context.config.motion,
            features: &[],
            room: context.images(),
            progress: context.progress,
        }
    }

    /// Takes over what a mapper made.
    pub(crate) fn adopt(&mut self, mapped: MappedModel) -> Option<Decision> {
        self.stage = ModelStage::Posed;
        self.state = mapped.state;
        self.tracks = mapped.tracks;
        self.geometries = mapped.geometries;
        self.on_ring = mapped.on_ring;
        mapped.decision
    }

    /// Takes over a model about one axis.
    pub(crate) fn adopt_turn(&mut self, solution: CircularSolution) -> Vec<Decision> {
        self.stage = ModelStage::OneAxis;
        self.state = solution.state;
        self.uncertainty = solution.uncertainty;
        self.motion = solution.motion;
        self.frames = solution.frames;
        solution.decisions
    }

    /// Poses and points adjusted with `intrinsics` until little changes; near the ring, where
    /// images were placed on one.
    pub(crate) fn settle(
        &self,
        mut state: MapState,
        input: &MappingInput<'_>,
        intrinsics: FreeIntrinsics,
        context: &StepContext<'_>,
    ) -> Result<MapState, SfmError> {
        if self.on_ring {
            return hold_on_ring(&state, &self.motion_input(input, context), intrinsics);
        }
        converge(&mut state, input, &self.final_adjustment(intrinsics), context.progress)?;
        Ok(state)
    }

    /// What the last adjustments hold on to.
    pub(crate) fn final_adjustment(&self, intrinsics: FreeIntrinsics) -> FinalAdjustment<'_> {
        FinalAdjustment {
            known: &self.setup.known,
            starts: &self.starts,
            intrinsics,
            expected: self.expected.as_ref(),
        }
    }

    /// Keeps the verified pairs of the images as they are, before the solver's become others.
    pub(crate) fn keep_verified(&mut self) {
        self.verified.get_or_insert_with(|| self.geometries.clone());
    }

    /// What is handed back. `initial_cameras`: one a frame.
    pub(crate) fn into_result(
        self,
        initial_cameras: Vec<Camera>,
        reason: String,
        decisions: Vec<Decision>,
    ) -> SfmResult {
        SfmResult {
            reconstruction: self.reconstruction,
            reason,
            missing: self.missing,
            weak_images: self.weak_images,
            decisions,
            uncertainty: self.uncertainty,
            motion: self.motion,
            frames: self.frames,
            stats: self.stats,
            initial_cameras,
            features: self.features,
            matches: self.matches.unwrap_or_default(),
            geometries: self.verified.unwrap_or(self.geometries),
        }
    }
}
