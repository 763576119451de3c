//! What can be chosen.

use super::Measurement;
use crate::CameraModel;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How camera and object move relative to each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MotionModel {
    /// Rotation about one fixed axis.
    SingleAxis,
    /// Near a circle, with small deviations.
    Orbit,
    /// A rigid body on which no torque acts, before a camera that keeps its station or drifts.
    TorqueFree,
    /// Every pose by itself.
    Free,
    /// The poses that came with the input.
    Given,
}

/// How a coordinate pair of the principal point is treated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PrincipalPoint {
    /// Held at the image centre.
    Centre,
    /// Both coordinates are estimated.
    Free,
    /// Only x is estimated.
    FreeX,
    /// Only y is estimated.
    FreeY,
    /// Known beforehand.
    Given,
    /// Calibrated beforehand, within its standard deviations.
    Calibrated,
}

/// Which mapper makes the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MapperKind {
    /// Image by image.
    Incremental,
    /// All rotations, then all positions.
    Global,
}

/// What training does with pixels outside the mattes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum BackgroundModel {
    /// There is no matte: the background is part of the scene.
    Scene,
    /// Random colours behind the object.
    Transparent,
    /// Masked pixels have no weight.
    Ignored,
}

/// How illumination is modelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LightModel {
    /// The spherical harmonics carry what depends on the viewing direction.
    ViewDependent,
    /// The object turned before fixed lamps: in its frame they move with the camera.
    FixedToCamera,
}

/// Where features come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FeatureSource {
    /// A COLMAP database.
    Database,
}

/// What cuts the object out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MatteKind {
    /// None: the frames stay as they are.
    Nothing,
    /// A screen of one hue.
    Screen,
    /// Luminance before a dark background.
    Luminance,
}

/// What says which direction is up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum UpEvidence {
    /// The axis about which the object turns.
    TurnAxis,
    /// The axis of the circle on which the cameras stand.
    CircleAxis,
    /// The cameras, which are held level.
    #[default]
    LevelCameras,
    /// The photos' metadata, from accelerometers and gimbals.
    Metadata,
    /// Lines in the photos that are nearly vertical for level cameras, and meet in one point.
    VerticalLines,
}

/// What says how many metres a unit of the model is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ScaleEvidence {
    /// The distance of the camera from the axis.
    KnownDistance,
    /// The longest distance between two points of the object.
    LongestExtent,
    /// A length whose ends are marked in images.
    MarkedLength,
    /// So many tags of known size.
    Tags(usize),
    /// The places of so many photos.
    Gps(usize),
}

/// What was chosen, or could have been.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Choice {
    /// A camera model.
    Camera {
        /// The model; `None` where there is no camera, or cameras of several models came with the
        /// input.
        model: Option<CameraModel>,
        /// Its principal point.
        principal_point: PrincipalPoint,
    },
    /// A motion model.
    Motion(MotionModel),
    /// A mapper.
    Mapper(MapperKind),
    /// What becomes of the background.
    Background(BackgroundModel),
    /// How illumination is modelled.
    Light(LightModel),
    /// Where features come from.
    Features(FeatureSource),
    /// What cuts the object out.
    Matte(MatteKind),
    /// Whether what the subject names is done.
    Taken(bool),
    /// How many of the things that the subject names.
    Count {
        /// How many.
        count: usize,
        /// Of how many.
        total: Option<usize>,
    },
    /// A number.
    Value(Measurement),
    /// A direction in the camera's frame, unit length.
    Direction([f64; 3]),
    /// What says which direction is up.
    Up(UpEvidence),
    /// What says how many metres a unit is.
    Scale(ScaleEvidence),
    /// A device by its name.
    Device(String),
}

impl Choice {
    /// So many of the things that the subject names.
    pub fn count(count: usize) -> Self {
        Self::Count { count, total: None }
    }

    /// So many of so many.
    pub fn share(count: usize, total: usize) -> Self {
        Self::Count { count, total: Some(total) }
    }
}

impl From<MotionModel> for Choice {
    fn from(motion: MotionModel) -> Self {
        Self::Motion(motion)
    }
}

impl From<MapperKind> for Choice {
    fn from(mapper: MapperKind) -> Self {
        Self::Mapper(mapper)
    }
}

impl From<BackgroundModel> for Choice {
    fn from(background: BackgroundModel) -> Self {
        Self::Background(background)
    }
}

impl From<LightModel> for Choice {
    fn from(light: LightModel) -> Self {
        Self::Light(light)
    }
}

impl From<UpEvidence> for Choice {
    fn from(evidence: UpEvidence) -> Self {
        Self::Up(evidence)
    }
}

impl From<ScaleEvidence> for Choice {
    fn from(evidence: ScaleEvidence) -> Self {
        Self::Scale(evidence)
    }
}

impl From<MatteKind> for Choice {
    fn from(matte: MatteKind) -> Self {
        Self::Matte(matte)
    }
}

impl From<bool> for Choice {
    fn from(taken: bool) -> Self {
        Self::Taken(taken)
    }
}

impl From<Measurement> for Choice {
    fn from(value: Measurement) -> Self {
        Self::Value(value)
    }
}
