//! Turns in videos: tracks, a seed, growth along the frames, the loop closure of a whole turn, the last adjustment.

use super::evidence::Comparison;
use super::initialize::key_frames::{KeyFrames, VideoTracks, drop_still};
use super::initialize::seed::{KEYS, KeyPair, Seed, explained_share, seeds, steady};
use super::loop_closure::close::ClosedVideo;
use super::model::{AxisModel, CircularContext};
use super::motion::CircularMotion;
use super::prior::{known_rate, learn_motion};
use super::{
    CircularSolution, Motion, MotionInput, ROUNDS, ROUNDS_BEFORE, adjust_and_choose, decision, finish,
};
use crate::Knowledge;
use crate::incremental::resection::FOCAL_FACTORS;
use crate::incremental::state::MappingInput;
use crate::klt::{KltTrack, track};
use crate::statistics::median;
use crate::{Decision, SfmConfig, SfmError};
use glam::DVec2;
use scene::{Camera, Features, FrameSet, Progress, TwoViewGeometry};

/// Motion between two key frames of the seed, as a share of the longer image side.
const KEY_MOTION: f64 = 0.012;
/// Share of it that is still enough where tracks do not last until they have moved as far.
const KEY_MOTION_LEAST: f64 = 0.25;
/// Least share of the matches that a seed must explain.
const EXPLAINED: f64 = 0.5;
/// Least share of the frames that must get an angle where the evidence decides.
const REGISTERED: f64 = 0.8;
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
    Ok(Ok((job.video_model(solution, material, keys), decision("single-axis", evidence))))
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
            is_video: true,
            skip: &self.config.skip,
            seed: self.config.seed,
        }
    }

    fn video_model(&self, solution: CircularSolution, material: VideoTracks, keys: KeyFrames) -> VideoModel {
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
    pub(crate) fn times(&self) -> Vec<f64> {
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

    pub(crate) fn context<'a>(
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
