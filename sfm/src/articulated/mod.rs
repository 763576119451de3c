//! Rigid parts that turn on joints while the object is filmed, from tracks through the frames of a
//! video whose poses are known.
//!
//! Tracks that no place in the body explains are looked at again: groups of neighbours, over a
//! short time, as points of a part that turns about an axis at some rate (`search`). What explains
//! most tracks is refined over all frames, with an angle for each (`joint`), and is a part if it
//! passes `is_part`.

mod adjust;
mod grow;
mod joint;
mod normal;
mod posed;
mod search;
#[cfg(test)]
mod tests;

use crate::error::SfmError;
use crate::klt::{KltConfig, KltTrack, track};
use crate::statistics::median;
use crate::triangulation::{PointView, nearest_to_rays, refine_point};
use adjust::{Chain, ChainNoise, Member, Tie};
use glam::{DQuat, DVec3};
use grow::Growth;
use joint::{JointPath, JointSigmas};
use posed::{PosedFrame, PosedTrack};
use rayon::prelude::*;
use scene::{FrameSet, Pose, Progress, Reconstruction, ScenePoint, TrackElement};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// A track that leaves more than so many times the usual error as a part of the body is looked at.
/// Source: three standard deviations.
pub(super) const MOVING: f64 = 3.0;
/// Least noise of a track, pixels: that of exact tracks. Source: chosen by hand, never measured.
const LEAST_NOISE_PX: f64 = 0.02;
/// Parts that are looked for. Source: derived: more than any spacecraft turns at a time.
const MOST_PARTS: usize = 6;
/// How often cameras, poses and joints are adjusted, and tracks shared out again.
const ADJUSTMENTS: usize = 4;
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
/// of the body, and some of its points. Also the model again, where parts were found: cameras and
/// poses as they follow from all parts together, and the points of the body alone.
pub fn moving_parts(
    frames: &FrameSet,
    model: &Reconstruction,
    config: &KltConfig,
    seed: u64,
    progress: &Progress,
) -> Result<(Articulation, Reconstruction), SfmError> {
    let tracks = track(frames, config, progress)?;
    let unit = Unit::of(model);
    let names: Vec<String> = frames.frames.iter().map(|f| f.name.clone()).collect();
    let numbers: Vec<u32> = model.cameras.keys().copied().collect();
    let by_name = |name: &String| {
        let image = model.images.values().find(|i| i.name == *name)?;
        Some((numbers.binary_search(&image.camera).ok()?, unit.pose(&image.pose)))
    };
    let chain = Chain {
        cameras: model.cameras.values().cloned().collect(),
        frames: names.iter().map(by_name).collect(),
        joints: Vec::new(),
        ties: Vec::new(),
        times: times(frames),
    };
    let (mut found, chain) = in_unit(&tracks, chain, seed, progress)?;
    found.parts.iter_mut().for_each(|p| unit.restore(p));
    let corrected = if found.parts.is_empty() {
        model.clone()
    } else {
        unit.corrected(model, &chain, &names, MOVING * found.noise_px)
    };
    found.frames = names;
    Ok((found, corrected))
}

/// When the frames were taken, as multiples of the usual time between two; by their numbers where
/// that is not known.
fn times(frames: &FrameSet) -> Arc<[f64]> {
    let numbers = || (0..frames.frames.len()).map(|k| k as f64).collect();
    let Some(known) = frames.times() else { return numbers() };
    let usual = median(known.windows(2).map(|w| w[1] - w[0]).collect());
    if usual > 0.0 { known.iter().map(|t| t / usual).collect() } else { numbers() }
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

    /// The model with the cameras and poses of the chain, without points that leave a greater error
    /// (pixels).
    fn corrected(
        &self,
        model: &Reconstruction,
        chain: &Chain,
        names: &[String],
        most: f64,
    ) -> Reconstruction {
        let mut next = model.clone();
        next.cameras.values_mut().zip(&chain.cameras).for_each(|(own, camera)| own.clone_from(camera));
        for image in next.images.values_mut() {
            let frame = names.iter().position(|n| *n == image.name).and_then(|k| chain.frames[k]);
            if let Some((_, pose)) = frame {
                let shift = pose.translation * self.size - pose.rotation * self.middle;
                image.pose = Pose::new(pose.rotation, shift);
            }
        }
        let (images, cameras) = (&next.images, &next.cameras);
        let placed = |point: &ScenePoint| -> Option<ScenePoint> {
            let view = |element: &TrackElement| {
                let image = &images[&element.image];
                let pixel = image.observations[element.observation as usize].pixel;
                PointView::new(&image.pose, &cameras[&image.camera], pixel)
            };
            let views: Vec<PointView<'_>> = point.track.iter().map(view).collect();
            let position = refine_point(nearest_to_rays(views.iter())?, views.iter(), 8);
            let errors = views.iter().map(|v| v.error_sq(position));
            let error_px = errors.clone().map(f64::sqrt).sum::<f64>() / views.len() as f64;
            let rms = (errors.sum::<f64>() / views.len() as f64).sqrt();
            (rms <= most).then(|| ScenePoint { position, error_px, ..point.clone() })
        };
        let points: BTreeMap<u64, ScenePoint> =
            next.points.iter().filter_map(|(id, p)| Some((*id, placed(p)?))).collect();
        for observation in next.images.values_mut().flat_map(|i| &mut i.observations) {
            observation.point = observation.point.filter(|p| points.contains_key(p));
        }
        next.points = points;
        next
    }

    fn restore(&self, part: &mut MovingPart) {
        let place = |p: [f64; 3]| (DVec3::from(p) * self.size + self.middle).to_array();
        part.place = place(part.place);
        part.points.iter_mut().for_each(|p| *p = place(*p));
        part.place_sigma *= self.size;
    }
}

/// The same where the object's size is 1, with cameras and poses that the parts corrected.
fn in_unit(
    tracks: &[KltTrack],
    mut chain: Chain,
    seed: u64,
    progress: &Progress,
) -> Result<(Articulation, Chain), SfmError> {
    let mut parts = {
        let frames = chain.posed();
        let scene = Scene::of(tracks, &frames);
        scene.growth(&chain.times, seed).found(scene.odd(), progress)?
    };
    for round in 0..ADJUSTMENTS {
        if parts.is_empty() {
            break;
        }
        progress.tick()?;
        chain = adjusted(tracks, &chain, &parts);
        if round + 1 < ADJUSTMENTS {
            let frames = chain.posed();
            let scene = Scene::of(tracks, &frames);
            parts = scene.growth(&chain.times, seed).shared_out(&chain.joints);
        }
    }
    let found = told(tracks, &chain, seed);
    Ok((found, chain))
}

/// What is told of the parts.
fn told(tracks: &[KltTrack], chain: &Chain, seed: u64) -> Articulation {
    let frames = chain.posed();
    let scene = Scene::of(tracks, &frames);
    let members = scene.members(&chain.joints, &chain.times);
    let sigmas = chain.sigmas(&members, &ChainNoise::of(chain, scene.worth)).unwrap_or_default();
    let growth = scene.growth(&chain.times, seed);
    let owned = growth.owned(&chain.joints).into_iter().zip(&sigmas);
    let parts = owned.filter(|((path, own), _)| growth.is_part(path, own));
    let mut parts: Vec<MovingPart> =
        parts.map(|((path, own), sigmas)| part_of(&path, &own, &scene.all, sigmas)).collect();
    parts.sort_by_key(|p| std::cmp::Reverse(p.observations));
    Articulation {
        frames: Vec::new(),
        parts,
        noise_px: scene.noise,
        tracks: scene.all.len(),
        unexplained: scene.all.len() - members.len(),
    }
}

/// Cameras, body and joints together; joints are tied to each other where that has more evidence.
fn adjusted(tracks: &[KltTrack], chain: &Chain, parts: &[(JointPath, Vec<usize>)]) -> Chain {
    let frames = chain.posed();
    let scene = Scene::of(tracks, &frames);
    let paths: Vec<JointPath> = parts.iter().map(|p| p.0.clone()).collect();
    let members = scene.members(&paths, &chain.times);
    let ties = vec![Tie::default(); paths.len()];
    let start = Chain { joints: paths, ties, ..chain.clone() };
    let noise = ChainNoise::of(&start, scene.worth);
    let (mut best, mut evidence) = start.adjusted(&members, &noise);
    for (j, leader) in (1..best.joints.len()).flat_map(|j| (0..j).map(move |i| (j, i))) {
        if best.ties[j].axis_of.is_some() {
            continue;
        }
        for ratio in [None, Some(1.0), Some(-1.0)] {
            let tied = best.tied(j, Tie { axis_of: Some(leader), ratio });
            let (found, own) = tied.adjusted(&members, &noise);
            if own > evidence {
                (best, evidence) = (found, own);
            }
        }
    }
    best
}

/// The tracks under some poses.
struct Scene<'a> {
    all: Vec<PosedTrack<'a>>,
    /// What each was made of.
    of: Vec<&'a KltTrack>,
    /// Those that the body explains.
    still: Vec<usize>,
    noise: f64,
    /// The standard deviation that observations would have, were they independent and worth as
    /// much: a tracker's errors add up along a track.
    worth: f64,
}

impl<'a> Scene<'a> {
    fn of(tracks: &'a [KltTrack], frames: &'a [Option<PosedFrame<'a>>]) -> Self {
        let pairs = tracks.iter().filter_map(|t| Some((PosedTrack::new(t, frames)?, t)));
        let (all, of): (Vec<PosedTrack<'_>>, Vec<&KltTrack>) = pairs.unzip();
        let errors: Vec<Option<f64>> = all.par_iter().map(|t| t.still().map(|s| s.1)).collect();
        let noise = median(errors.iter().copied().flatten().collect()).max(LEAST_NOISE_PX);
        let is_still = |&i: &usize| errors[i].is_some_and(|e| e <= MOVING * noise);
        let still: Vec<usize> = (0..all.len()).filter(is_still).collect();
        let sums = still.par_iter().filter_map(|&i| Some(all[i].correlation(all[i].still()?.0)));
        let sums = sums.reduce(|| [0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
        let rho = (sums[0] / sums[1].max(f64::MIN_POSITIVE)).clamp(0.0, 0.9);
        let worth = noise * ((1.0 + rho) / (1.0 - rho)).sqrt();
        Self { all, of, still, noise, worth }
    }

    /// Tracks that the body or a joint explains.
    fn members(&self, joints: &[JointPath], times: &Arc<[f64]>) -> Vec<Member<'a>> {
        let assigned = self.growth(times, 0).assigned(joints);
        assigned.into_iter().map(|(i, joint)| Member { track: self.of[i], joint }).collect()
    }

    /// Tracks that the body does not explain and that may be a part's.
    fn odd(&self) -> Vec<usize> {
        let may = |i: &usize| {
            let track = &self.all[*i];
            self.still.binary_search(i).is_err() && track.travel() > STAYS_PX && track.views.len() >= 8
        };
        (0..self.all.len()).filter(may).collect()
    }

    fn growth<'t>(&'t self, times: &'t Arc<[f64]>, seed: u64) -> Growth<'t, 'a> {
        Growth { all: &self.all, still: &self.still, noise: self.noise, worth: self.worth, times, seed }
    }
}

impl Growth<'_, '_> {
    /// Parts among the tracks `rest`.
    fn found(
        &self,
        mut rest: Vec<usize>,
        progress: &Progress,
    ) -> Result<Vec<(JointPath, Vec<usize>)>, SfmError> {
        let mut paths = Vec::new();
        progress.begin("parts", MOST_PARTS);
        for k in 0..MOST_PARTS {
            progress.tick()?;
            let Some((path, own)) = self.part(&rest, k as u64) else { break };
            rest.retain(|i| !own.contains(i));
            paths.push(path);
        }
        Ok(self.shared_out(&paths))
    }
}

impl Chain {
    fn posed(&self) -> Vec<Option<PosedFrame<'_>>> {
        let posed =
            |f: &Option<(usize, Pose)>| f.map(|(c, pose)| PosedFrame { pose, camera: &self.cameras[c] });
        self.frames.iter().map(posed).collect()
    }
}

/// What is told of a part whose tracks are these.
fn part_of(path: &JointPath, own: &[usize], all: &[PosedTrack<'_>], sigmas: &JointSigmas) -> MovingPart {
    let tracks: Vec<&PosedTrack<'_>> = own.iter().map(|&i| &all[i]).collect();
    let found: Vec<(DVec3, f64)> = tracks.iter().filter_map(|t| t.point(path)).collect();
    let middle = found.iter().map(|(x, _)| *x).sum::<DVec3>() / found.len().max(1) as f64;
    let rms = |squares: Vec<f64>| (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt();
    let still = tracks.iter().filter_map(|t| t.still()).map(|s| s.1 * s.1).collect();
    let observations = tracks.iter().map(|t| t.views.len()).sum();
    MovingPart {
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
    }
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
