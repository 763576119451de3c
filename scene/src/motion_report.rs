//! How a body moves, in numbers that a mission planner needs.

use crate::decision::MotionModel;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A number and its standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Estimate {
    /// The number.
    pub value: f64,
    /// Its standard deviation, in the same unit.
    pub deviation: f64,
}

impl Estimate {
    /// A number with its standard deviation.
    pub fn new(value: f64, deviation: f64) -> Self {
        Self { value, deviation }
    }

    /// Radians as degrees.
    pub fn in_degrees(self) -> Self {
        Self::new(self.value.to_degrees(), self.deviation.to_degrees())
    }
}

/// The rates of a body at a time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MotionSample {
    /// When, seconds.
    pub time_s: f64,
    /// Angular velocity of the body before the camera, camera frame, degrees a second.
    pub rate_deg_s: [f64; 3],
}

/// How a torque-free body tumbles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TumbleReport {
    /// Mean angle between the principal axis about which it turns and the angular momentum.
    pub nutation_deg: Estimate,
    /// Time after which the rates repeat in the body's frame; none for a turn about one principal
    /// axis.
    pub period_s: Option<Estimate>,
    /// Smallest and middle moment of inertia as shares of the largest.
    pub inertia_ratios: [Estimate; 2],
}

/// How a body turns before a camera that does not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MotionReport {
    /// The motion that was found.
    pub motion: MotionModel,
    /// Spin axis in the frame of the camera: that of the turn, or the direction of the angular
    /// momentum of a tumble; unit length, counter-clockwise.
    pub axis_camera: [f64; 3],
    /// Standard deviation of its direction, degrees.
    pub axis_camera_deviation_deg: f64,
    /// Spin axis in the frame of the model: that of the turn, or the principal axis about which a
    /// tumbling body mostly turns.
    pub axis_body: [f64; 3],
    /// Standard deviation of its direction, degrees.
    pub axis_body_deviation_deg: f64,
    /// Mean rate.
    pub rate_deg_s: Estimate,
    /// What a tumble is beside that.
    pub tumble: Option<TumbleReport>,
    /// Rates at the times of the images.
    pub samples: Vec<MotionSample>,
}
