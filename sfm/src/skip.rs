//! What a user can leave out of a reconstruction: whole steps, and parts of steps.

use serde::{Deserialize, Serialize};

/// A step, or a part of one, that `--skip` leaves out.
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StepName {
    /// Features of blurred copies, where most images share few matches
    BlurredFeatures,
    /// Pairs matched along the one motion of a ring of photos that goes round in even steps
    ConstantStep,
    /// More matches along the epipolar lines of verified pairs
    GuidedMatching,
    /// Part of the mapping: poses from verified pairs for images that see too few points
    StructurelessResection,
    /// A model without the pairs that repeated structure made
    Aliasing,
    /// Another attempt at pairs that did not pass, where few images leave some without a pose
    SecondAttempt,
    /// Places on the circle for images that a ring of cameras misses
    CircleCompletion,
    /// One camera for several groups of images
    SharedCameras,
    /// Part of the camera model: whether images were rotated by 180°
    RotatedImages,
    /// More matches along the model's own epipolar lines, of few images
    Densify,
    /// Keypoints moved to where their windows fit together
    Subpixel,
    /// Observations of a plane below the object
    PlaneTracks,
    /// Removal of points that two images see and that stand alone in depth
    IsolatedPoints,
    /// Part of the turn of a video: closing it by photometric similarity
    PhotometricClosure,
    /// Part of circular motion: the elevation of the camera from vertical lines of the room
    VerticalLines,
}

/// Help of `--skip`; names all steps in their order.
pub(crate) const HELP: &str = "\
Steps that are left out, separated by commas; what the evidence would have decided there stays as it was. \
The steps in their order: video-turn, features, matching, verification, blurred-features, constant-step, \
guided-matching, mapping, aliasing, second-attempt, circle-completion, shared-cameras, camera-model, \
final-adjustment, densify, subpixel, plane-tracks, isolated-points, motion, covariance, plausibility, points, all-frames, colours";
