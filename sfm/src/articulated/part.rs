//! What is told of parts.

use super::joint::{JointPath, JointSigmas};
use super::posed::PosedTrack;
use glam::{DQuat, DVec3};
use scene::Pose;
use serde::{Deserialize, Serialize};

/// A part that turns on a joint.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct MovingPart {
    /// Direction of the axis, unit, model frame; a positive angle is counter-clockwise about it.
    pub axis: [f64; 3],
    /// The place on the axis nearest to the middle of the part, model frame.
    pub place: [f64; 3],
    /// Standard deviation of the axis, degrees.
    pub axis_sigma_deg: f64,
    /// Standard deviation of the place across the axis, model units.
    pub place_sigma: f64,
    /// Angle in each frame, degrees; 0 in the first.
    pub angles_deg: Vec<f64>,
    /// Their standard deviations, degrees.
    pub angle_sigmas_deg: Vec<f64>,
    /// Tracks that follow it.
    pub tracks: usize,
    /// Observations of these.
    pub observations: usize,
    /// Reprojection error of these on the joint, RMS, pixels.
    pub error_px: f64,
    /// The same, were they parts of the body.
    pub still_error_px: f64,
    /// Points of the part as it is in the first frame, model frame.
    pub points: Vec<[f64; 3]>,
    /// How much better photos are explained than without it, dB, where photos found it; then it
    /// has no tracks.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain_db: Option<f64>,
}

/// What was found out about the parts of an object.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Articulation {
    /// Frames in the order of time, by name.
    pub frames: Vec<String>,
    /// Parts that move against the body, the one with most observations first.
    pub parts: Vec<MovingPart>,
    /// Standard deviation of an observation of the body, pixels.
    pub noise_px: f64,
    /// Tracks long enough to tell.
    pub tracks: usize,
    /// Tracks that belong neither to the body nor to a part.
    pub unexplained: usize,
    /// How many Gaussians of the splat beside it the body has, and each part after it, in the
    /// splat's order; none without a splat.
    #[serde(default)]
    pub gaussians: Vec<usize>,
    /// How probably the poses are right from which all this follows, where they are doubtful;
    /// else 1.
    #[serde(default = "no_doubt")]
    pub poses_probability: f64,
}

/// Of records that say nothing of it.
fn no_doubt() -> f64 {
    1.0
}

impl Articulation {
    /// The number of a frame, from 0 on.
    pub fn number(&self, frame: &str) -> Option<usize> {
        self.frames.iter().position(|name| name == frame)
    }
}

impl MovingPart {
    /// The body's frame from that of the part at rest, at an angle in degrees.
    pub fn pose(&self, angle_deg: f64) -> Pose {
        let rotation = DQuat::from_axis_angle(DVec3::from(self.axis), angle_deg.to_radians());
        let place = DVec3::from(self.place);
        Pose::new(rotation, place - rotation * place)
    }

    /// Its angle, degrees, so many frames after the first; between two frames by a line, beyond
    /// the ends as there.
    pub fn angle_deg(&self, frame: f64) -> f64 {
        let last = self.angles_deg.len().saturating_sub(1) as f64;
        let frame = if frame > 0.0 { frame.min(last) } else { 0.0 };
        let (before, share) = (frame.floor() as usize, frame.fract());
        let at = |k: usize| self.angles_deg.get(k).or(self.angles_deg.last()).copied().unwrap_or(0.0);
        at(before) * (1.0 - share) + at(before + 1) * share
    }

    /// What is told of a part on this joint whose tracks are these.
    pub(super) fn of(path: &JointPath, sigmas: &JointSigmas, tracks: &[&PosedTrack<'_>]) -> Self {
        let found: Vec<(DVec3, f64)> = tracks.iter().filter_map(|t| t.point(path)).collect();
        let still: Vec<f64> = tracks.iter().filter_map(|t| t.still()).map(|s| s.1).collect();
        let middle = found.iter().map(|(x, _)| *x).sum::<DVec3>() / found.len().max(1) as f64;
        Self {
            axis: path.axis.to_array(),
            place: (path.place + path.axis * (middle - path.place).dot(path.axis)).to_array(),
            axis_sigma_deg: sigmas.axis.to_degrees(),
            place_sigma: sigmas.place,
            angles_deg: path.angles.iter().map(|a| a.to_degrees()).collect(),
            angle_sigmas_deg: sigmas.angles.iter().map(|a| a.to_degrees()).collect(),
            tracks: tracks.len(),
            observations: tracks.iter().map(|t| t.views.len()).sum(),
            error_px: rms(&found.iter().map(|(_, e)| *e).collect::<Vec<f64>>()),
            still_error_px: rms(&still),
            points: found.iter().map(|(x, _)| x.to_array()).collect(),
            gain_db: None,
        }
    }
}

/// 0 of nothing.
fn rms(errors: &[f64]) -> f64 {
    (errors.iter().map(|e| e * e).sum::<f64>() / errors.len().max(1) as f64).sqrt()
}
