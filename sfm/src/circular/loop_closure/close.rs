//! The angles of a video that shows a whole turn, stretched so that it closes.

use super::photometric::{self, PhotometricClosure};
use super::tracks::LoopClosure;
use crate::SfmError;
use crate::circular::initialize::key_frames::{KeyFrames, VideoTracks};
use crate::circular::model::{AxisModel, CircularContext};
use crate::circular::motion::{CircularMotion, wrap_angle};
use crate::circular::problem::Relation;
use crate::circular::register::resect_angle;
use crate::circular::video::VideoJob;
use crate::klt::KltTrack;
use crate::skip::StepName;
use crate::statistics::median;
use scene::{Camera, TwoViewGeometry};
use std::f64::consts::TAU;

/// Whole turns are closed where the first and the last frame are at least so far apart, radians.
const CLOSED_FROM: f64 = 5.2;
/// Search for the error of a closed turn by matched pairs, radians to either side.
const PAIR_SPAN: f64 = 0.2;
/// Angles across the loop closure that agree differ by less from their median, radians.
const AGREE_WITHIN: f64 = 0.01;

/// Errors of steps are evened out over so much of a turn on either side, radians.
const EVEN_WITHIN: f64 = 0.3;

/// Followed points and features together, and the turn they are to be adjusted from.
pub(crate) struct ClosedVideo {
    pub material: VideoTracks,
    pub turn: CircularMotion,
    pub cameras: Vec<Camera>,
    /// What photometric similarity says of the angle between the first and the last frame.
    pub closing: Option<Relation>,
    /// What was found at the loop closure, for the report.
    pub closure: String,
}

impl VideoJob<'_> {
    /// Joins followed points and features; where a whole turn brings first and last frames together, the angles are
    /// stretched so that it closes.
    pub(crate) fn close(
        &self,
        keys: &KeyFrames,
        tracks: &[KltTrack],
        model: AxisModel,
    ) -> Result<ClosedVideo, SfmError> {
        let open = VideoTracks::of_both(&keys.features, &keys.near, tracks);
        let input = self.input(&open);
        let cameras = model.state.cameras.clone();
        let times = self.times();
        let context = self.context(&input, &cameras, &times);
        let mut joined = AxisModel::new(&input, cameras.clone(), model.turn.clone());
        joined.settle_with(&context, 2, 60, joined.freedom_by_range())?;
        let angles: Vec<f64> = joined.turn.angles.iter().flatten().copied().collect();
        let range =
            angles.iter().copied().fold(f64::MIN, f64::max) - angles.iter().copied().fold(f64::MAX, f64::min);
        let unclosed = |material: VideoTracks, joined: AxisModel, why: &str| {
            let closure = format!("{:.1}° were turned, {why}", range.to_degrees());
            let closing = None;
            Ok(ClosedVideo { material, turn: joined.turn, cameras: joined.state.cameras, closing, closure })
        };
        if range < CLOSED_FROM {
            return unclosed(open, joined, "no loop closure");
        }
        let followed =
            LoopClosure::follow(self.frames, &joined.turn.angles, &self.config.klt, self.progress)?;
        let matched = keys.closure.iter().filter_map(|g| self.closure_error(&joined, &context, g)).collect();
        let seen = agree_on_gap([followed.gaps(&joined), matched]);
        let alike = self.photometric_closure(&joined.turn.angles);
        // Ties that contradict what the pictures as a whole show are wrong ones.
        let seen = seen
            .filter(|s| alike.is_none_or(|a| (s.0 * TAU + a.excess).abs() < AGREE_WITHIN + 3.0 * a.sigma));
        let (_, by_points, by_pairs) = seen.unwrap_or_default();
        let Some(stretch) = alike.map(|a| -a.excess / TAU).or(seen.map(|s| s.0)) else {
            return unclosed(open, joined, "the loop closure is not seen");
        };
        joined.turn.angles.iter_mut().flatten().for_each(|a| *a *= 1.0 + stretch);
        let closing = alike.and_then(|a| closing_relation(&joined.turn.angles, a.sigma * range / TAU));
        let mut geometries = keys.near.clone();
        geometries.extend(keys.closure.iter().filter(|_| by_pairs > 0).cloned());
        let mut material = VideoTracks::of_both(&keys.features, &geometries, tracks);
        if by_points > 0 {
            followed.tracks.iter().for_each(|t| material.add(t.iter().copied()));
        }
        let by_similarity = alike
            .map_or(String::new(), |a| format!(", photometric similarity to {:.3}°", a.sigma.to_degrees()));
        let closure = format!(
            "{:.1}° were turned, {} points followed across the loop closure to {by_points} frames and {by_pairs} pairs{by_similarity} closed it by {:.2}°",
            range.to_degrees(),
            followed.tracks.len(),
            (stretch * range).abs().to_degrees()
        );
        Ok(ClosedVideo { material, turn: joined.turn, cameras: joined.state.cameras, closing, closure })
    }

    /// The angle between the first and the last frame by photometric similarity, and its standard deviation.
    pub(crate) fn range_by_similarity(&self, angles: &[Option<f64>]) -> Option<(f64, f64)> {
        let alike = self.photometric_closure(angles)?;
        let (first, last) = (angles.iter().flatten().next()?, angles.iter().flatten().last()?);
        let range = last - first;
        Some((range * (1.0 - alike.excess / TAU), alike.sigma * range.abs() / TAU))
    }

    /// What the pictures of all frames of the video say of a whole turn, given the angles of the chosen ones.
    fn photometric_closure(&self, angles: &[Option<f64>]) -> Option<PhotometricClosure> {
        if self.config.skip.contains(&StepName::PhotometricClosure) {
            return None;
        }
        let film = self.frames.film.as_ref()?;
        let known: Vec<(f64, f64)> =
            self.frames.frames.iter().zip(angles).filter_map(|(f, a)| Some((f.time_s?, (*a)?))).collect();
        let (first, last) = (known.first()?.1, known.get(1..)?.last()?.1);
        let sense = (last - first).signum();
        let steps = known.windows(2).map(|w| w[1].0 - w[0].0).collect();
        let beyond = 1.5 * median(steps);
        let risen: Vec<(f64, f64)> = known.iter().map(|k| (k.0, sense * (k.1 - first))).collect();
        let found = |known: &[(f64, f64)]| photometric::excess(film, |time| between(known, time, beyond));
        // Steps as they were found, or evened out: whichever orders the pictures better.
        let both = [found(&risen), found(&even_out(&risen))];
        both.into_iter().flatten().min_by(|a, b| a.sigma.total_cmp(&b.sigma))
    }

    /// By how much the angle between two frames on either side of the loop closure is too small, and that angle: points that
    /// the one sees, found in the other.
    fn closure_error(
        &self,
        model: &AxisModel,
        context: &CircularContext<'_>,
        g: &TwoViewGeometry,
    ) -> Option<(f64, f64)> {
        let (a, b) = (model.turn.angles[g.a]?, model.turn.angles[g.b]?);
        let place = |m: &[u32; 2]| {
            let track = context.input.tracks.of[g.a][m[0] as usize];
            let point = *model.state.of_track.get(track as usize)?.first()?;
            let x = model.state.points[point as usize].as_ref()?.position;
            Some((context.input.keypoints[g.b][m[1] as usize], x))
        };
        let seen: Vec<_> = g.inliers.iter().filter_map(place).collect();
        if seen.len() < 8 {
            return None;
        }
        let found = resect_angle(&model.state.cameras[0], &model.turn.axis, &seen, b, PAIR_SPAN);
        (found.inliers >= 8 && found.inliers * 2 >= found.asked).then(|| (wrap_angle(found.angle - b), b - a))
    }
}

/// Each angle as the line through its neighbours has it.
fn even_out(known: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let at = |&(time, angle): &(f64, f64)| {
        let near: Vec<(f64, f64)> = known
            .iter()
            .filter(|k| (k.1 - angle).abs() <= EVEN_WITHIN)
            .map(|k| (k.0 - time, k.1 - angle))
            .collect();
        let n = near.len() as f64;
        let mean = |f: &dyn Fn(&(f64, f64)) -> f64| near.iter().map(f).sum::<f64>() / n;
        let (t, a) = (mean(&|p| p.0), mean(&|p| p.1));
        let (tt, ta) = (mean(&|p| (p.0 - t).powi(2)), mean(&|p| (p.0 - t) * (p.1 - a)));
        (time, if tt > 0.0 { angle + a - t * ta / tt } else { angle })
    };
    known.iter().map(at).collect()
}

/// The angle at a time, between those that are known or up to `beyond` outside of them; both rise or fall.
fn between(known: &[(f64, f64)], time: f64, beyond: f64) -> Option<f64> {
    let i = known.partition_point(|k| k.0 <= time).clamp(1, known.len() - 1);
    let (a, b) = (known.get(i - 1)?, known.get(i)?);
    let outside = (known[0].0 - time).max(time - known[known.len() - 1].0);
    (outside <= beyond && b.0 > a.0).then(|| a.1 + (time - a.0) / (b.0 - a.0) * (b.1 - a.1))
}

/// That the angle between the first and the last frame is what it is now.
fn closing_relation(angles: &[Option<f64>], sigma: f64) -> Option<Relation> {
    let (first, last) = (angles.iter().position(Option::is_some)?, angles.iter().rposition(Option::is_some)?);
    Some(Relation {
        frames: [Some(first as u32), Some(last as u32), None],
        coefficients: [-1.0, 1.0, 0.0],
        target: angles[last]? - angles[first]?,
        sigma,
    })
}

/// By what share the angles are too small as most of the gaps say (see [`LoopClosure::gaps`]; of followed points, and of
/// matched pairs), and how many of either agree; `None` where they do not.
fn agree_on_gap(gaps: [Vec<(f64, f64)>; 2]) -> Option<(f64, usize, usize)> {
    let middle = median(gaps.iter().flatten().map(|g| g.0).collect());
    let near = |g: &&(f64, f64)| (g.0 - middle).abs() < AGREE_WITHIN;
    let agreeing: Vec<&(f64, f64)> = gaps.iter().flatten().filter(near).collect();
    if agreeing.len() < 2 || agreeing.len() * 2 < gaps.iter().flatten().count() {
        return None;
    }
    let stretch = agreeing.iter().map(|g| g.0 / g.1).sum::<f64>() / agreeing.len() as f64;
    let of = |i: usize| gaps[i].iter().filter(near).count();
    Some((stretch, of(0), of(1)))
}
