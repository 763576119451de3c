//! The angles of a video that shows a whole turn, stretched so that it closes.

use super::photometric::{self, PhotometricClosure};
use super::tracks::{LoopClosure, LoopGap};
use crate::circular::initialize::key_frames::{KeyFrames, VideoTracks};
use crate::circular::job::VideoJob;
use crate::circular::limits::{COMPARABLE, LEAST_OBSERVATIONS, NEARBY, is_majority};
use crate::circular::model::AxisModel;
use crate::circular::motion::{CircularMotion, wrap_angle};
use crate::circular::prior::AnglePrior;
use crate::circular::problem::Relation;
use crate::circular::register::resect_angle;
use crate::error::SfmError;
use crate::incremental::state::MappingInput;
use crate::klt::KltTrack;
use crate::skip::StepName;
use crate::statistics::median;
use glam::DVec2;
use scene::decision::{Decision, Measurement, Quantity, Remark, Rule, Subject};
use scene::{Camera, TwoViewGeometry};
use std::f64::consts::TAU;

/// Angles across the loop closure that agree differ by less from their median, radians.
/// Source: derived; ten times what matches of one pair leave of an angle (docs/decisions/10).
const AGREE_WITHIN: f64 = 0.01;

/// Followed points and features together, and the turn they are to be adjusted from.
pub(crate) struct ClosedVideo {
    pub material: VideoTracks,
    pub turn: CircularMotion,
    pub cameras: Vec<Camera>,
    /// What photometric similarity says of the angle between the first and the last frame.
    pub closing: Option<Relation>,
    /// What was found at the loop closure, for the report.
    pub closure: Decision,
}

/// What is known of a loop closure.
#[derive(Default)]
struct LoopEvidence {
    /// Points followed across it.
    followed: LoopClosure,
    /// What most of the frames and pairs agree on.
    agreed: Option<AgreedGap>,
    /// What the pictures as a whole show.
    photometric: Option<PhotometricClosure>,
}

/// By what share the angles are too small, and on how many frames and matched pairs that stands.
#[derive(Clone, Copy, Default)]
struct AgreedGap {
    stretch: f64,
    frames: usize,
    pairs: usize,
}

impl LoopEvidence {
    /// By what share the angles are too small.
    fn stretch(&self) -> Option<f64> {
        self.photometric.map(|a| -a.excess / TAU).or(self.agreed.map(|a| a.stretch))
    }
}

impl VideoJob<'_> {
    /// Joins followed points and features; where a whole turn brings first and last frames
    /// together, the angles are stretched so that it closes.
    pub(crate) fn close(
        &self,
        keys: &KeyFrames,
        tracks: &[KltTrack],
        model: AxisModel,
    ) -> Result<ClosedVideo, SfmError> {
        let mut material = VideoTracks::of_both(&keys.features, &keys.near, tracks);
        let input = self.input(&material);
        let joined = self.join(&input, model)?;
        let [low, high] = joined.extent();
        let range = high - low;
        let mut closure = Decision::new(Subject::VideoMotion, true, Rule::Evidence)
            .measured(Quantity::RotationRange, range.to_degrees());
        let evidence = if range < TAU - 2.0 * COMPARABLE {
            LoopEvidence::default()
        } else {
            self.loop_evidence(keys, &input, &joined)?
        };
        let AxisModel { mut turn, state, .. } = joined;
        let Some(stretch) = evidence.stretch() else {
            let why = if range < TAU - 2.0 * COMPARABLE { Remark::NoLoop } else { Remark::LoopNotObserved };
            let closure = closure.remarked(why);
            return Ok(ClosedVideo { material, turn, cameras: state.cameras, closing: None, closure });
        };
        turn.angles.iter_mut().flatten().for_each(|a| *a *= 1.0 + stretch);
        let LoopEvidence { followed, agreed, photometric } = evidence;
        let closing = photometric.and_then(|a| closing_relation(&turn.angles, a.sigma * range / TAU));
        let AgreedGap { frames, pairs, .. } = agreed.unwrap_or_default();
        if pairs > 0 {
            let geometries = [keys.near.as_slice(), keys.closure.as_slice()].concat();
            material = VideoTracks::of_both(&keys.features, &geometries, tracks);
        }
        if frames > 0 {
            followed.tracks.iter().for_each(|t| material.add(t.iter().copied()));
        }
        closure = closure.with_all([
            Measurement::count(Quantity::LoopPoints, followed.tracks.len()),
            Measurement::count(Quantity::LoopFrames, frames),
            Measurement::count(Quantity::LoopPairs, pairs),
            Measurement::new(Quantity::LoopCorrection, (stretch * range).abs().to_degrees()),
        ]);
        if let Some(photometric) = photometric {
            closure = closure.measured(Quantity::LoopDeviation, photometric.sigma.to_degrees());
        }
        Ok(ClosedVideo { material, turn, cameras: state.cameras, closing, closure })
    }

    /// The model with features as well, adjusted.
    fn join(&self, input: &MappingInput<'_>, model: AxisModel) -> Result<AxisModel, SfmError> {
        let times = self.times();
        let priors = [AnglePrior::Steady { times: &times }];
        let cameras = model.state.cameras;
        let mut joined = AxisModel::new(input, cameras.clone(), model.turn);
        let context = self.context(input, &cameras, &priors);
        joined.settle_with(&context, 2, 60, joined.freedom_by_range())?;
        Ok(joined)
    }

    /// Points, pairs and pictures across the loop closure.
    fn loop_evidence(
        &self,
        keys: &KeyFrames,
        input: &MappingInput<'_>,
        joined: &AxisModel,
    ) -> Result<LoopEvidence, SfmError> {
        let angles = &joined.turn.angles;
        let followed = LoopClosure::follow(self.frames, angles, &self.config.klt, self.progress)?;
        let matched: Vec<LoopGap> =
            keys.closure.iter().filter_map(|g| closure_error(joined, input, g)).collect();
        let photometric = self.photometric_closure(angles);
        let mut agreed = agree_on_gap(&followed.gaps(joined), &matched);
        if let (Some(a), Some(p)) = (agreed, photometric) {
            // Ties that contradict what the pictures as a whole show are wrong ones.
            agreed = agreed.filter(|_| (a.stretch * TAU + p.excess).abs() < AGREE_WITHIN + 3.0 * p.sigma);
        }
        Ok(LoopEvidence { followed, agreed, photometric })
    }

    /// The angle between the first and the last frame by photometric similarity, and its standard
    /// deviation.
    pub(crate) fn range_by_similarity(&self, angles: &[Option<f64>]) -> Option<(f64, f64)> {
        let found = self.photometric_closure(angles)?;
        let (first, last) = (angles.iter().flatten().next()?, angles.iter().flatten().last()?);
        let range = last - first;
        Some((range * (1.0 - found.excess / TAU), found.sigma * range.abs() / TAU))
    }

    /// What the pictures of all frames of the video say of a whole turn, given the angles of the
    /// chosen ones.
    fn photometric_closure(&self, angles: &[Option<f64>]) -> Option<PhotometricClosure> {
        if self.config.skip.contains(&StepName::PhotometricClosure) {
            return None;
        }
        let film = self.frames.film.as_ref()?;
        let mut known = Vec::new();
        for (frame, angle) in self.frames.frames.iter().zip(angles) {
            known.extend(frame.time_s.zip(*angle).map(|(time, angle)| TimedAngle { time, angle }));
        }
        let (first, last) = (known.first()?.angle, known.get(1..)?.last()?.angle);
        let sense = (last - first).signum();
        known.iter_mut().for_each(|k| k.angle = sense * (k.angle - first));
        let beyond = 1.5 * median(known.windows(2).map(|w| w[1].time - w[0].time).collect());
        // Steps as they were found, or evened out: whichever orders the pictures better.
        let both = [even_out(&known), known];
        let found = both.map(|known| photometric::excess(film, |time| between(&known, time, beyond)));
        found.into_iter().rev().flatten().min_by(|a, b| a.sigma.total_cmp(&b.sigma))
    }
}

/// The angle of a frame of a video and when it was taken, radians and seconds.
#[derive(Clone, Copy, Debug)]
struct TimedAngle {
    time: f64,
    angle: f64,
}

/// By how much the angle between two frames on either side of the loop closure is too small: points
/// that the one sees, found in the other.
fn closure_error(model: &AxisModel, input: &MappingInput<'_>, g: &TwoViewGeometry) -> Option<LoopGap> {
    let (a, b) = (model.turn.angles[g.a]?, model.turn.angles[g.b]?);
    let mut seen = Vec::new();
    for m in &g.inliers {
        let track = input.tracks.of[g.a][m[0] as usize];
        let point = model.state.of_track.get(track as usize).and_then(|points| points.first());
        if let Some(point) = point.and_then(|p| model.state.points[*p as usize].as_ref()) {
            seen.push((input.keypoints[g.b][m[1] as usize], point.position));
        }
    }
    if seen.len() < LEAST_OBSERVATIONS {
        return None;
    }
    let found = resect_angle(&model.state.cameras[0], &model.turn.axis, &seen, b, NEARBY);
    (found.inliers >= LEAST_OBSERVATIONS && is_majority(found.inliers, found.asked))
        .then(|| LoopGap { missing: wrap_angle(found.angle - b), angle: b - a })
}

/// Each angle as the line through its neighbours has it.
fn even_out(known: &[TimedAngle]) -> Vec<TimedAngle> {
    let mut evened = Vec::with_capacity(known.len());
    for own in known {
        let near: Vec<DVec2> = known
            .iter()
            .filter(|k| (k.angle - own.angle).abs() <= NEARBY)
            .map(|k| DVec2::new(k.time - own.time, k.angle - own.angle))
            .collect();
        let mean = near.iter().sum::<DVec2>() / near.len() as f64;
        let squares = near.iter().map(|p| (p.x - mean.x).powi(2)).sum::<f64>() / near.len() as f64;
        let products = near.iter().map(|p| (p.x - mean.x) * (p.y - mean.y)).sum::<f64>() / near.len() as f64;
        let angle = if squares > 0.0 { own.angle + mean.y - mean.x * products / squares } else { own.angle };
        evened.push(TimedAngle { angle, ..*own });
    }
    evened
}

/// The angle at a time, between those that are known or up to `beyond` outside of them; both rise
/// or fall.
fn between(known: &[TimedAngle], time: f64, beyond: f64) -> Option<f64> {
    let i = known.partition_point(|k| k.time <= time).clamp(1, known.len() - 1);
    let (a, b) = (known.get(i - 1)?, known.get(i)?);
    let outside = (known[0].time - time).max(time - known[known.len() - 1].time);
    (outside <= beyond && b.time > a.time)
        .then(|| a.angle + (time - a.time) / (b.time - a.time) * (b.angle - a.angle))
}

/// That the angle between the first and the last frame is what it is now.
fn closing_relation(angles: &[Option<f64>], sigma: f64) -> Option<Relation> {
    let (first, last) = (angles.iter().position(Option::is_some)?, angles.iter().rposition(Option::is_some)?);
    Some(Relation::difference(first, last, angles[last]? - angles[first]?, sigma))
}

/// What most of the gaps of followed points and of matched pairs say; `None` where they do not
/// agree.
fn agree_on_gap(of_points: &[LoopGap], of_pairs: &[LoopGap]) -> Option<AgreedGap> {
    let all = [of_points, of_pairs].concat();
    let middle = median(all.iter().map(|g| g.missing).collect());
    let agreeing = all.iter().filter(|g| is_near(g, middle));
    let shares: Vec<f64> = agreeing.map(|g| g.missing / g.angle).collect();
    (shares.len() >= 2 && is_majority(shares.len(), all.len())).then(|| AgreedGap {
        stretch: shares.iter().sum::<f64>() / shares.len() as f64,
        frames: of_points.iter().filter(|g| is_near(g, middle)).count(),
        pairs: of_pairs.iter().filter(|g| is_near(g, middle)).count(),
    })
}

fn is_near(gap: &LoopGap, middle: f64) -> bool {
    (gap.missing - middle).abs() < AGREE_WITHIN
}
