//! Numbers that decisions rest on, each with its name and unit.

use crate::Camera;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// What a number measures. The comment tells the unit of its value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// Bayesian information criterion; less is better.
    Bic,
    /// Root mean square error of observations that were held out, pixels.
    HeldOutError,
    /// Decrease of the held-out squared error an observation, in variances of the noise.
    HeldOutGain,
    /// Robust standard deviation of a residual coordinate, pixels.
    Noise,
    /// Parameters of a motion model.
    MotionParameters,
    /// Logarithm of the odds (natural).
    LogOdds,
    /// Probability, 0 to 1.
    Probability,
    /// Factor on variances for residuals that are not independent.
    VarianceFactor,
    /// Images.
    Images,
    /// Images with a pose.
    RegisteredImages,
    /// Cameras.
    Cameras,
    /// Observations.
    Observations,
    /// Observations that were moved.
    MovedObservations,
    /// Observations kept, 0 to 1.
    KeptObservations,
    /// Observations before a change.
    ObservationsBefore,
    /// Observations after it.
    ObservationsAfter,
    /// Median reprojection error before a change, pixels.
    MedianErrorBefore,
    /// Median reprojection error after it, pixels.
    MedianErrorAfter,
    /// Features.
    FeatureCount,
    /// Image pairs.
    Pairs,
    /// Image pairs that could have been matched.
    PossiblePairs,
    /// Matches.
    Matches,
    /// Matches before a change.
    MatchesBefore,
    /// Matches after it.
    MatchesAfter,
    /// Matches of verified pairs that agree with a model.
    AgreeingMatches,
    /// Neighbours' matches that agree, 0 to 1.
    AgreeingShare,
    /// Wrong matches that would agree by chance, 0 to 1.
    ChanceShare,
    /// Blur of the second set of features, pixels.
    Blur,
    /// Focal length, pixels.
    FocalLength,
    /// Horizontal focal length, pixels.
    FocalLengthX,
    /// Vertical focal length, pixels.
    FocalLengthY,
    /// Principal point, pixels from the left.
    PrincipalPointX,
    /// Principal point, pixels from the top.
    PrincipalPointY,
    /// First term of radial distortion.
    RadialDistortion1,
    /// Second term of radial distortion.
    RadialDistortion2,
    /// First term of tangential distortion.
    TangentialDistortion1,
    /// Second term of tangential distortion.
    TangentialDistortion2,
    /// Standard deviation as a share of that of the prior, 0 to 1.
    ShareOfPrior,
    /// Distance of the principal point from the image centre, pixels.
    PrincipalPointOffset,
    /// The largest distance that is usual, pixels.
    UsualOffset,
    /// Angle between the rotation axes of free poses, degrees.
    AxisMisalignment,
    /// Distance of free camera centres from a circle, share of its radius.
    CircleMisfit,
    /// Rotations of an orbit about its circle, degrees.
    OrbitRotation,
    /// Translations of an orbit about its circle, share of the radius.
    OrbitTranslation,
    /// Residual of a single-axis model, pixels.
    SingleAxisResidual,
    /// Residual of free poses, pixels.
    FreeResidual,
    /// Points tracked through the video.
    TrackedPoints,
    /// Tracked points that do not move.
    StationaryPoints,
    /// Motion that one axis explains, 0 to 1.
    ExplainedMotion,
    /// Angle of the whole rotation, degrees.
    RotationRange,
    /// Points tracked across a loop closure.
    LoopPoints,
    /// Frames tied by points across a loop closure.
    LoopFrames,
    /// Image pairs across a loop closure.
    LoopPairs,
    /// Correction by a loop closure, degrees.
    LoopCorrection,
    /// Standard deviation of a loop closure by photometric similarity, degrees.
    LoopDeviation,
    /// Standard deviation of the axis sideways, degrees.
    AxisTiltSideways,
    /// Standard deviation of the axis towards the camera, degrees.
    AxisTiltTowards,
    /// Largest standard deviation of a rotation angle, degrees.
    AngleDeviation,
    /// Angle from an image to the next, degrees.
    AngularStep,
    /// Angular rate, degrees a second.
    AngularRate,
    /// Root mean square deviation of the angles from a constant rate, degrees.
    RateDeviation,
    /// What that would be by noise alone, degrees.
    ExpectedDeviation,
    /// Slow deviations of the rate, degrees.
    SlowDeviation,
    /// How long they last, share of the video.
    SlowDuration,
    /// Deviations from frame to frame, degrees.
    Jitter,
    /// Elevation of the camera, degrees.
    Elevation,
    /// Elevation that was measured or observed, degrees.
    GivenElevation,
    /// Nearly vertical lines.
    Lines,
    /// Those that agree on one vertical direction.
    AgreeingLines,
    /// Places on a plane that are tracked.
    PlanePlaces,
    /// Observations on a plane.
    PlaneObservations,
    /// How far the observations on a plane were from where the model had them, median, pixels.
    PlaneOffset,
    /// Images with few observations.
    WeakImages,
    /// Points.
    Points,
    /// Points that three and more images see.
    WellObservedPoints,
    /// Hue of the screen, degrees.
    Hue,
    /// Part of the median frame that the screen covers, 0 to 1.
    Coverage,
    /// The same of the worst frames, 0 to 1.
    LeastCoverage,
    /// Saturation of the screen, 0 to 1.
    Saturation,
    /// Relative step of brightness between neighbouring pixels of the screen, 0 to 1.
    Roughness,
    /// Frames.
    Frames,
    /// Frames with a matte.
    MattedFrames,
    /// Training views that take part.
    TrainingViews,
    /// Validation views.
    ValidationViews,
    /// PSNR, dB.
    Psnr,
    /// PSNR before a change, dB.
    PsnrBefore,
    /// PSNR after it, dB.
    PsnrAfter,
    /// Number of Gaussians.
    Gaussians,
    /// Number of Gaussians before a change.
    GaussiansBefore,
    /// Degree of the spherical harmonics.
    ShDegree,
    /// Least gain of a view and channel.
    LeastGain,
    /// Largest gain of a view and channel.
    LargestGain,
    /// Squared error that a model explains, 0 to 1.
    ExplainedError,
    /// What it must explain, 0 to 1.
    NeededExplanation,
    /// Root mean square displacement of the projected scene, pixels.
    Displacement,
    /// Steps of training.
    Steps,
    /// Steps for each training view.
    Passes,
    /// Time of training, seconds.
    Time,
    /// Time limit, seconds.
    TimeLimit,
    /// Loss of the first steps.
    FirstLoss,
    /// Loss of the last steps.
    LastLoss,
    /// Memory that is needed, MiB.
    NeededMemory,
    /// Memory that may be used, MiB.
    AvailableMemory,
    /// Pairs of Gaussians and tiles that a view needs.
    NeededTilePairs,
}

/// A number, and its standard deviation where it is known. Values that are not finite are written as `null`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// What is measured.
    pub quantity: Quantity,
    /// The number, in the unit of the quantity.
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

    /// The intrinsics of a camera by name, with their standard deviations in the same order, if any.
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
