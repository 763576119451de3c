//! Numbers in words: name, digits, unit.

use crate::decision::{Measurement, Quantity};

/// How a number is written.
enum Unit {
    /// No unit, so many digits.
    Plain(usize),
    /// Signed, so many digits.
    Signed(usize),
    /// Shares are written as percentages, so many digits.
    Percent(usize),
    /// A unit behind the number, so many digits.
    Of(&'static str, usize),
}

impl Measurement {
    /// Name, number and unit.
    pub(super) fn clause(&self) -> String {
        format!("{} {}", self.quantity.words().0, self.figure())
    }

    /// The number with its unit and standard deviation.
    pub(super) fn figure(&self) -> String {
        let with = |factor: f64, digits: usize, unit: &str| {
            let deviation = self.deviation.map_or(String::new(), |d| format!(" ± {:.digits$}", factor * d));
            format!("{:.digits$}{deviation}{unit}", factor * self.value)
        };
        match self.quantity.words().1 {
            Unit::Plain(digits) => with(1.0, digits, ""),
            Unit::Signed(digits) if self.deviation.is_none() => format!("{:+.digits$}", self.value),
            Unit::Signed(digits) => with(1.0, digits, ""),
            Unit::Percent(digits) => with(100.0, digits, " %"),
            Unit::Of(unit @ "°", digits) => with(1.0, digits, unit),
            Unit::Of(unit, digits) => with(1.0, digits, &format!(" {unit}")),
        }
    }
}

impl Quantity {
    /// The name of the quantity, and how its numbers are written.
    fn words(self) -> (&'static str, Unit) {
        use Unit::{Of, Percent, Plain, Signed};
        match self {
            Self::Bic => ("BIC", Plain(0)),
            Self::HeldOutError => ("held-out error", Of("px", 3)),
            Self::HeldOutGain => ("held-out gain", Signed(4)),
            Self::Noise => ("noise", Of("px", 3)),
            Self::MotionParameters => ("motion parameters", Plain(0)),
            Self::LogOdds => ("log odds", Signed(1)),
            Self::Probability => ("probability", Plain(2)),
            Self::VarianceFactor => ("variance factor for dependent residuals", Plain(1)),
            Self::Images => ("images", Plain(0)),
            Self::RegisteredImages => ("registered images", Plain(0)),
            Self::Cameras => ("cameras", Plain(0)),
            Self::Observations => ("observations", Plain(0)),
            Self::MovedObservations => ("observations moved", Plain(0)),
            Self::KeptObservations => ("observations kept", Percent(0)),
            Self::ObservationsBefore => ("other observations before", Plain(0)),
            Self::ObservationsAfter => ("other observations after", Plain(0)),
            Self::MedianErrorBefore => ("median error before", Of("px", 3)),
            Self::MedianErrorAfter => ("median error after", Of("px", 3)),
            Self::FeatureCount => ("features", Plain(0)),
            Self::Pairs => ("image pairs", Plain(0)),
            Self::PossiblePairs => ("possible pairs", Plain(0)),
            Self::Matches => ("matches", Plain(0)),
            Self::MatchesBefore => ("matches before", Plain(0)),
            Self::MatchesAfter => ("matches after", Plain(0)),
            Self::AgreeingMatches => ("agreeing matches", Plain(0)),
            Self::AgreeingShare => ("agreeing matches of neighbours", Percent(0)),
            Self::ChanceShare => ("expected by chance", Percent(0)),
            Self::Blur => ("blur", Of("px", 1)),
            Self::FocalLength => ("f", Of("px", 1)),
            Self::FocalLengthX => ("fx", Of("px", 1)),
            Self::FocalLengthY => ("fy", Of("px", 1)),
            Self::PrincipalPointX => ("cx", Of("px", 2)),
            Self::PrincipalPointY => ("cy", Of("px", 2)),
            Self::RadialDistortion1 => ("k1", Plain(4)),
            Self::RadialDistortion2 => ("k2", Plain(4)),
            Self::TangentialDistortion1 => ("p1", Plain(5)),
            Self::TangentialDistortion2 => ("p2", Plain(5)),
            Self::ShareOfPrior => ("standard deviation relative to the prior", Percent(1)),
            Self::PrincipalPointOffset => ("principal point off the image centre by", Of("px", 1)),
            Self::UsualOffset => ("usual offset at most", Of("px", 0)),
            Self::AxisMisalignment => ("axes of the free rotations differ by", Of("°", 2)),
            Self::CircleMisfit => ("free camera centres off a circle by (share of its radius)", Percent(2)),
            Self::OrbitRotation => ("deviations in rotation", Of("°", 3)),
            Self::OrbitTranslation => ("deviations in translation (share of the radius)", Percent(3)),
            Self::SingleAxisResidual => ("residual with one axis", Of("px", 2)),
            Self::FreeResidual => ("residual with free poses", Of("px", 2)),
            Self::TrackedPoints => ("tracked points", Plain(0)),
            Self::StationaryPoints => ("stationary points", Plain(0)),
            Self::ExplainedMotion => ("motion explained by one axis", Percent(0)),
            Self::RotationRange => ("rotation in total", Of("°", 1)),
            Self::LoopPoints => ("points tracked across the loop closure", Plain(0)),
            Self::LoopFrames => ("frames tied by them", Plain(0)),
            Self::LoopPairs => ("image pairs across the loop closure", Plain(0)),
            Self::LoopCorrection => ("loop correction", Of("°", 2)),
            Self::LoopDeviation => {
                ("standard deviation of the loop closure by photometric similarity", Of("°", 3))
            }
            Self::AxisTiltSideways => ("standard deviation of the tilt sideways", Of("°", 4)),
            Self::AxisTiltTowards => ("standard deviation of the tilt towards the camera", Of("°", 4)),
            Self::AngleDeviation => ("standard deviation of the angles at most", Of("°", 4)),
            Self::AngularStep => ("step", Of("°", 3)),
            Self::AngularRate => ("rate", Of("°/s", 4)),
            Self::RateDeviation => ("deviation from a constant rate", Of("°", 4)),
            Self::ExpectedDeviation => ("expected from noise alone", Of("°", 4)),
            Self::SlowDeviation => ("slow deviations", Of("°", 4)),
            Self::SlowDuration => ("their duration (share of the video)", Percent(0)),
            Self::Jitter => ("jitter", Of("°", 4)),
            Self::Elevation => ("elevation", Of("°", 3)),
            Self::GivenElevation => ("elevation beforehand", Of("°", 2)),
            Self::Lines => ("nearly vertical lines", Plain(0)),
            Self::AgreeingLines => ("lines that agree", Plain(0)),
            Self::PlanePlaces => ("places on the plane", Plain(0)),
            Self::PlaneObservations => ("observations on the plane", Plain(0)),
            Self::PlaneOffset => ("median offset of these from the model", Of("px", 2)),
            Self::WeakImages => ("images with few observations", Plain(0)),
            Self::Points => ("points", Plain(0)),
            Self::WellObservedPoints => ("points seen by three and more images", Plain(0)),
            Self::Hue => ("hue", Of("°", 0)),
            Self::Coverage => ("screen in the median frame", Percent(0)),
            Self::LeastCoverage => ("screen in the worst frames", Percent(0)),
            Self::Saturation => ("saturation", Plain(2)),
            Self::Roughness => ("roughness", Percent(1)),
            Self::Frames => ("frames", Plain(0)),
            Self::MattedFrames => ("frames with a matte", Plain(0)),
            Self::TrainingViews => ("training views", Plain(0)),
            Self::ValidationViews => ("validation views", Plain(0)),
            Self::Psnr => ("PSNR", Of("dB", 2)),
            Self::PsnrBefore => ("PSNR before", Of("dB", 2)),
            Self::PsnrAfter => ("PSNR after", Of("dB", 2)),
            Self::Gaussians => ("Gaussians", Plain(0)),
            Self::GaussiansBefore => ("Gaussians before", Plain(0)),
            Self::ShDegree => ("degree", Plain(0)),
            Self::LeastGain => ("least gain", Plain(2)),
            Self::LargestGain => ("largest gain", Plain(2)),
            Self::ExplainedError => ("explained squared error", Percent(1)),
            Self::NeededExplanation => ("needed", Percent(0)),
            Self::Displacement => ("root mean square displacement", Of("px", 2)),
            Self::Steps => ("steps", Plain(0)),
            Self::Passes => ("steps for each training view", Plain(0)),
            Self::Time => ("time", Of("s", 0)),
            Self::TimeLimit => ("time limit", Of("s", 0)),
            Self::FirstLoss => ("loss at first", Plain(4)),
            Self::LastLoss => ("loss at the end", Plain(4)),
            Self::NeededMemory => ("memory needed", Of("MiB", 0)),
            Self::AvailableMemory => ("memory available", Of("MiB", 0)),
            Self::NeededTilePairs => ("pairs needed by a view", Plain(0)),
        }
    }
}
