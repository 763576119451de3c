//! Numbers that decisions rest on, each with its name and unit.

use Unit::{Of, Percent, Plain, Signed};

use crate::Camera;
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// How a number is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Unit {
    /// No unit, so many digits.
    Plain(usize),
    /// Signed, so many digits.
    Signed(usize),
    /// Shares are written as percentages, so many digits.
    Percent(usize),
    /// A unit behind the number, so many digits.
    Of(&'static str, usize),
}

/// Declares the quantities, each with the name by which sentences call it and the way its numbers
/// are written.
macro_rules! quantities {
    ($($(#[doc = $doc:literal])+ $variant:ident = ($name:literal, $unit:expr),)+) => {
        /// What a number measures. The comment tells the unit of its value.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
        #[serde(rename_all = "kebab-case")]
        pub enum Quantity {
            $($(#[doc = $doc])+ $variant,)+
        }

        impl Quantity {
            /// The name of the quantity, and how its numbers are written.
            pub(super) fn words(self) -> (&'static str, Unit) {
                match self {
                    $(Self::$variant => ($name, $unit),)+
                }
            }
        }
    };
}

quantities! {
    /// Bayesian information criterion; less is better.
    Bic = ("BIC", Plain(0)),
    /// By how much BIC is lower than that of what it is compared with.
    BicMargin = ("BIC margin", Signed(0)),
    /// Root mean square error of observations that were held out, pixels.
    HeldOutError = ("held-out error", Of("px", 3)),
    /// Decrease of the held-out squared error an observation, in variances of the noise.
    HeldOutGain = ("held-out gain", Signed(4)),
    /// Robust standard deviation of a residual coordinate, pixels.
    Noise = ("noise", Of("px", 3)),
    /// Parameters of a motion model.
    MotionParameters = ("motion parameters", Plain(0)),
    /// Logarithm of the odds (natural).
    LogOdds = ("log odds", Signed(1)),
    /// Probability, 0 to 1.
    Probability = ("probability", Plain(2)),
    /// Factor on variances for residuals that are not independent.
    VarianceFactor = ("variance factor for dependent residuals", Plain(1)),
    /// Images.
    Images = ("images", Plain(0)),
    /// Images with a pose.
    RegisteredImages = ("registered images", Plain(0)),
    /// Cameras.
    Cameras = ("cameras", Plain(0)),
    /// Observations.
    Observations = ("observations", Plain(0)),
    /// Observations that were moved.
    MovedObservations = ("observations moved", Plain(0)),
    /// Observations kept, 0 to 1.
    KeptObservations = ("observations kept", Percent(0)),
    /// Observations before a change.
    ObservationsBefore = ("other observations before", Plain(0)),
    /// Observations after it.
    ObservationsAfter = ("other observations after", Plain(0)),
    /// Median reprojection error before a change, pixels.
    MedianErrorBefore = ("median error before", Of("px", 3)),
    /// Median reprojection error after it, pixels.
    MedianErrorAfter = ("median error after", Of("px", 3)),
    /// Features.
    FeatureCount = ("features", Plain(0)),
    /// Image pairs.
    Pairs = ("image pairs", Plain(0)),
    /// Image pairs that could have been matched.
    PossiblePairs = ("possible pairs", Plain(0)),
    /// Matches.
    Matches = ("matches", Plain(0)),
    /// Matches before a change.
    MatchesBefore = ("matches before", Plain(0)),
    /// Matches after it.
    MatchesAfter = ("matches after", Plain(0)),
    /// Matches of verified pairs that agree with a model.
    AgreeingMatches = ("agreeing matches", Plain(0)),
    /// Neighbours' matches that agree, 0 to 1.
    AgreeingShare = ("agreeing matches of neighbours", Percent(0)),
    /// Wrong matches that would agree by chance, 0 to 1.
    ChanceShare = ("expected by chance", Percent(0)),
    /// Blur of the second set of features, pixels.
    Blur = ("blur", Of("px", 1)),
    /// Focal length, pixels.
    FocalLength = ("f", Of("px", 1)),
    /// Horizontal focal length, pixels.
    FocalLengthX = ("fx", Of("px", 1)),
    /// Vertical focal length, pixels.
    FocalLengthY = ("fy", Of("px", 1)),
    /// Principal point, pixels from the left.
    PrincipalPointX = ("cx", Of("px", 2)),
    /// Principal point, pixels from the top.
    PrincipalPointY = ("cy", Of("px", 2)),
    /// First term of radial distortion.
    RadialDistortion1 = ("k1", Plain(4)),
    /// Second term of radial distortion.
    RadialDistortion2 = ("k2", Plain(4)),
    /// First term of tangential distortion.
    TangentialDistortion1 = ("p1", Plain(5)),
    /// Second term of tangential distortion.
    TangentialDistortion2 = ("p2", Plain(5)),
    /// Standard deviation as a share of that of the prior, 0 to 1.
    ShareOfPrior = ("standard deviation relative to the prior", Percent(1)),
    /// Distance of the principal point from the image centre, pixels.
    PrincipalPointOffset = ("principal point off the image centre by", Of("px", 1)),
    /// The largest distance that is usual, pixels.
    UsualOffset = ("usual offset at most", Of("px", 0)),
    /// Angle between the rotation axes of free poses, degrees.
    AxisMisalignment = ("axes of the free rotations differ by", Of("°", 2)),
    /// Distance of free camera centres from a circle, share of its radius.
    CircleMisfit = ("free camera centres off a circle by (share of its radius)", Percent(2)),
    /// Rotations of an orbit about its circle, degrees.
    OrbitRotation = ("deviations in rotation", Of("°", 3)),
    /// Translations of an orbit about its circle, share of the radius.
    OrbitTranslation = ("deviations in translation (share of the radius)", Percent(3)),
    /// Residual of a single-axis model, pixels.
    SingleAxisResidual = ("residual with one axis", Of("px", 2)),
    /// Residual of free poses, pixels.
    FreeResidual = ("residual with free poses", Of("px", 2)),
    /// Points tracked through the video.
    TrackedPoints = ("tracked points", Plain(0)),
    /// Tracked points that do not move.
    StationaryPoints = ("stationary points", Plain(0)),
    /// Motion that one axis explains, 0 to 1.
    ExplainedMotion = ("motion explained by one axis", Percent(0)),
    /// Angle of the whole rotation, degrees.
    RotationRange = ("rotation in total", Of("°", 1)),
    /// Points tracked across a loop closure.
    LoopPoints = ("points tracked across the loop closure", Plain(0)),
    /// Frames tied by points across a loop closure.
    LoopFrames = ("frames tied by them", Plain(0)),
    /// Image pairs across a loop closure.
    LoopPairs = ("image pairs across the loop closure", Plain(0)),
    /// Correction by a loop closure, degrees.
    LoopCorrection = ("loop correction", Of("°", 2)),
    /// Standard deviation of a loop closure by photometric similarity, degrees.
    LoopDeviation = ("standard deviation of the loop closure by photometric similarity", Of("°", 3)),
    /// Standard deviation of the axis sideways, degrees.
    AxisTiltSideways = ("standard deviation of the tilt sideways", Of("°", 4)),
    /// Standard deviation of the axis towards the camera, degrees.
    AxisTiltTowards = ("standard deviation of the tilt towards the camera", Of("°", 4)),
    /// Root mean square angle of the cameras' x axes with the horizontal plane, degrees.
    CameraRoll = ("roll of the cameras", Of("°", 1)),
    /// Angle between the axis of the cameras' circle and the up of level cameras, degrees.
    AxisFromLevel = ("axis and level cameras differ by", Of("°", 1)),
    /// Standard deviation of the scale, 0 to 1.
    ScaleDeviation = ("standard deviation of the scale", Percent(2)),
    /// Largest standard deviation of a rotation angle, degrees.
    AngleDeviation = ("standard deviation of the angles at most", Of("°", 4)),
    /// Angle from an image to the next, degrees.
    AngularStep = ("step", Of("°", 3)),
    /// Angular rate, degrees a second.
    AngularRate = ("rate", Of("°/s", 4)),
    /// Root mean square deviation of the angles from a constant rate, degrees.
    RateDeviation = ("deviation from a constant rate", Of("°", 4)),
    /// The same after smoothing by the motion prior, degrees.
    SmoothedDeviation = ("deviation after smoothing", Of("°", 4)),
    /// What that would be by noise alone, degrees.
    ExpectedDeviation = ("expected from noise alone", Of("°", 4)),
    /// Slow deviations of the rate, degrees.
    SlowDeviation = ("slow deviations", Of("°", 4)),
    /// How long they last, share of the video.
    SlowDuration = ("their duration (share of the video)", Percent(0)),
    /// Deviations from frame to frame, degrees.
    Jitter = ("jitter", Of("°", 4)),
    /// Elevation of the camera, degrees.
    Elevation = ("elevation", Of("°", 3)),
    /// Elevation that was measured or observed, degrees.
    GivenElevation = ("elevation beforehand", Of("°", 2)),
    /// Nearly vertical lines.
    Lines = ("nearly vertical lines", Plain(0)),
    /// Those that agree on one vertical direction.
    AgreeingLines = ("lines that agree", Plain(0)),
    /// Photos whose metadata say what is up.
    StatingPhotos = ("photos whose metadata say what is up", Plain(0)),
    /// Those that agree on one direction.
    AgreeingPhotos = ("photos that agree", Plain(0)),
    /// Places on a plane that are tracked.
    PlanePlaces = ("places on the plane", Plain(0)),
    /// Observations on a plane.
    PlaneObservations = ("observations on the plane", Plain(0)),
    /// How far the observations on a plane were from where the model had them, median, pixels.
    PlaneOffset = ("median offset of these from the model", Of("px", 2)),
    /// Images with few observations.
    WeakImages = ("images with few observations", Plain(0)),
    /// Points that three and more images see.
    WellObservedPoints = ("points seen by three and more images", Plain(0)),
    /// Distance of focal length and distortion from those of real cameras, standard deviations.
    CameraSurprise = ("standard deviations of focal length and distortion from the usual", Plain(1)),
    /// Matches of verified pairs that agree with the model, 0 to 1.
    AgreeingPairs = ("matches that agree with the model", Percent(0)),
    /// Matched keypoints that the model explains, in the tenth of the images with the least, 0 to
    /// 1.
    LeastExplained = ("matched keypoints explained in the worst tenth of the images", Percent(0)),
    /// Points of three and more images, in the tenth of the images with the fewest.
    LeastFirm = ("points of three and more images in the worst tenth of the images", Plain(0)),
    /// Median of the widest angles at which points are seen, degrees.
    PointAngle = ("angle between the views of a point", Of("°", 1)),
    /// Points across the weakest cut of the images, relative to those of an image.
    WeakestLink = ("points across the weakest link, relative to those of an image", Plain(2)),
    /// Held-out observations that agree with the model, 0 to 1.
    HeldOutAgreement = ("held-out observations that agree", Percent(0)),
    /// Median difference of relative rotations from those of a second solution, degrees.
    SecondDifference = ("a second solution differs by", Of("°", 2)),
    /// Hue of the screen, degrees.
    Hue = ("hue", Of("°", 0)),
    /// Part of the median frame that the screen covers, 0 to 1.
    Coverage = ("screen in the median frame", Percent(0)),
    /// The same of the worst frames, 0 to 1.
    LeastCoverage = ("screen in the worst frames", Percent(0)),
    /// Saturation of the screen, 0 to 1.
    Saturation = ("saturation", Plain(2)),
    /// Relative step of brightness between neighbouring pixels of the screen, 0 to 1.
    Roughness = ("roughness", Percent(1)),
    /// Part of the median frame that is lit, 0 to 1.
    LitShare = ("lit part of the median frame", Percent(1)),
    /// Largest connected part of it, 0 to 1.
    LargestLitPart = ("its largest connected part", Percent(0)),
    /// Pixels between dark and lit, times those lit.
    UndecidedPixels = ("pixels between dark and lit, relative to those lit", Plain(1)),
    /// Frames in which nothing stands before the screen.
    EmptyFrames = ("empty frames", Plain(0)),
    /// Part of the mean frame that the object covers, 0 to 1.
    ObjectShare = ("object in the mean frame", Percent(1)),
    /// Frames.
    Frames = ("frames", Plain(0)),
    /// Frames with a matte.
    MattedFrames = ("frames with a matte", Plain(0)),
    /// Training views that take part.
    TrainingViews = ("training views", Plain(0)),
    /// Validation views.
    ValidationViews = ("validation views", Plain(0)),
    /// PSNR, dB.
    Psnr = ("PSNR", Of("dB", 2)),
    /// PSNR before a change, dB.
    PsnrBefore = ("PSNR before", Of("dB", 2)),
    /// PSNR after it, dB.
    PsnrAfter = ("PSNR after", Of("dB", 2)),
    /// Degree of the spherical harmonics.
    ShDegree = ("degree", Plain(0)),
    /// Least gain of a view and channel.
    LeastGain = ("least gain", Plain(2)),
    /// Largest gain of a view and channel.
    LargestGain = ("largest gain", Plain(2)),
    /// Squared error that a model explains, 0 to 1.
    ExplainedError = ("explained squared error", Percent(1)),
    /// What it must explain, 0 to 1.
    NeededExplanation = ("needed", Percent(0)),
    /// Root mean square displacement of the projected scene, pixels.
    Displacement = ("root mean square displacement", Of("px", 2)),
    /// Steps of training.
    Steps = ("steps", Plain(0)),
    /// Steps for each training view.
    Passes = ("steps for each training view", Plain(0)),
    /// Time of training, seconds.
    Time = ("time", Of("s", 0)),
    /// Time limit, seconds.
    TimeLimit = ("time limit", Of("s", 0)),
    /// Loss of the first steps.
    FirstLoss = ("loss at first", Plain(4)),
    /// Loss of the last steps.
    LastLoss = ("loss at the end", Plain(4)),
    /// Pairs of Gaussians and tiles that a view needs.
    NeededTilePairs = ("pairs needed by a view", Plain(0)),
}

/// A number, and its standard deviation where it is known. Values that are not finite are written
/// as `null`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Measurement {
    /// What is measured.
    pub quantity: Quantity,
    /// The number, in the unit of the quantity.
    #[schemars(with = "Option<f64>")]
    #[serde(serialize_with = "finite_or_null", deserialize_with = "null_is_nan")]
    pub value: f64,
    /// Its standard deviation, in the same unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deviation: Option<f64>,
}

impl Measurement {
    /// A number alone.
    pub fn new(quantity: Quantity, value: f64) -> Self {
        Self { quantity, value, deviation: None }
    }

    /// A count.
    pub fn count(quantity: Quantity, count: usize) -> Self {
        Self::new(quantity, count as f64)
    }

    /// A number with its standard deviation.
    pub fn estimate(quantity: Quantity, value: f64, deviation: f64) -> Self {
        Self { quantity, value, deviation: Some(deviation).filter(|d| d.is_finite()) }
    }

    /// The intrinsics of a camera by name, with their standard deviations in the same order, if
    /// any.
    pub fn of_camera<'a>(camera: &'a Camera, deviations: &'a [f64]) -> impl Iterator<Item = Self> + 'a {
        let focals: &[Quantity] = match camera.model.num_focals() {
            1 => &[Quantity::FocalLength],
            _ => &[Quantity::FocalLengthX, Quantity::FocalLengthY],
        };
        let rest = [
            Quantity::PrincipalPointX,
            Quantity::PrincipalPointY,
            Quantity::RadialDistortion1,
            Quantity::RadialDistortion2,
            Quantity::TangentialDistortion1,
            Quantity::TangentialDistortion2,
        ];
        let names = focals.iter().copied().chain(rest);
        names.zip(&camera.params).enumerate().map(|(i, (quantity, &value))| {
            let deviation = deviations.get(i).copied().filter(|d| d.is_finite());
            Self { quantity, value, deviation }
        })
    }
}

fn finite_or_null<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    value.is_finite().then_some(*value).serialize(serializer)
}

fn null_is_nan<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::<f64>::deserialize(deserializer)?.unwrap_or(f64::NAN))
}
