//! What is known of the axis' direction: the camera's elevation, where a user measured it or the
//! room shows it.

use super::motion::CircularMotion;
use super::problem::ElevationPrior;
use glam::DVec3;
use scene::decision::{Measurement, Remark};

/// Standard deviation of an elevation that somebody measured (a spirit level, a phone's
/// inclinometer), radians.
/// Source: docs/decisions/08, 0.1 degrees is believed.
const ELEVATION_SIGMA: f64 = 0.1 * std::f64::consts::PI / 180.0;
/// It is held to a part of that, for observations of a point err together and say too much.
/// Source: docs/decisions/08, the observations pulled it by 0.15 degrees.
const FIRMNESS: f64 = 6.0;

/// How the camera looks down on the plane of the turn, from elsewhere than the turn.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Elevation {
    /// Radians.
    pub angle: f64,
    /// Standard deviation, radians.
    pub sigma: f64,
    /// Where it is from.
    pub source: Remark,
    /// What to do where it is doubtful.
    pub doubt: Remark,
    /// The figures behind it, for the report.
    pub figures: Vec<Measurement>,
}

impl Elevation {
    /// What somebody measured.
    pub(crate) fn from_measurement(degrees: f64) -> Self {
        Self {
            angle: degrees.to_radians(),
            sigma: ELEVATION_SIGMA,
            source: Remark::MeasuredElevation,
            doubt: Remark::DoubtfulMeasurement,
            figures: Vec::new(),
        }
    }

    /// The camera sees the upward axis u with `e_z · u = −sin(elevation)`.
    pub(crate) fn level(&self, turn: &CircularMotion) -> ElevationPrior {
        ElevationPrior {
            normal: DVec3::Z * turn.upward(),
            target: -self.angle.sin(),
            sigma: self.sigma * self.angle.cos() / FIRMNESS,
        }
    }
}

/// Angle by which the camera looks down on the plane of the turn, radians.
pub(crate) fn elevation(turn: &CircularMotion) -> f64 {
    -(turn.direction().z * turn.upward()).clamp(-1.0, 1.0).asin()
}
