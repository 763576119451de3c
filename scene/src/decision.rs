//! Decisions that a run makes by itself: what was decided, between which alternatives, by which
//! numbers. They are kept as data; `sentences` is the one place that turns them into English.
//!
//! ```
//! use scene::decision::{Choice, Decision, Measurement, MotionModel, Quantity, Rule, Subject};
//!
//! let score = |bic| vec![Measurement::new(Quantity::Bic, bic)];
//! let decision = Decision::new(Subject::Motion, MotionModel::SingleAxis, Rule::Evidence)
//!     .measured(Quantity::Noise, 0.31)
//!     .compared(MotionModel::SingleAxis, true, score(1200.0))
//!     .compared(MotionModel::Free, false, score(1900.0));
//! assert_eq!(decision.motion(), Some(MotionModel::SingleAxis));
//! let words = decision.sentences();
//! assert_eq!((words.title.as_str(), words.choice.as_str()), ("Motion", "single axis"));
//! assert_eq!(words.evidence[0], "noise 0.310 px");
//! ```

mod choice;
mod quantity;
mod sentences;

pub use choice::{
    BackgroundModel, Choice, FeatureSource, LightModel, MapperKind, MatteKind, MotionModel, PrincipalPoint,
    ScaleEvidence, UpEvidence,
};
pub use quantity::{Measurement, Quantity};
pub use sentences::Sentences;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What was decided. The order is the order in which a report lists decisions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Subject {
    /// Whether and how the object is cut out of its background.
    Matte,
    /// Pieces of mattes that are no part of the object.
    MattePieces,
    /// Camera model and free intrinsics.
    CameraModel,
    /// The motion between camera and object.
    Motion,
    /// What training does with the pixels outside the mattes.
    Background,
    /// Degree of the spherical harmonics.
    ShDegree,
    /// Number of Gaussians.
    GaussianCount,
    /// Whether training refines the camera poses.
    TrainingPoses,
    /// Whether training models a gain for each view.
    Exposure,
    /// How the illumination is modelled.
    Illumination,
    /// Where the features come from.
    Features,
    /// Image pairs that passed geometric verification.
    ImagePairs,
    /// Additional features from blurred images.
    BlurredFeatures,
    /// Constant-step circular motion of photos in file order.
    ConstantStepMotion,
    /// Whether mapping starts with all images on a circle.
    CircularStart,
    /// Incremental or global mapping.
    Mapper,
    /// Image pairs set aside because repeated structure makes them look alike.
    RepeatedStructure,
    /// Images placed between their neighbours on a circle.
    CircleCompletion,
    /// Whether groups of images share one camera.
    SharedCameras,
    /// Images rotated by 180° against the others of their camera.
    RotatedImages,
    /// Whether keypoints are refined by registering their windows.
    KeypointRefinement,
    /// Whether tracks on a plane are added.
    PlaneTracks,
    /// The camera model once more, with tracks on a plane.
    CameraModelWithPlane,
    /// The camera model once more, with the motion that was found.
    CameraModelWithMotion,
    /// Single-axis motion from points tracked through a video.
    VideoMotion,
    /// Direction of the rotation axis.
    RotationAxis,
    /// Elevation of the camera above the plane of rotation.
    CameraElevation,
    /// Angular rate of the rotation.
    RotationRate,
    /// Whether the model is right.
    Plausibility,
    /// Which direction is up in the world.
    WorldUp,
    /// How many metres a unit is.
    WorldScale,
    /// Points triangulated for poses that came without any.
    TriangulatedPoints,
    /// The device that trains and renders.
    Backend,
    /// Number of Gaussians that fit into memory.
    GaussianLimit,
    /// Growth that memory ended.
    GrowthLimit,
    /// Pairs of Gaussians and tiles that fit into memory.
    TilePairs,
    /// Removal of Gaussians that hardly contribute.
    RedundantGaussians,
    /// Removal of Gaussians that hardly any view sees.
    UnobservedGaussians,
    /// Removal of Gaussians outside the silhouettes.
    OutsideSilhouettes,
    /// Whether black in the photos counts as nothing.
    BlackSky,
    /// How far refined poses are from those given.
    RefinedPoses,
    /// Gradients that were not finite.
    NonFiniteGradients,
    /// When training ended.
    TrainingTime,
    /// Whether training reduced the loss.
    Convergence,
}

/// Something that could have been chosen, with its scores.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Alternative {
    /// What it is.
    pub choice: Choice,
    /// Whether it was preferred to those before it.
    pub accepted: bool,
    /// How well it does.
    pub scores: Vec<Measurement>,
}

/// What made the choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Rule {
    /// The measurements and scores beside it.
    Evidence,
    /// An option of the user.
    Requested,
    /// It came with the input, or is known beforehand.
    Given,
    /// It stands as configured; this kind of run does not examine it.
    Default,
    /// Too few images or views to decide by.
    TooFewImages,
    /// Too few observations to decide by.
    TooFewObservations,
    /// The observations do not determine it.
    NotDetermined,
    /// Nothing was found that could have been taken.
    NothingFound,
    /// It was there, but the observations contradict it.
    Contradicted,
    /// There is too little memory for more.
    OutOfMemory,
    /// It was tried and failed.
    Failed,
}

/// A fact beside the numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Remark {
    /// Several cameras took the images.
    SeveralCameras,
    /// The general model has no poses that rotate about an axis.
    NoRotation,
    /// The poses are near no circle.
    NoCircle,
    /// No model with a single axis could be built.
    NoSingleAxisModel,
    /// The single-axis model was initialised from three images.
    ThreeImages,
    /// The video has too few frames.
    TooFewFrames,
    /// No tracked point moves enough.
    NoMotion,
    /// Tracked points do not last long enough.
    ShortTracks,
    /// One axis explains too little of the motion.
    WeakExplanation,
    /// No initial motion triangulates points.
    NoTriangulation,
    /// The initial motion could not be extended.
    NoExtension,
    /// Tracks and key frames disagree on the axis.
    TracksDisagree,
    /// The rotation is too short for a loop closure.
    NoLoop,
    /// A loop closure is expected but not observed.
    LoopNotObserved,
    /// The last image is followed by the first.
    ClosedCircle,
    /// The constant-step pairs replace the verified ones.
    Replaced,
    /// The elevation comes from a measurement of the user.
    MeasuredElevation,
    /// The elevation comes from vertical lines in the images.
    VerticalLines,
    /// Elevation and principal point disagree with what is usual: measure it again.
    DoubtfulMeasurement,
    /// The same for vertical lines: the axis may not be vertical.
    DoubtfulLines,
    /// The camera is known, so that the elevation adds nothing.
    KnownCamera,
    /// Most images see no common plane.
    NoPlane,
    /// A plane is seen, but nothing on it can be tracked.
    EmptyPlane,
    /// The tracks on the plane agree with no model.
    PlaneDisagrees,
    /// No graphics card was found.
    NoGraphicsCard,
    /// The first graphics card was taken.
    FirstGraphicsCard,
    /// Growth stopped because validation no longer improved.
    GrowthStopped,
    /// Validation was still improving at the end.
    StillImproving,
    /// The gains were found by an earlier look and checked again.
    GainsConfirmed,
    /// Hardly any view has them in its image, so that nothing constrains them.
    Unobserved,
    /// The photos have no mattes and their rims are black.
    BlackRims,
    /// More views show background there than a silhouette allows.
    OutsideHull,
    /// Most other masks show background where they would have to be.
    OtherMasksDisagree,
    /// The Gaussians kept their values in that step.
    StepSkipped,
    /// More steps would overfit the photos.
    Overfitting,
    /// Poses or masks may be wrong, or the learning rate too large.
    CheckInput,
    /// Only the nearest pairs are drawn.
    NearestOnly,
    /// The hue is one of wood, skin and lamp light.
    NaturalHue,
    /// Light does not tell the object from the room.
    NotKeyableByLight,
    /// The pixels have no distinct hue.
    NoHue,
    /// Nothing stands before the screen in most frames.
    EmptyFrames,
    /// The mattes' background is replaced by random colours in training.
    RandomBackground,
    /// The object turned before fixed lamps: views off the filmed circle are extrapolated.
    LampMovesWithCamera,
    /// The database holds no matches, or they were not wanted: features are matched anew.
    MatchedAnew,
    /// Validation views are needed to examine it, and none was set aside.
    NoValidation,
    /// The model is not probable enough to be believed as it is.
    Doubtful,
    /// Focal length or lens distortion are unlike those of real cameras.
    UnusualCamera,
    /// Some images have many matches that the model does not explain.
    UnexplainedMatches,
    /// Points are seen at too small an angle.
    NarrowViews,
    /// Observations that were held out disagree.
    HeldOutDisagree,
    /// A second solution has other rotations.
    SolutionsDisagree,
    /// No points tie two parts of the images to each other.
    PartsNotTied,
    /// Poses that came with the input fit the photos badly.
    PosesOff,
}

/// A decision with all that led to it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Decision {
    /// What was decided.
    pub subject: Subject,
    /// What was chosen.
    pub choice: Choice,
    /// What made the choice.
    pub rule: Rule,
    /// Facts beside the numbers.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<Remark>,
    /// Numbers that hold for all alternatives.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub measurements: Vec<Measurement>,
    /// What was compared, in the order in which it was tried.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub alternatives: Vec<Alternative>,
    /// A name or an error message, quoted as it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub message: Option<String>,
}

impl Decision {
    /// A decision without numbers yet.
    pub fn new(subject: Subject, choice: impl Into<Choice>, rule: Rule) -> Self {
        let (remarks, measurements, alternatives) = (Vec::new(), Vec::new(), Vec::new());
        Self { subject, choice: choice.into(), rule, remarks, measurements, alternatives, message: None }
    }

    /// Adds a number.
    #[must_use]
    pub fn measured(self, quantity: Quantity, value: f64) -> Self {
        self.with(Measurement::new(quantity, value))
    }

    /// Adds a number with its standard deviation.
    #[must_use]
    pub fn estimated(self, quantity: Quantity, value: f64, deviation: f64) -> Self {
        self.with(Measurement::estimate(quantity, value, deviation))
    }

    /// Adds a measurement.
    #[must_use]
    pub fn with(mut self, measurement: Measurement) -> Self {
        self.measurements.push(measurement);
        self
    }

    /// Adds measurements.
    #[must_use]
    pub fn with_all(mut self, measurements: impl IntoIterator<Item = Measurement>) -> Self {
        self.measurements.extend(measurements);
        self
    }

    /// Adds a fact.
    #[must_use]
    pub fn remarked(mut self, remark: Remark) -> Self {
        self.remarks.push(remark);
        self
    }

    /// Adds an alternative with its scores; `accepted`: whether it was preferred to those before
    /// it.
    #[must_use]
    pub fn compared(mut self, choice: impl Into<Choice>, accepted: bool, scores: Vec<Measurement>) -> Self {
        self.alternatives.push(Alternative { choice: choice.into(), accepted, scores });
        self
    }

    /// Adds alternatives.
    #[must_use]
    pub fn compared_all(mut self, alternatives: impl IntoIterator<Item = Alternative>) -> Self {
        self.alternatives.extend(alternatives);
        self
    }

    /// Takes over the facts, numbers and alternatives of another decision.
    #[must_use]
    pub fn absorbing(mut self, other: Self) -> Self {
        self.remarks.extend(other.remarks);
        self.measurements.extend(other.measurements);
        self.alternatives.extend(other.alternatives);
        self.message = self.message.or(other.message);
        self
    }

    /// Adds a name or an error message that is quoted as it is.
    #[must_use]
    pub fn quoting(mut self, message: impl Into<String>) -> Self {
        self.message = Some(message.into());
        self
    }

    /// The motion model, where that was decided.
    pub fn motion(&self) -> Option<MotionModel> {
        match (self.subject, &self.choice) {
            (Subject::Motion, Choice::Motion(motion)) => Some(*motion),
            _ => None,
        }
    }

    /// Whether what the subject names is done; `false` where that is no question of yes or no.
    pub fn is_taken(&self) -> bool {
        self.choice == Choice::Taken(true)
    }

    /// Whether it says that the model is to be doubted.
    pub fn is_doubt(&self) -> bool {
        self.subject == Subject::Plausibility && self.remarks.contains(&Remark::Doubtful)
    }

    /// The number of a quantity among the measurements.
    pub fn value(&self, quantity: Quantity) -> Option<f64> {
        self.measurements.iter().find(|m| m.quantity == quantity).map(|m| m.value)
    }
}
