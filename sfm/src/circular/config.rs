//! What a user can say about the motion.

use crate::error::SfmError;
use serde::{Deserialize, Serialize};

/// How object and camera move against each other.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Motion {
    /// The evidence decides
    #[default]
    Auto,
    /// The object turns about one axis before a camera that stands still: one angle a frame
    SingleAxis,
    /// The camera goes round on a circle, with small motions of its own
    Orbit,
    /// The object is a rigid body that no torque acts on: it tumbles (videos)
    Tumble,
    /// Nothing is assumed
    Free,
}

impl Motion {
    /// Name in reports; the flag's value.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::SingleAxis => "single-axis",
            Self::Orbit => "orbit",
            Self::Tumble => "tumble",
            Self::Free => "free",
        }
    }
}

/// Configuration of the motion.
#[derive(clap::Args, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MotionConfig {
    /// How object and camera move against each other
    #[arg(long, value_enum, default_value_t = Motion::Auto, help_heading = "Motion")]
    pub motion: Motion,
    /// Rate at which the object of a video turns, where it is known (the sign does not matter)
    #[arg(long, value_name = "DEG_PER_S", help_heading = "Motion")]
    pub known_rate: Option<f64>,
    /// Distance of the camera from the axis, where it is known: the model is in metres then
    #[arg(long, value_name = "METRES", help_heading = "Motion")]
    pub known_distance: Option<f64>,
    /// Angle by which the camera looks down on the plane in which the object turns (0: level),
    /// where it was measured, to about a tenth of a degree: says where the principal point is along
    /// the axis, which a turn does not
    #[arg(long, value_name = "DEG", allow_negative_numbers = true, help_heading = "Motion")]
    pub known_elevation: Option<f64>,
}

impl MotionConfig {
    /// Refuses what cannot be meant.
    pub fn validate(&self) -> Result<(), SfmError> {
        let (flag, value) = match (self.known_rate, self.known_distance, self.known_elevation) {
            (Some(rate), ..) if !(rate.is_finite() && rate != 0.0) => ("--known-rate", rate),
            (_, Some(d), _) if !(d.is_finite() && d > 0.0) => ("--known-distance", d),
            (.., Some(e)) if !(e.is_finite() && e.abs() < 90.0) => ("--known-elevation", e),
            _ => return Ok(()),
        };
        Err(SfmError::BadNumber { flag, value })
    }
}
