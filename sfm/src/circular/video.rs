//! Turns in videos: tracks, a seed, growth along the frames, the loop closure of a whole turn, the last adjustment.

use super::evidence::Comparison;
use super::initialize::key_frames::{KeyFrames, VideoTracks, drop_still};
use super::initialize::seed::{KEYS, KeyPair, Seed, explained_share, seeds, steady};
use super::loop_closure::photometric::{self, PhotometricClosure};
use super::loop_closure::tracks::LoopClosure;
use super::model::{AxisModel, CircularContext};
use super::motion::{CircularMotion, median, wrap_angle};
use super::prior::{known_rate, learn_motion};
use super::problem::Relation;
use super::register::resect_angle;
use super::{
    CircularSolution, Motion, MotionInput, ROUNDS, ROUNDS_BEFORE, adjust_and_choose, decision, finish,
};
use crate::Knowledge;
use crate::incremental::resection::FOCAL_FACTORS;
use crate::incremental::state::MappingInput;
use crate::klt::{KltTrack, track};
use crate::{Decision, SfmConfig, SfmError};
use glam::DVec2;
use scene::{Camera, Features, FrameSet, Progress, TwoViewGeometry};
use std::f64::consts::TAU;

/// Motion between two key frames of the seed, as a share of the longer image side.
const KEY_MOTION: f64 = 0.012;
/// Share of it that is still enough where tracks do not last until they have moved as far.
const KEY_MOTION_LEAST: f64 = 0.25;
/// Least share of the matches that a seed must explain.
const EXPLAINED: f64 = 0.5;
/// Least share of the frames that must get an angle where the evidence decides.
const REGISTERED: f64 = 0.8;
/// Whole turns are closed where the first and the last frame are at least so far apart, radians.
const SEAM_FROM: f64 = 5.2;
/// Search for the error of a closed turn by matched pairs, radians to either side.
const SEAM_SPAN: f64 = 0.2;
/// Angles across the loop closure that agree differ by less from their median, radians.
const SEAM_AGREES: f64 = 0.01;

/// Errors of steps are evened out over so much of a turn on either side, radians.
const EVENED: f64 = 0.3;

/// What a video is solved with.
pub(crate) struct VideoJob<'a> {
    pub frames: &'a FrameSet,
    pub config: &'a SfmConfig,
    pub cameras: &'a [Camera],
    pub camera_of: &'a [usize],
    pub known: &'a [Knowledge],
    pub progress: &'a Progress,
}

/// A model about one axis with the keypoints it refers to.
pub(crate) struct VideoModel {
    pub solution: CircularSolution,
    pub keypoints: Vec<Vec<DVec2>>,
    pub features: Vec<Features>,
    pub geometries: Vec<TwoViewGeometry>,
    pub matched: usize,
}

/// Followed points and features together, and the turn they are to be adjusted from.
struct ClosedVideo {
    material: VideoTracks,
    turn: CircularMotion,
    cameras: Vec<Camera>,
    /// What photometric similarity says of the angle between the first and the last frame.
    closing: Option<Relation>,
    /// What was found at the loop closure, for the report.
    closure: String,
}

/// Where a model grows from: key frames, `stride` apart from the `first`, and what may be their motion.
struct VideoStart {
    first: usize,
    stride: usize,
    keys: usize,
    seeds: Vec<Seed>,
}

/// The model of a video in which something turns about one axis; else the reason why it is none.
pub(crate) fn solve_video(job: &VideoJob<'_>) -> Result<Result<(VideoModel, Decision), String>, SfmError> {
    if job.cameras.len() != 1 || job.frames.len() < 4 {
        return Ok(Err("fewer than four frames, or more than one camera".to_owned()));
    }
    let mut tracks = track(job.frames, &job.config.klt, job.progress)?;
    let still = drop_still(&mut tracks);
    let note = format!("{} points were followed, {still} more stand still", tracks.len());
    let n = job.frames.len();
    let material = VideoTracks::of_klt(&tracks, n);
    let input = job.input(&material);
    let model = match job.grow(&input, &tracks)? {
        Ok(model) => model,
        Err(why) => return Ok(Err(format!("{note}; {why}"))),
    };
    let config = job.config;
    let keys = KeyFrames::new(job.frames, &model, &config.sift, &config.matching, job.progress)?;
    let ClosedVideo { material, turn, cameras, closing, closure } = job.close(&keys, &tracks, model)?;
    let input = job.input(&material);
    let counts: Vec<usize> = keys.features.iter().map(Features::len).collect();
    let free_job = MotionInput {
        input: &input,
        cameras: job.cameras,
        known: job.known,
        starts: &cameras,
        named: config.camera_model.model(),
        config: &config.motion,
        features: &counts,
        room: Some(job.frames),
        progress: job.progress,
    };
    let times = job.times();
    let rate = config.motion.known_rate.map(f64::to_radians);
    let relations = rate.map_or(Vec::new(), |r| known_rate(&turn.angles, &times, r));
    let mut context = CircularContext { times: &times, closing, ..free_job.context(&relations) };
    let Some((mut model, intrinsics, camera)) =
        adjust_and_choose(&context, &free_job, &cameras, turn, ROUNDS_BEFORE)?
    else {
        return Ok(Err(format!("{note}; the tracks and key frames do not agree on one axis")));
    };
    let comparison = Comparison::of(Some(&model), &model.state, &context, intrinsics)?;
    let figures =
        comparison.as_ref().map_or("too few observations to compare".to_owned(), Comparison::describe);
    let evidence = format!("{note}; {closure}; {figures}");
    let registered = model.state.registered_count();
    let single = comparison.is_some_and(|c| c.favours_single()) && registered as f64 >= REGISTERED * n as f64;
    if config.motion.motion == Motion::Auto && !single {
        return Ok(Err(format!("one axis was tried: {registered} of {n} frames; {evidence}")));
    }
    let motion = match model.covariance(&context, intrinsics)? {
        Some((_, images, c)) if rate.is_none() => {
            let learn = |closing| learn_motion(&model.turn.angles, &times, &images, &c, closing);
            let first = learn(None);
            // With angles that are nearly right, photometric similarity says more.
            let range = first.as_ref().and_then(|l| job.range_by_similarity(&l.by_frame(n)));
            range.and_then(|r| learn(Some(r))).or(first)
        }
        _ => None,
    };
    let (held, loose) =
        motion.as_ref().map(|l| (l.holding_relations(), l.loose_relations())).unwrap_or_default();
    if motion.is_some() {
        (context.relations, context.closing) = (&held, None);
    }
    model.polish(&context, intrinsics, ROUNDS)?;
    if motion.is_some() {
        context.relations = &loose;
    }
    let excess = motion.as_ref().map_or(1.0, |l| l.excess);
    let mut solution = finish(&mut model, &context, &free_job, intrinsics, (camera, excess))?;
    solution.decisions.extend(motion.map(|l| l.decision));
    Ok(Ok((job.into_video_model(solution, material, keys), decision("single-axis", evidence))))
}

impl VideoJob<'_> {
    pub(crate) fn input<'a>(&'a self, material: &'a VideoTracks) -> MappingInput<'a> {
        MappingInput {
            sigmas: &[],
            keypoints: &material.keypoints,
            tracks: &material.tracks,
            camera_of: self.camera_of,
            geometries: &[],
            config: &self.config.mapper,
            may_be_rotated: false,
            seed: self.config.seed,
        }
    }

    fn into_video_model(
        &self,
        solution: CircularSolution,
        material: VideoTracks,
        keys: KeyFrames,
    ) -> VideoModel {
        let mut geometries = keys.near;
        geometries.extend(keys.closure);
        geometries.sort_by_key(|g| (g.a, g.b));
        VideoModel {
            solution,
            keypoints: material.keypoints,
            features: keys.features,
            geometries,
            matched: keys.matched,
        }
    }

    /// Presentation times, or the frames' numbers where they are not known.
    fn times(&self) -> Vec<f64> {
        let times: Vec<f64> = self.frames.frames.iter().filter_map(|f| f.time_s).collect();
        let ascending = times.windows(2).all(|w| w[1] > w[0]);
        if times.len() == self.frames.len() && ascending {
            times
        } else {
            (0..self.frames.len()).map(|i| i as f64).collect()
        }
    }

    /// From followed points alone: the best seed, grown over the whole video.
    pub(crate) fn grow(
        &self,
        input: &MappingInput<'_>,
        tracks: &[KltTrack],
    ) -> Result<Result<AxisModel, String>, SfmError> {
        let times = self.times();
        let start = match self.first_guess(tracks) {
            Ok(start) => start,
            Err(why) => return Ok(Err(why)),
        };
        let VideoStart { first, stride, keys, seeds: found } = start;
        let mut chosen: Option<(f64, AxisModel, Vec<Camera>)> = None;
        for seed in &found {
            let (cameras, turn) = self.motion_of_seed(seed, first, stride, keys);
            let Some(turn) = turn else { continue };
            let context = self.context(input, &cameras, &times);
            let mut model = AxisModel::new(input, cameras.clone(), turn);
            if !model.settle_with(&context, 3, 100, 2)? {
                continue;
            }
            let score = model.agreement(input);
            if chosen.as_ref().is_none_or(|(best, ..)| score > *best) {
                chosen = Some((score, model, cameras));
            }
        }
        let Some((_, mut model, cameras)) = chosen else {
            return Ok(Err("no seed gives points".to_owned()));
        };
        let context = self.context(input, &cameras, &times);
        model.extend(&context, &times)?;
        let registered = model.state.registered_count();
        if registered < 3 {
            return Ok(Err("the seed does not grow".to_owned()));
        }
        Ok(Ok(model))
    }

    /// Seeds from a few key frames: as far apart as the tracks need to move, or nearer where that leaves too few of them. Points
    /// on the axis or near it hardly move at all.
    fn first_guess(&self, tracks: &[KltTrack]) -> Result<VideoStart, String> {
        let n = self.frames.len();
        let Some(widest) = stride(tracks, n, self.cameras[0].width.max(self.cameras[0].height)) else {
            return Err("nothing moves enough".to_owned());
        };
        let guess = self.cameras[0].mean_focal();
        let known = self.known[0].fixed || self.known[0].focal_sigma.is_some();
        let focals: Vec<f64> =
            if known { vec![guess] } else { FOCAL_FACTORS.iter().map(|f| f * guess).collect() };
        let mut best: Option<f64> = None;
        let strides = || std::iter::successors(Some(widest), |s| (*s > 1).then_some(s / 2));
        // Key frames that are all tied to the next, if there are such.
        for (tied, stride) in strides().map(|s| (true, s)).chain(strides().map(|s| (false, s))) {
            let keys = KEYS.min((n - 1) / stride + 1);
            let found = window(tracks, n, stride, keys, &self.cameras[0]);
            let Some((first, pairs)) = found.filter(|(_, pairs)| !tied || all_keys_tied(pairs, keys)) else {
                continue;
            };
            let seeds = seeds(&pairs, keys, &steady(), &focals, guess, known);
            let share = seeds.first().map_or(0.0, |s| explained_share(&pairs, s));
            if share >= EXPLAINED {
                return Ok(VideoStart { first, stride, keys, seeds });
            }
            best = Some(best.map_or(share, |b| b.max(share)));
        }
        Err(match best {
            Some(share) => format!("one axis explains {:.0} % of their motion at most", 100.0 * share),
            None => "no points last long enough".to_owned(),
        })
    }

    fn context<'a>(
        &'a self,
        input: &'a MappingInput<'a>,
        starts: &'a [Camera],
        times: &'a [f64],
    ) -> CircularContext<'a> {
        CircularContext::plain(input, self.known, starts, times, self.progress)
    }

    /// Camera and turn of a seed; frames between key frames get angles in between.
    fn motion_of_seed(
        &self,
        seed: &Seed,
        first: usize,
        stride: usize,
        keys: usize,
    ) -> (Vec<Camera>, Option<CircularMotion>) {
        let mut cameras = self.cameras.to_vec();
        if !self.known[0].fixed {
            let focals = cameras[0].model.num_focals();
            cameras[0].params[..focals].fill(seed.focal);
        }
        let mut angles = vec![None; self.frames.len()];
        for k in 0..keys - 1 {
            for i in 0..=stride {
                let share = i as f64 / stride as f64;
                angles[first + k * stride + i] =
                    Some(seed.angles[k] + share * (seed.angles[k + 1] - seed.angles[k]));
            }
        }
        (cameras, CircularMotion::new(seed.direction(), seed.place(), angles))
    }

    /// Joins followed points and features; where a whole turn brings first and last frames together, the angles are
    /// stretched so that it closes.
    fn close(
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
        if range < SEAM_FROM {
            return unclosed(open, joined, "no loop closure");
        }
        let followed =
            LoopClosure::follow(self.frames, &joined.turn.angles, &self.config.klt, self.progress)?;
        let matched = keys.closure.iter().filter_map(|g| self.closure_error(&joined, &context, g)).collect();
        let seen = agree_on_gap([followed.gaps(&joined), matched]);
        let alike = self.photometric_closure(&joined.turn.angles);
        // Ties that contradict what the pictures as a whole show are wrong ones.
        let seen =
            seen.filter(|s| alike.is_none_or(|a| (s.0 * TAU + a.excess).abs() < SEAM_AGREES + 3.0 * a.sigma));
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
    fn range_by_similarity(&self, angles: &[Option<f64>]) -> Option<(f64, f64)> {
        let alike = self.photometric_closure(angles)?;
        let (first, last) = (angles.iter().flatten().next()?, angles.iter().flatten().last()?);
        let range = last - first;
        Some((range * (1.0 - alike.excess / TAU), alike.sigma * range.abs() / TAU))
    }

    /// What the pictures of all frames of the video say of a whole turn, given the angles of the chosen ones.
    fn photometric_closure(&self, angles: &[Option<f64>]) -> Option<PhotometricClosure> {
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
        let found = resect_angle(&model.state.cameras[0], &model.turn.axis, &seen, b, SEAM_SPAN);
        (found.inliers >= 8 && found.inliers * 2 >= found.asked).then(|| (wrap_angle(found.angle - b), b - a))
    }
}

/// Each angle as the line through its neighbours has it.
fn even_out(known: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let at = |&(time, angle): &(f64, f64)| {
        let near: Vec<(f64, f64)> = known
            .iter()
            .filter(|k| (k.1 - angle).abs() <= EVENED)
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
    let near = |g: &&(f64, f64)| (g.0 - middle).abs() < SEAM_AGREES;
    let agreeing: Vec<&(f64, f64)> = gaps.iter().flatten().filter(near).collect();
    if agreeing.len() < 2 || agreeing.len() * 2 < gaps.iter().flatten().count() {
        return None;
    }
    let stretch = agreeing.iter().map(|g| g.0 / g.1).sum::<f64>() / agreeing.len() as f64;
    let of = |i: usize| gaps[i].iter().filter(near).count();
    Some((stretch, of(0), of(1)))
}

/// The fewest frames over which the tracks move by [`KEY_MOTION`]; where they do not last as long, those over which they move
/// farthest.
fn stride(tracks: &[KltTrack], frames: usize, side: u32) -> Option<usize> {
    let wanted = KEY_MOTION * f64::from(side);
    let mut farthest = (0.0, 0);
    for s in 1..=((frames - 1) / 2).max(1) {
        let moves = |t: &KltTrack| -> Vec<f64> {
            t.positions.windows(s + 1).step_by(s).map(|w| w[0].distance(w[s])).collect()
        };
        let all: Vec<f64> = tracks.iter().flat_map(moves).collect();
        if all.len() < 20 {
            break;
        }
        let moved = median(all);
        if moved > farthest.0 {
            farthest = (moved, s);
        }
        if moved >= wanted {
            break;
        }
    }
    (farthest.0 >= KEY_MOTION_LEAST * wanted).then_some(farthest.1)
}

/// Whether every key frame shares tracks with the next.
fn all_keys_tied(pairs: &[KeyPair], keys: usize) -> bool {
    (0..keys - 1).all(|k| pairs.iter().any(|p| p.keys == [k, k + 1]))
}

/// The window of key frames that share most tracks, and their matches.
fn window(
    tracks: &[KltTrack],
    frames: usize,
    stride: usize,
    keys: usize,
    camera: &Camera,
) -> Option<(usize, Vec<KeyPair>)> {
    let span = (keys - 1) * stride;
    if keys < 3 || span >= frames {
        return None;
    }
    let ideal = |p: DVec2| camera.unproject(p) * camera.mean_focal();
    let pairs_at = |first: usize| -> Vec<KeyPair> {
        let pair = |i: usize, k: usize| {
            let (a, b) = (first + i * stride, first + k * stride);
            let at =
                |t: &KltTrack, f: usize| f.checked_sub(t.first).and_then(|d| t.positions.get(d)).copied();
            let both = |t: &KltTrack| Some([ideal(at(t, a)?), ideal(at(t, b)?)]);
            KeyPair { keys: [i, k], points: tracks.iter().filter_map(both).collect() }
        };
        (0..keys)
            .flat_map(|i| (i + 1..keys.min(i + 4)).map(move |k| (i, k)))
            .map(|(i, k)| pair(i, k))
            .collect()
    };
    let score = |pairs: &[KeyPair]| pairs.iter().map(|p| p.points.len().min(100)).sum::<usize>();
    let starts = (0..frames - span).step_by(stride);
    let (first, mut pairs) =
        starts.map(|s| (s, pairs_at(s))).max_by_key(|(s, p)| (score(p), std::cmp::Reverse(*s)))?;
    pairs.retain(|p| p.points.len() >= 8);
    Some((first, pairs))
}
