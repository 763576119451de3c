//! Turns in videos: points are followed, a first motion grows along the frames, a whole turn is
//! closed, and the motion that the angles show is held in the last adjustment.

use super::angle_process::learn_motion;
use super::choose::{motion_decision, with_comparison};
use super::config::Motion;
use super::evidence::MotionComparison;
use super::initialize::best_start::{SeedCameras, best_start};
use super::initialize::key_frames::{KeyFrames, VideoTracks, drop_stationary};
use super::initialize::video_seed::VideoStart;
use super::job::{MotionInput, VideoJob};
use super::learnt_motion::{AngleAt, LearntMotion};
use super::limits::{FINAL_ROUNDS, MOST};
use super::loop_closure::close::ClosedVideo;
use super::model::AxisModel;
use super::motion::{CircularMotion, pose_at};
use super::prior::AnglePrior;
use super::problem::Relation;
use super::solution::{ChosenModel, CircularSolution};
use crate::error::SfmError;
use crate::incremental::state::MappingInput;
use crate::klt::{KltTrack, track};
use crate::result::FramePose;
use glam::DVec2;
use scene::decision::{Decision, Measurement, MotionModel, Quantity, Remark, Rule, Subject};
use scene::{Camera, Features, TwoViewGeometry};

/// Places in a video where a motion may start before it is given up.
/// Source: three spread over it leave one where a part that turns by itself is small or hidden.
pub(super) const STARTS: usize = 3;

/// A model about one axis with the keypoints it refers to.
pub(crate) struct VideoModel {
    pub solution: CircularSolution,
    pub keypoints: Vec<Vec<DVec2>>,
    pub features: Vec<Features>,
    pub geometries: Vec<TwoViewGeometry>,
    pub matched: usize,
}

/// What a step makes of a video, or the decision that says why it shows no single-axis motion.
type Step<T> = Result<Result<T, Decision>, SfmError>;

/// The model of a video in which something turns about one axis; else the reason why it is none.
pub(crate) fn solve_video(job: &VideoJob<'_>) -> Step<(VideoModel, Decision)> {
    if let Some(why) = unsuitable(job) {
        return Ok(Err(not_found().remarked(why)));
    }
    let followed = FollowedPoints::of(job)?;
    let (data, mut chosen) = match first_that_holds(job, &followed)? {
        Ok(found) => found,
        Err(why) => return Ok(Err(followed.not_found().absorbing(why))),
    };
    let evidence = match data.judge(&chosen, &followed)? {
        Ok(evidence) => evidence,
        Err(why) => return Ok(Err(why)),
    };
    let motion = data.learn(&chosen)?;
    data.polish(&mut chosen, motion.as_ref())?;
    let solution = data.finish(chosen, motion)?;
    Ok(Ok((data.into_model(solution), evidence)))
}

/// The model from the first start that leads to one. Where parts move by themselves, they may be
/// most of what a few frames show, and the motion that explains it fails over the whole video.
fn first_that_holds<'a>(
    job: &'a VideoJob<'a>,
    followed: &FollowedPoints,
) -> Step<(VideoData<'a>, JudgedModel)> {
    let mut failed = Vec::new();
    let mut why = not_found().remarked(Remark::TracksDisagree);
    while failed.len() < STARTS {
        let start = match VideoStart::find(job, &followed.tracks, &failed) {
            Ok(start) => start,
            Err(_) if !failed.is_empty() => break,
            Err(other) => return Ok(Err(*other)),
        };
        match job.grow(&job.input(&followed.material), &start)? {
            Ok(grown) => {
                let (data, closed) = VideoData::close(job, followed, grown)?;
                if let Some(chosen) = data.adjust(closed)? {
                    return Ok(Ok((data, chosen)));
                }
            }
            Err(other) => why = other,
        }
        failed.push(start);
    }
    Ok(Err(why))
}

/// The decision that a video shows no single-axis motion.
pub(crate) fn not_found() -> Decision {
    Decision::new(Subject::VideoMotion, false, Rule::Evidence)
}

/// Why a video is not even looked at.
fn unsuitable(job: &VideoJob<'_>) -> Option<Remark> {
    match (job.cameras.len(), job.frames.len()) {
        (1, 4..) => None,
        (1, _) => Some(Remark::TooFewFrames),
        _ => Some(Remark::SeveralCameras),
    }
}

/// Points followed through a video.
struct FollowedPoints {
    tracks: Vec<KltTrack>,
    material: VideoTracks,
    /// How many there are, for the report.
    counts: [Measurement; 2],
}

impl FollowedPoints {
    /// Those that move.
    fn of(job: &VideoJob<'_>) -> Result<Self, SfmError> {
        let mut tracks = track(job.frames, &job.config.klt, job.progress)?;
        let stationary = drop_stationary(&mut tracks);
        let material = VideoTracks::of_klt(&tracks, job.frames.len());
        let counts = [
            Measurement::count(Quantity::TrackedPoints, tracks.len()),
            Measurement::count(Quantity::StationaryPoints, stationary),
        ];
        Ok(Self { tracks, material, counts })
    }

    fn not_found(&self) -> Decision {
        not_found().with_all(self.counts)
    }
}

impl VideoJob<'_> {
    /// From followed points alone: the best seed of a start, grown over the whole video.
    pub(crate) fn grow(&self, input: &MappingInput<'_>, start: &VideoStart) -> Step<AxisModel> {
        let times = self.times();
        let priors = [AnglePrior::Steady { times: &times }];
        let given = SeedCameras { cameras: self.cameras, known: &self.known[0], points_per_image: 100 };
        let context = self.context(input, self.cameras, &priors);
        let found = best_start(&context, &given, &start.seeds, |seed| start.angles(seed, times.len()))?;
        let Some((mut model, cameras)) = found else {
            return Ok(Err(not_found().remarked(Remark::NoTriangulation)));
        };
        model.extend(&self.context(input, &cameras, &priors), &times)?;
        if model.state.registered_count() < 3 {
            return Ok(Err(not_found().remarked(Remark::NoExtension)));
        }
        Ok(Ok(model))
    }
}

/// What the model of a video refers to from its loop closure on; stays the same.
struct VideoData<'a> {
    job: &'a VideoJob<'a>,
    times: Vec<f64>,
    keys: KeyFrames,
    /// For each frame how many of its keypoints are features.
    feature_counts: Vec<usize>,
    /// Keypoints and tracks of features and followed points.
    material: VideoTracks,
    /// The cameras that priors refer to.
    starts: Vec<Camera>,
    /// What a whole turn says of the angle between the first and the last frame.
    closing: Option<Relation>,
}

/// A turn that is to be adjusted, and what was found at its loop closure.
struct ClosedTurn {
    turn: CircularMotion,
    closure: Decision,
}

/// A model that is to be judged, with what is known of its loop closure.
struct JudgedModel {
    chosen: ChosenModel,
    closure: Decision,
}

impl<'a> VideoData<'a> {
    /// Features of key frames join the followed points, and a whole turn is closed.
    fn close(
        job: &'a VideoJob<'a>,
        followed: &FollowedPoints,
        grown: AxisModel,
    ) -> Result<(Self, ClosedTurn), SfmError> {
        let config = job.config;
        let keys = KeyFrames::new(job.frames, &grown, &config.sift, &config.matching, job.progress)?;
        let closed = job.close(&keys, &followed.tracks, grown)?;
        let ClosedVideo { material, turn, cameras, closing, closure } = closed;
        let feature_counts = keys.features.iter().map(Features::len).collect();
        let times = job.times();
        let data = Self { job, times, keys, feature_counts, material, starts: cameras, closing };
        Ok((data, ClosedTurn { turn, closure }))
    }

    fn motion_input<'b>(&'b self, input: &'b MappingInput<'b>) -> MotionInput<'b> {
        let job = self.job;
        MotionInput {
            input,
            cameras: job.cameras,
            known: job.known,
            starts: &self.starts,
            named: job.config.camera_model.model(),
            config: &job.config.motion,
            features: &self.feature_counts,
            room: Some(job.frames),
            progress: job.progress,
        }
    }

    /// What is known of the angles before the motion is learnt.
    fn priors(&self) -> Vec<AnglePrior<'_>> {
        let times = &self.times;
        let rate = self.job.config.motion.known_rate.map(f64::to_radians);
        let of_rate = rate.map_or(AnglePrior::Steady { times }, |rate| AnglePrior::KnownRate { times, rate });
        std::iter::once(of_rate).chain(self.closing.map(AnglePrior::LoopClosure)).collect()
    }

    /// The model adjusted with the intrinsics that it determines.
    fn adjust(&self, closed: ClosedTurn) -> Result<Option<JudgedModel>, SfmError> {
        let input = self.job.input(&self.material);
        let (job, priors) = (self.motion_input(&input), self.priors());
        let ClosedTurn { turn, closure } = closed;
        // One round less than at the end, which follows (docs/decisions/08).
        let chosen = ChosenModel::adjust(&job.context(&priors), &job, &self.starts, turn, FINAL_ROUNDS - 1)?;
        Ok(chosen.map(|chosen| JudgedModel { chosen, closure }))
    }

    /// Whether one axis is the better description of enough frames; the decision for or against it.
    fn judge(&self, judged: &JudgedModel, followed: &FollowedPoints) -> Step<Decision> {
        let input = self.job.input(&self.material);
        let (job, priors) = (self.motion_input(&input), self.priors());
        let ChosenModel { model, intrinsics, .. } = &judged.chosen;
        let comparison = MotionComparison::of(Some(model), &model.state, &job.context(&priors), *intrinsics)?;
        let evidence = motion_decision(Rule::Evidence).with_all(followed.counts);
        let evidence = with_comparison(evidence.absorbing(judged.closure.clone()), comparison.as_ref());
        let (registered, frames) = (model.state.registered_count(), self.job.frames.len());
        let is_single =
            comparison.is_some_and(|c| c.favours_single()) && registered as f64 >= MOST * frames as f64;
        if self.job.config.motion.motion == Motion::Auto && !is_single {
            let counts = [
                Measurement::count(Quantity::RegisteredImages, registered),
                Measurement::count(Quantity::Frames, frames),
            ];
            return Ok(Err(not_found().with_all(counts).absorbing(evidence)));
        }
        Ok(Ok(Decision { choice: MotionModel::SingleAxis.into(), ..evidence }))
    }

    /// How steadily the object turns, where its rate is not known.
    fn learn(&self, judged: &JudgedModel) -> Result<Option<LearntMotion>, SfmError> {
        if self.job.config.motion.known_rate.is_some() {
            return Ok(None);
        }
        let input = self.job.input(&self.material);
        let (job, priors) = (self.motion_input(&input), self.priors());
        let ChosenModel { model, intrinsics, .. } = &judged.chosen;
        let Some((_, images, covariance)) = model.covariance(&job.context(&priors), *intrinsics, 1.0)? else {
            return Ok(None);
        };
        let angles = &model.turn.angles;
        let film = self.job.frames.film.as_ref().map_or(&[][..], |film| &film.times_s);
        let first = learn_motion(angles, &self.times, &images, &covariance, None, film);
        // With angles that are nearly right, photometric similarity says more.
        let by_frame = first.as_ref().map(|l| l.by_frame(self.job.frames.len()));
        let range = by_frame.and_then(|angles| self.job.range_by_similarity(&angles));
        let closed =
            range.and_then(|r| learn_motion(angles, &self.times, &images, &covariance, Some(r), film));
        Ok(closed.or(first))
    }

    /// The last adjustment, its angles held to the learnt motion.
    fn polish(&self, judged: &mut JudgedModel, motion: Option<&LearntMotion>) -> Result<(), SfmError> {
        let input = self.job.input(&self.material);
        let job = self.motion_input(&input);
        let priors = motion.map_or_else(|| self.priors(), |m| vec![m.holding_prior()]);
        let ChosenModel { model, intrinsics, .. } = &mut judged.chosen;
        model.polish(&job.context(&priors), *intrinsics, FINAL_ROUNDS)
    }

    /// The finished model with its standard deviations, for which the angles are as loose as they
    /// are known.
    fn finish(
        &self,
        judged: JudgedModel,
        motion: Option<LearntMotion>,
    ) -> Result<CircularSolution, SfmError> {
        let input = self.job.input(&self.material);
        let job = self.motion_input(&input);
        let priors = motion.as_ref().map_or_else(|| self.priors(), |m| vec![m.loose_prior()]);
        let excess = motion.as_ref().map_or(1.0, |m| m.excess);
        let times = self.job.frames.times();
        let context = job.context(&priors);
        let mut solution = judged.chosen.finish(&context, &job, excess, times.as_deref())?;
        if let Some(motion) = motion {
            let between = motion.between(&solution.turn);
            let (axis, of_axis) = (solution.turn.axis, solution.axis_deviation);
            let frame = |a: &AngleAt| FramePose {
                time_s: a.time,
                pose: pose_at(&axis, a.angle),
                deviation: of_axis.of_pose(&axis, a.angle, a.deviation),
            };
            solution.frames = between.iter().map(frame).collect();
            solution.decisions.push(motion.decision);
        }
        Ok(solution)
    }

    fn into_model(self, solution: CircularSolution) -> VideoModel {
        let Self { keys, material, .. } = self;
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
}
