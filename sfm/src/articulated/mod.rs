//! Rigid parts that turn on joints while the object is filmed, from tracks through the frames of a
//! video whose poses are known.
//!
//! Tracks that no place in the body explains are looked at again: groups of neighbours, over a
//! short time, as points of a part that turns about an axis at some rate (`search`). What explains
//! most tracks is refined over all frames, with an angle for each (`joint`), and is a part if it
//! passes `is_part`.

mod grow;
mod joint;
mod posed;
mod search;
#[cfg(test)]
mod tests;

use crate::error::SfmError;
use crate::klt::{KltConfig, KltTrack, track};
use crate::statistics::median;
use glam::{DQuat, DVec3};
use grow::Growth;
use joint::{JointNoise, JointPath};
use posed::{PosedFrame, PosedTrack};
use scene::{FrameSet, Pose, Progress, Reconstruction};
use serde::{Deserialize, Serialize};

/// A track that leaves more than so many times the usual error as a part of the body is looked at.
/// Source: three standard deviations.
pub(super) const MOVING: f64 = 3.0;
/// Least noise of a track, pixels: that of exact tracks. Source: chosen by hand, never measured.
const LEAST_NOISE_PX: f64 = 0.02;
/// Parts that are looked for. Source: derived: more than any spacecraft turns at a time.
const MOST_PARTS: usize = 6;
/// What stays at one place in the picture for as long as it is followed is none of the object, or
/// a reflection: it goes less far than this, pixels. Source: chosen by hand, never measured.
const STAYS_PX: f64 = 2.0;

/// A part that turns on a joint.
#[derive(Clone, Debug, Serialize, Deserialize)]
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
}

/// What was found out about the parts of an object.
#[derive(Clone, Debug, Serialize, Deserialize)]
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
}

/// Looks for parts that move against the body. `model`: poses of (most of) the frames in the frame
/// of the body, and some of its points.
pub fn moving_parts(
    frames: &FrameSet,
    model: &Reconstruction,
    config: &KltConfig,
    seed: u64,
    progress: &Progress,
) -> Result<Articulation, SfmError> {
    let tracks = track(frames, config, progress)?;
    let unit = Unit::of(model);
    let by_name = |name: &String| {
        let image = model.images.values().find(|i| i.name == *name)?;
        let camera = model.cameras.get(&image.camera)?;
        Some(PosedFrame { pose: unit.pose(&image.pose), camera })
    };
    let names: Vec<String> = frames.frames.iter().map(|f| f.name.clone()).collect();
    let posed: Vec<Option<PosedFrame<'_>>> = names.iter().map(by_name).collect();
    let mut found = in_unit(&tracks, &posed, seed, progress)?;
    found.parts.iter_mut().for_each(|p| unit.restore(p));
    found.frames = names;
    Ok(found)
}

/// The object's middle and size, in which thresholds have a meaning.
struct Unit {
    middle: DVec3,
    size: f64,
}

impl Unit {
    fn of(model: &Reconstruction) -> Self {
        let along = |axis: usize| -> Vec<f64> { model.points.values().map(|p| p.position[axis]).collect() };
        let middle = DVec3::from([0, 1, 2].map(|axis| median(along(axis))));
        let mut away: Vec<f64> = model.points.values().map(|p| p.position.distance(middle)).collect();
        away.sort_by(f64::total_cmp);
        // Nine of ten points are the object's; some others are wrong.
        let radius = away.get(away.len() * 9 / 10).copied().unwrap_or(1.0);
        Self { middle, size: 2.0 * radius.max(f64::MIN_POSITIVE) }
    }

    fn pose(&self, pose: &Pose) -> Pose {
        Pose::new(pose.rotation, (pose.rotation * self.middle + pose.translation) / self.size)
    }

    fn restore(&self, part: &mut MovingPart) {
        let place = |p: [f64; 3]| (DVec3::from(p) * self.size + self.middle).to_array();
        part.place = place(part.place);
        part.points.iter_mut().for_each(|p| *p = place(*p));
        part.place_sigma *= self.size;
    }
}

/// The same where the object's size is 1.
fn in_unit(
    tracks: &[KltTrack],
    frames: &[Option<PosedFrame<'_>>],
    seed: u64,
    progress: &Progress,
) -> Result<Articulation, SfmError> {
    let all: Vec<PosedTrack<'_>> = tracks.iter().filter_map(|t| PosedTrack::new(t, frames)).collect();
    let errors: Vec<Option<f64>> = all.iter().map(|t| t.still().map(|s| s.1)).collect();
    let noise = median(errors.iter().copied().flatten().collect()).max(LEAST_NOISE_PX);
    let (mut rest, still): (Vec<usize>, Vec<usize>) =
        (0..all.len()).partition(|&i| errors[i].is_none_or(|e| e > MOVING * noise));
    let odd = rest.len();
    rest.retain(|&i| all[i].travel() > STAYS_PX && all[i].views.len() >= 8);
    let growth = Growth { all: &all, still: &still, noise, frames: frames.len(), seed };
    let mut paths = Vec::new();
    progress.begin("parts", MOST_PARTS);
    for k in 0..MOST_PARTS {
        progress.tick()?;
        let Some((path, own)) = growth.part(&rest, k as u64) else { break };
        rest.retain(|i| !own.contains(i));
        paths.push(path);
    }
    let parts = growth.shared_out(paths);
    let unexplained = odd - parts.iter().map(|p| p.1.len()).sum::<usize>();
    let mut parts: Vec<MovingPart> =
        parts.iter().filter_map(|(path, own)| part_of(path, own, &all, noise)).collect();
    parts.sort_by_key(|p| std::cmp::Reverse(p.observations));
    Ok(Articulation { frames: Vec::new(), parts, noise_px: noise, tracks: all.len(), unexplained })
}

/// What is told of a part whose tracks are these.
fn part_of(path: &JointPath, own: &[usize], all: &[PosedTrack<'_>], noise: f64) -> Option<MovingPart> {
    let tracks: Vec<&PosedTrack<'_>> = own.iter().map(|&i| &all[i]).collect();
    let noise = JointNoise { pixel: noise, bend: grow::bend(path) };
    let sigmas = path.sigmas(&tracks, &noise)?;
    let found: Vec<(DVec3, f64)> = tracks.iter().filter_map(|t| t.point(path)).collect();
    let middle = found.iter().map(|(x, _)| *x).sum::<DVec3>() / found.len().max(1) as f64;
    let rms = |squares: Vec<f64>| (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt();
    let still = tracks.iter().filter_map(|t| t.still()).map(|s| s.1 * s.1).collect();
    let observations = tracks.iter().map(|t| t.views.len()).sum();
    Some(MovingPart {
        axis: path.axis.to_array(),
        place: (path.place + path.axis * (middle - path.place).dot(path.axis)).to_array(),
        axis_sigma_deg: sigmas.axis.to_degrees(),
        place_sigma: sigmas.place,
        angles_deg: path.angles.iter().map(|a| a.to_degrees()).collect(),
        angle_sigmas_deg: sigmas.angles.iter().map(|a| a.to_degrees()).collect(),
        tracks: own.len(),
        observations,
        error_px: rms(found.iter().map(|(_, e)| e * e).collect()),
        still_error_px: rms(still),
        points: found.iter().map(|(x, _)| x.to_array()).collect(),
    })
}

impl MovingPart {
    /// The body's frame from that of the part at rest, in a frame of the video.
    pub fn pose(&self, frame: usize) -> Option<Pose> {
        let rotation =
            DQuat::from_axis_angle(DVec3::from(self.axis), self.angles_deg.get(frame)?.to_radians());
        let place = DVec3::from(self.place);
        Some(Pose::new(rotation, place - rotation * place))
    }
}
