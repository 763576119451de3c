//! Decisions in words: the one place that turns them into English.

mod quantities;

use super::{
    Alternative, BackgroundModel, Choice, Decision, FeatureSource, LightModel, MapperKind, MatteKind,
    Measurement, MotionModel, PrincipalPoint, Remark, Rule, ScaleEvidence, Subject, UpEvidence,
};
use serde::{Deserialize, Serialize};
use std::fmt;

/// A decision in words.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sentences {
    /// What was decided.
    pub title: String,
    /// What was chosen.
    pub choice: String,
    /// Why, one clause each.
    pub evidence: Vec<String>,
}

impl fmt::Display for Sentences {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.title, self.choice)
    }
}

impl Decision {
    /// The decision in words.
    pub fn sentences(&self) -> Sentences {
        let rule = match (self.rule, self.subject) {
            // What training decides by default only needs views for validation.
            (Rule::Default, _) if self.remarks.contains(&Remark::NoValidation) => None,
            (rule, _) => rule.clause(),
        };
        let measured = self.measurements.iter().map(Measurement::clause);
        let evidence = rule
            .map(str::to_owned)
            .into_iter()
            .chain(self.remarks.iter().map(|r| r.clause().to_owned()))
            .chain(measured)
            .chain(self.alternatives.iter().map(|a| self.subject.alternative(a)))
            .chain(self.message.clone())
            .collect();
        let (title, choice) = (self.subject.title().to_owned(), self.subject.choice(&self.choice));
        Sentences { title, choice, evidence }
    }
}

impl Decision {
    /// Its remarks in words.
    pub fn remarks_in_words(&self) -> impl Iterator<Item = &'static str> {
        self.remarks.iter().map(|remark| remark.clause())
    }
}

impl Subject {
    /// The heading of the decision.
    pub fn title(self) -> &'static str {
        match self {
            Self::Matte => "Matte",
            Self::MattePieces => "Pieces of mattes apart from the object",
            Self::CameraModel => "Camera model",
            Self::Motion => "Motion",
            Self::Background => "Background",
            Self::ShDegree => "SH degree",
            Self::GaussianCount => "Number of Gaussians",
            Self::TrainingPoses => "Poses in training",
            Self::Exposure => "Exposure",
            Self::Illumination => "Illumination",
            Self::Features => "Features",
            Self::ImagePairs => "Image pairs",
            Self::BlurredFeatures => "Features of blurred images",
            Self::ConstantStepMotion => "Constant-step circular motion",
            Self::CircularStart => "Start from a circle",
            Self::Mapper => "Mapper",
            Self::RepeatedStructure => "Repeated structure",
            Self::CircleCompletion => "Images placed on the circle",
            Self::SharedCameras => "Cameras",
            Self::RotatedImages => "Images rotated by 180°",
            Self::KeypointRefinement => "Keypoints",
            Self::PlaneTracks => "Plane tracks",
            Self::CameraModelWithPlane => "Camera model with plane tracks",
            Self::CameraModelWithMotion => "Camera model with the motion",
            Self::VideoMotion => "Single-axis motion in the video",
            Self::RotationAxis => "Rotation axis",
            Self::CameraElevation => "Camera elevation",
            Self::RotationRate => "Rotation rate",
            Self::Plausibility => "Probability that the model is right",
            Self::WorldUp => "Up direction",
            Self::WorldScale => "Scale in metres",
            Self::TriangulatedPoints => "Sparse points",
            Self::Backend => "Device",
            Self::GaussianLimit => "Largest number of Gaussians",
            Self::GrowthLimit => "Growth",
            Self::TilePairs => "Pairs of Gaussians and tiles",
            Self::RedundantGaussians => "Redundant Gaussians",
            Self::UnobservedGaussians => "Unobserved Gaussians",
            Self::OutsideSilhouettes => "Gaussians outside the silhouettes",
            Self::BlackSky => "Black in the photos",
            Self::RefinedPoses => "Refined poses",
            Self::NonFiniteGradients => "Non-finite gradients",
            Self::TrainingTime => "Training time",
            Self::Convergence => "Convergence",
        }
    }

    /// What is said for no and for yes.
    fn no_and_yes(self) -> [&'static str; 2] {
        match self {
            Self::TrainingPoses => ["as given", "refined"],
            Self::Exposure => ["the same for all views", "a gain for each view and channel"],
            Self::KeypointRefinement => ["as detected", "refined by window registration"],
            Self::VideoMotion => ["not found", "found"],
            Self::Convergence => ["no", "yes"],
            // Without a probability: poses of the input were only compared with the photos.
            Self::Plausibility => ["not computed", "computed"],
            Self::BlackSky => ["may be anything", "is most probably nothing"],
            _ => ["not used", "used"],
        }
    }

    /// What a count counts, with the verb that belongs to it.
    fn counted(self) -> &'static str {
        match self {
            Self::ImagePairs => "matched pairs verified",
            Self::BlurredFeatures | Self::CircleCompletion | Self::RotatedImages => "images",
            Self::CircularStart => "images placed",
            Self::RepeatedStructure => "image pairs set aside",
            Self::TriangulatedPoints => "points triangulated",
            Self::SharedCameras => "groups of images",
            Self::TilePairs => "at most",
            Self::RedundantGaussians
            | Self::UnobservedGaussians
            | Self::OutsideSilhouettes
            | Self::MattePieces => "removed",
            Self::NonFiniteGradients => "skipped",
            _ => "",
        }
    }

    fn choice(self, choice: &Choice) -> String {
        match choice {
            Choice::Camera { model, principal_point } => {
                let model = model.map_or("as given", |m| m.name());
                format!("{model}, principal point {}", principal_point.words())
            }
            Choice::Motion(motion) => motion.words().to_owned(),
            Choice::Mapper(MapperKind::Incremental) => "incremental".to_owned(),
            Choice::Mapper(MapperKind::Global) => "global".to_owned(),
            Choice::Background(background) => background.words().to_owned(),
            Choice::Light(LightModel::ViewDependent) => "view-dependent colour only".to_owned(),
            Choice::Light(LightModel::FixedToCamera) => {
                "fixed to the camera, carried by the view-dependent colour".to_owned()
            }
            Choice::Features(FeatureSource::Database) => "from the database".to_owned(),
            Choice::Up(UpEvidence::TurnAxis) => "the axis about which the object turns".to_owned(),
            Choice::Up(UpEvidence::CircleAxis) => "the axis of the cameras' circle".to_owned(),
            Choice::Up(UpEvidence::LevelCameras) => "as the cameras were held".to_owned(),
            Choice::Up(UpEvidence::Metadata) => "as the photos' metadata say".to_owned(),
            Choice::Up(UpEvidence::VerticalLines) => "along the vertical lines of the photos".to_owned(),
            Choice::Scale(evidence) => evidence.words(),
            Choice::Matte(MatteKind::Nothing) => "none".to_owned(),
            Choice::Matte(MatteKind::Screen) => "keyed against a screen".to_owned(),
            Choice::Matte(MatteKind::Luminance) => "keyed by luminance".to_owned(),
            Choice::Taken(taken) => self.no_and_yes()[usize::from(*taken)].to_owned(),
            Choice::Count { count, total } => self.count(*count, *total),
            Choice::Value(value) => value.figure(),
            Choice::Direction([x, y, z]) => format!("({x:.4}, {y:.4}, {z:.4}) in the camera frame"),
            Choice::Device(name) => name.clone(),
        }
    }

    fn count(self, count: usize, total: Option<usize>) -> String {
        let of = total.map_or(String::new(), |total| format!(" of {total}"));
        match self {
            Self::SharedCameras => {
                let plural = if count == 1 { "" } else { "s" };
                let groups = total.map_or(String::new(), |n| format!(" for {n} {}", self.counted()));
                format!("{count} camera{plural}{groups}")
            }
            Self::TilePairs => format!("at most {count}"),
            _ => format!("{count}{of} {}", self.counted()).trim_end().to_owned(),
        }
    }

    fn alternative(self, alternative: &Alternative) -> String {
        let scores: Vec<String> = alternative.scores.iter().map(Measurement::clause).collect();
        let accepted = if alternative.accepted { " (accepted)" } else { "" };
        format!("{}{accepted}: {}", self.choice(&alternative.choice), scores.join(", "))
    }
}

impl MotionModel {
    fn words(self) -> &'static str {
        match self {
            Self::SingleAxis => "single axis",
            Self::Orbit => "orbit",
            Self::TorqueFree => "torque-free tumble",
            Self::Free => "free",
            Self::Given => "as given",
        }
    }
}

impl PrincipalPoint {
    fn words(self) -> &'static str {
        match self {
            Self::Centre => "at the image centre",
            Self::Free => "estimated",
            Self::FreeX => "estimated in x",
            Self::FreeY => "estimated in y",
            Self::Given => "as given",
            Self::Calibrated => "as calibrated, within its standard deviations",
        }
    }
}

impl ScaleEvidence {
    fn words(self) -> String {
        match self {
            Self::KnownDistance => "the known distance of the camera from the axis".to_owned(),
            Self::LongestExtent => {
                "the known length of the object, taken for the longest extent of its points".to_owned()
            }
            Self::MarkedLength => "a known length that was marked".to_owned(),
            Self::Tags(1) => "one tag of known size".to_owned(),
            Self::Tags(count) => format!("{count} tags of known size"),
            Self::Gps(count) => format!("the places (GPS) of {count} photos"),
        }
    }
}

impl BackgroundModel {
    fn words(self) -> &'static str {
        match self {
            Self::Scene => "part of the scene",
            Self::Transparent => "transparent",
            Self::Ignored => "ignored",
        }
    }
}

impl Rule {
    fn clause(self) -> Option<&'static str> {
        Some(match self {
            Self::Evidence => return None,
            Self::Requested => "requested",
            Self::Given => "known beforehand",
            Self::Default => "default, not examined in this run",
            Self::TooFewImages => "too few images to decide",
            Self::TooFewObservations => "too few observations to decide",
            Self::NotDetermined => "not determined by the observations",
            Self::NothingFound => "nothing suitable was found",
            Self::Contradicted => "the observations contradict it",
            Self::OutOfMemory => "limited by memory",
            Self::Failed => "it failed",
        })
    }
}

impl Remark {
    fn clause(self) -> &'static str {
        match self {
            Self::SeveralCameras => "several cameras took the images, so none of them stood still",
            Self::NoRotation => "the general model has no poses that rotate about an axis",
            Self::NoCircle => "the poses are not near a circle",
            Self::NoSingleAxisModel => "no single-axis model could be built",
            Self::ThreeImages => "the single-axis model was initialised from three images",
            Self::TooFewFrames => "the video has fewer than four frames",
            Self::NoMotion => "no tracked point moves enough",
            Self::ShortTracks => "tracked points do not last long enough",
            Self::WeakExplanation => "one axis explains too little of the motion",
            Self::NoTriangulation => "no initial motion triangulates points",
            Self::NoExtension => "the initial motion could not be extended",
            Self::TracksDisagree => "tracks and key frames do not agree on one axis",
            Self::NoLoop => "the rotation is too short for a loop closure",
            Self::LoopNotObserved => "a loop closure was not observed",
            Self::ClosedCircle => "the first image follows the last",
            Self::Replaced => "the pairs found this way replace the others",
            Self::MeasuredElevation => "the elevation was measured",
            Self::VerticalLines => "the elevation follows from vertical lines in the images",
            Self::DoubtfulMeasurement => "doubtful: measure the elevation again",
            Self::DoubtfulLines => "doubtful: check that the axis is vertical, or give --known-elevation",
            Self::KnownCamera => "not used, because the camera is known",
            Self::NoPlane => "most images see no common plane",
            Self::EmptyPlane => "a plane is visible, but nothing on it can be tracked",
            Self::PlaneDisagrees => "the tracks on the plane agree with no model",
            Self::NoGraphicsCard => "no graphics card was found",
            Self::FirstGraphicsCard => "the first graphics card",
            Self::GrowthStopped => "growth ended when the validation views no longer improved",
            Self::StillImproving => "the validation views were still improving",
            Self::GainsConfirmed => "gains found earlier were checked again",
            Self::Unobserved => "hardly any view has them in its image, so nothing constrains them",
            Self::BlackRims => "there are no mattes, and the rims of the photos are evenly black",
            Self::OutsideHull => {
                "more than a third of the training views that have their centre in the image show \
                 background there"
            }
            Self::OtherMasksDisagree => {
                "no place along their rays is covered by most of the other masks: a shadow, or what stands still"
            }
            Self::StepSkipped => "these Gaussians kept their values in that step",
            Self::Overfitting => "more steps would overfit the photos",
            Self::CheckInput => "check poses and masks, or lower --learning-rate",
            Self::NearestOnly => "only the nearest are drawn",
            Self::NaturalHue => "the hue is one of wood, skin and lamp light; name it with --key to use it",
            Self::NotKeyableByLight => "the object cannot be keyed by light: give masks, or use --key off",
            Self::NoHue => "hardly any pixel has a distinct hue",
            Self::EmptyFrames => "most frames show nothing before the screen",
            Self::RandomBackground => "training draws random colours behind the object",
            Self::LampMovesWithCamera => {
                "the object turned before fixed lamps, so in its own frame they move with the camera; \
                 views off the filmed circle are extrapolated"
            }
            Self::MatchedAnew => "the features are matched anew",
            Self::NoValidation => "as configured: no view was set aside to examine it",
            Self::Doubtful => "doubtful: check it before you use it",
            Self::UnusualCamera => {
                "focal length or lens distortion are unlike those of real cameras: calibrate the camera and \
                 give its folder to --camera-from, or give photos that still have their EXIF data"
            }
            Self::UnexplainedMatches => {
                "some images have many matches that the model does not explain: mask what moves by itself, \
                 and give images of one object alone"
            }
            Self::NarrowViews => {
                "points are seen at small angles only: move the camera around the object, not about itself"
            }
            Self::HeldOutDisagree => {
                "observations that were held out disagree with the model: take images closer together, with \
                 more light, or with texture on or beside the object"
            }
            Self::SolutionsDisagree => {
                "a second solution from the same images has other rotations: parts that look alike may have \
                 been mistaken for each other"
            }
            Self::PartsNotTied => {
                "no points tie two parts of the images to each other, as after a cut: how the parts lie is a \
                 guess; give them one at a time, or film them without a cut"
            }
            Self::PosesOff => {
                "half of what the photos share lies a three-hundredth of the picture or more from where the \
                 poses and cameras of the input say: mend them, or let --ignore-poses find them anew"
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CameraModel;
    use crate::decision::Quantity;

    fn camera(model: CameraModel, principal_point: PrincipalPoint) -> Choice {
        Choice::Camera { model: Some(model), principal_point }
    }

    #[test]
    fn a_decision_between_cameras_tells_the_scores_of_each() {
        let score = |bic| vec![Measurement::new(Quantity::Bic, bic)];
        let [before, after] = [PrincipalPoint::Centre, PrincipalPoint::Free]
            .map(|point| camera(CameraModel::SimpleRadial, point));
        let words = Decision::new(Subject::CameraModel, after.clone(), Rule::Evidence)
            .estimated(Quantity::FocalLength, 812.34, 1.25)
            .compared(before, false, score(512.4))
            .compared(after, true, score(-1.6))
            .sentences();
        assert_eq!(words.to_string(), "Camera model: SIMPLE_RADIAL, principal point estimated");
        let expected = [
            "f 812.3 ± 1.2 px",
            "SIMPLE_RADIAL, principal point at the image centre: BIC 512",
            "SIMPLE_RADIAL, principal point estimated (accepted): BIC -2",
        ];
        assert_eq!(words.evidence, expected);
    }

    #[test]
    fn counts_and_yes_or_no_take_the_words_of_their_subject() {
        let choice =
            |subject, choice: Choice| Decision::new(subject, choice, Rule::Evidence).sentences().choice;
        assert_eq!(choice(Subject::ImagePairs, Choice::share(12, 40)), "12 of 40 matched pairs verified");
        assert_eq!(choice(Subject::SharedCameras, Choice::share(1, 3)), "1 camera for 3 groups of images");
        assert_eq!(choice(Subject::GaussianCount, Choice::count(500)), "500");
        assert_eq!(choice(Subject::KeypointRefinement, false.into()), "as detected");
        assert_eq!(choice(Subject::PlaneTracks, true.into()), "used");
    }

    #[test]
    fn numbers_are_written_in_their_units() {
        let clause = |quantity, value| Measurement::new(quantity, value).clause();
        assert_eq!(clause(Quantity::KeptObservations, 0.934), "observations kept 93 %");
        assert_eq!(clause(Quantity::LogOdds, 3.21), "log odds +3.2");
        let gain = Measurement::estimate(Quantity::HeldOutGain, 0.0123, 0.0021);
        assert_eq!(gain.clause(), "held-out gain 0.0123 ± 0.0021");
        let step = Measurement::estimate(Quantity::AngularStep, 3.0, 0.01);
        assert_eq!(step.clause(), "step 3.000 ± 0.010°");
    }

    #[test]
    fn a_decision_survives_json_even_with_numbers_that_are_none() {
        let decision = Decision::new(Subject::Motion, MotionModel::Free, Rule::TooFewObservations)
            .remarked(Remark::NoCircle)
            .measured(Quantity::Bic, f64::INFINITY)
            .measured(Quantity::Noise, 0.25)
            .quoting("as it is");
        let json = serde_json::to_value(&decision).unwrap();
        assert_eq!(json["choice"]["motion"], "free");
        assert!(json["measurements"][0]["value"].is_null());
        let back: Decision = serde_json::from_value(json).unwrap();
        assert!(back.value(Quantity::Bic).unwrap().is_nan());
        assert_eq!(back.value(Quantity::Noise), Some(0.25));
        assert_eq!(
            (back.rule, back.remarks, back.message),
            (decision.rule, decision.remarks, decision.message)
        );
    }
}
