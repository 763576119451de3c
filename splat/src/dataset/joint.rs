//! A joint, and what pulls at it.

use crate::parts::{PartPlace, PartPull};
use glam::{DQuat, DVec3, Mat3, Vec3};
use serde::{Deserialize, Serialize};

/// A joint: the part turns about an axis, by an angle in each view. World frame for data sets and
/// results, else that of the Gaussians.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Direction of the axis, unit.
    pub axis: DVec3,
    /// A place on it.
    pub place: DVec3,
    /// Radians, by view; 0 at rest.
    pub angles: Vec<f64>,
    /// Standard deviations of these.
    pub sigmas: Vec<f64>,
    /// Standard deviations of the axis, radians, and of the place, in its unit; training turns and
    /// moves the joint as far as they let it.
    pub unsure: [f64; 2],
}

/// Where a joint is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct JointPlace {
    /// Direction of the axis, unit.
    pub(crate) axis: DVec3,
    /// A place on it.
    pub(crate) place: DVec3,
}

impl Joint {
    /// Where it is.
    pub(crate) fn at(&self) -> JointPlace {
        JointPlace { axis: self.axis, place: self.place }
    }
}

impl JointPlace {
    /// What turns a part that is pulled at, where a camera stands there (frame of the part at
    /// rest): dL/d(rotation) about the place.
    fn torque(&self, pull: &PartPull, camera: Vec3) -> DVec3 {
        let [force, torque, colour] = vectors(pull);
        // The part turns below the camera: its colours are seen as if the camera turned back.
        torque - self.place.cross(force) + (camera.as_dvec3() - self.place).cross(colour)
    }

    /// dL/d(angle).
    pub(crate) fn slope(&self, pull: &PartPull, camera: Vec3) -> f64 {
        self.axis.dot(self.torque(pull, camera))
    }

    /// dL/d(axis), across it, and dL/d(place) where the part stands at an angle:
    /// `R(a + δ) ≈ R(a) exp([sin θ δ − (1 − cos θ) a × δ]ₓ)`, `dx = (1 − R) dp`.
    pub(crate) fn slopes(&self, angle: f64, pull: &PartPull, camera: Vec3) -> [DVec3; 2] {
        let (sin, cos) = angle.sin_cos();
        let torque = self.torque(pull, camera);
        let axis = sin * torque - (1.0 - cos) * torque.cross(self.axis);
        let [force, _, colour] = vectors(pull);
        let all = force + colour;
        let place = DQuat::from_axis_angle(self.axis, angle) * all - all;
        [axis.reject_from_normalized(self.axis), place]
    }

    /// Where the part stands at an angle, radians.
    pub(crate) fn place_at(&self, angle: f64) -> PartPlace {
        let rotation = DQuat::from_axis_angle(self.axis, angle);
        let translation = self.place - rotation * self.place;
        PartPlace { rotation: Mat3::from_quat(rotation.as_quat()), translation: translation.as_vec3() }
    }
}

/// Force, torque and what pulls through colours.
fn vectors(pull: &PartPull) -> [DVec3; 3] {
    [pull.force, pull.torque, pull.colour].map(|v| Vec3::from(v).as_dvec3())
}
