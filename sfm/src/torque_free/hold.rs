//! Whether free poses are those of a torque-free body, and the model held near that motion.

use super::deviations;
use super::likely::{DETERMINED, LikelyMotion};
use super::motion::TorqueFreeMotion;
use super::report::report;
use crate::bundle::{BundleCovariance, BundleProblem, ExpectedPoses};
use crate::circular::evidence::{MotionScore, MotionTrial, free_problem, median_deviation, occam, thin};
use crate::circular::limits::{FARTHEST, LEAST_SIGMA};
use crate::circular::{FreeModel, Motion, MotionInput};
use crate::error::SfmError;
use crate::incremental::finish::{FinalAdjustment, converge};
use crate::incremental::state::MapState;
use crate::model_selection::camera::{FreeIntrinsics, deviation, point_sigma};
use crate::model_selection::evidence::{TRACK_EXCESS, is_determined};
use crate::result::{FramePose, PoseDeviation};
use scene::decision::{Decision, Measurement, MotionModel, Quantity, Rule, Subject};
use scene::motion_report::MotionReport;
use scene::{CameraModel, Pose};

/// Rounds of adjusting model and motion to each other.
/// Source: derived: the second corrects what the first moved far enough to be another quadratic.
const ROUNDS: usize = 2;

/// A model held near the motion of a torque-free body.
pub(crate) struct HeldModel {
    pub state: MapState,
    /// By image.
    pub expected: ExpectedPoses,
    pub report: MotionReport,
    /// By image.
    pub deviations: Vec<PoseDeviation>,
    /// Poses of the frames that were asked for.
    pub frames: Vec<FramePose>,
    pub intrinsics: FreeIntrinsics,
    /// On the camera.
    pub decisions: Vec<Decision>,
}

/// The model held near a torque-free motion where the evidence is for one; what was found, where
/// the motion was compared at all. `times`: by image; `film`: of all frames of
/// the video, seconds.
pub(crate) fn consider(
    job: &MotionInput<'_>,
    free: &FreeModel<'_>,
    times: &[f64],
    film: &[f64],
) -> Result<(Option<HeldModel>, Option<Decision>), SfmError> {
    if !matches!(job.config.motion, Motion::Auto | Motion::Tumble) || job.cameras.len() != 1 {
        return Ok((None, None));
    }
    let asked = job.config.motion == Motion::Tumble;
    let images = registered(free.state);
    let Some(motion) = motion_of(free.state, &images, times).filter(|m| asked || is_near(m)) else {
        return Ok((None, None));
    };
    let context = job.context(&[]);
    let (mut problem, compared) = free_problem(free.state, &context, free.intrinsics);
    let Some((trial, of_free)) = MotionTrial::of_free(&mut problem, job.progress)? else {
        return Ok((None, None));
    };
    let Some(known) = problem.covariance(&trial.options)? else { return Ok((None, None)) };
    let times_of = |images: &[usize]| images.iter().map(|&i| times[i]).collect::<Vec<_>>();
    let compared_times = times_of(&compared);
    let Some((score, evidence)) = compare(&trial, &of_free, &problem, &known, &compared_times)? else {
        return Ok((None, None));
    };
    let taken = asked || (evidence > 0.0 && !score.predicts_worse(&of_free));
    let choice = if taken { MotionModel::TorqueFree } else { MotionModel::Free };
    let rule = if asked { Rule::Requested } else { Rule::Evidence };
    let decision = Decision::new(Subject::Motion, choice, rule)
        .with_all([
            Measurement::count(Quantity::Images, compared.len()),
            Measurement::new(Quantity::LogOdds, evidence),
        ])
        .compared(MotionModel::TorqueFree, taken, score.figures(&of_free))
        .compared(MotionModel::Free, !taken, of_free.figures(&of_free));
    let holder = Holder { job, free, times, film, known };
    let held = if taken { holder.with_best_camera(motion)? } else { None };
    Ok((held, Some(decision)))
}

/// The images that have a pose, in ascending order.
fn registered(state: &MapState) -> Vec<usize> {
    (0..state.poses.len()).filter(|&i| state.poses[i].is_some()).collect()
}

fn motion_of(state: &MapState, images: &[usize], times: &[f64]) -> Option<TorqueFreeMotion> {
    let poses: Vec<Pose> = images.iter().filter_map(|&i| state.poses[i]).collect();
    TorqueFreeMotion::of_poses(&poses, &images.iter().map(|&i| times[i]).collect::<Vec<_>>())
}

fn is_near(motion: &TorqueFreeMotion) -> bool {
    motion.turn.sigma < FARTHEST[0] && motion.mass.sigma < FARTHEST[1] * motion.distance()
}

/// What a motion leads one to expect, its deviations those that free poses show beyond what they
/// are known to (`known`, observations that err together counted for what they are).
fn expectation(motion: &TorqueFreeMotion, times: &[f64], known: &BundleCovariance) -> ExpectedPoses {
    let distance = motion.distance();
    let beyond = |found: f64, first: usize, unit: f64| {
        let seen = TRACK_EXCESS * median_deviation(known, first).powi(2);
        (found * found - seen).max(0.0).sqrt().max(LEAST_SIGMA * unit)
    };
    ExpectedPoses {
        poses: motion.poses(times),
        centre: motion.mass.centre,
        sigma: [beyond(motion.turn.sigma, 0, 1.0), beyond(motion.mass.sigma, 3, distance)],
    }
}

/// The most likely motion on the observations of the trial: its score, and the logarithm of the
/// evidence for it against free poses.
fn compare(
    trial: &MotionTrial<'_>,
    of_free: &MotionScore,
    free: &BundleProblem,
    known: &BundleCovariance,
    times: &[f64],
) -> Result<Option<(MotionScore, f64)>, SfmError> {
    let Some(rough) = TorqueFreeMotion::of_poses(&free.poses, times) else { return Ok(None) };
    let Some(information) = free.pose_information(&trial.options)? else { return Ok(None) };
    let Some(LikelyMotion { motion, .. }) = rough.most_likely(&information, times) else { return Ok(None) };
    let expected = expectation(&motion, times, known);
    let (sigma, distance) = (expected.sigma, motion.distance());
    let mut problem = BundleProblem { expected: Some(expected), ..free.clone() };
    let cost = trial.adjust(&mut problem)?;
    let seen = [median_deviation(known, 0), median_deviation(known, 3) / distance];
    let count = 3.0 * free.poses.len() as f64;
    let (effective, gain) = occam(count, [sigma[0], sigma[1] / distance], seen);
    let price = trial.price();
    let parameters = DETERMINED + effective.round() as usize;
    let bic = cost + parameters as f64 * price;
    let score = trial.held_out(MotionModel::TorqueFree, &problem, bic, parameters);
    let more = (cost - of_free.cost(price)) / TRACK_EXCESS;
    Ok(Some((score, 0.5 * (gain - DETERMINED as f64 * price - more))))
}

/// What a model is held to a motion with.
struct Holder<'a> {
    job: &'a MotionInput<'a>,
    free: &'a FreeModel<'a>,
    /// By image, seconds.
    times: &'a [f64],
    /// Of all frames of the video, seconds.
    film: &'a [f64],
    /// What free poses are known to.
    known: BundleCovariance,
}

/// A model and a motion adjusted to each other.
struct Held {
    state: MapState,
    expected: ExpectedPoses,
    likely: LikelyMotion,
}

impl Holder<'_> {
    /// With the principal point free where the motion determines it, which free poses may not.
    fn with_best_camera(&self, rough: TorqueFreeMotion) -> Result<Option<HeldModel>, SfmError> {
        let given = self.free.intrinsics;
        let may_free = self.job.named.is_none() && !self.job.known[0].fixed && !given.principal_point;
        let whole = FreeIntrinsics { model: CameraModel::Radial, principal_point: true, held: None };
        if may_free && let Some(held) = self.held(rough.clone(), whole)? {
            let share = self.share_of_prior(&held, whole)?;
            if is_determined(share, TRACK_EXCESS.sqrt(), 1.0) {
                let decision = Decision::new(Subject::CameraModelWithMotion, whole.choice(), Rule::Evidence)
                    .measured(Quantity::ShareOfPrior, share);
                return Ok(Some(self.finished(held, whole, vec![decision])));
            }
        }
        Ok(self.held(rough, given)?.map(|held| self.finished(held, given, Vec::new())))
    }

    fn finished(&self, held: Held, intrinsics: FreeIntrinsics, decisions: Vec<Decision>) -> HeldModel {
        let Held { state, expected, likely } = held;
        let times: Vec<f64> = registered(&state).iter().map(|&i| self.times[i]).collect();
        let factor = TRACK_EXCESS.sqrt();
        let report = report(&likely, &times, factor);
        let deviations = deviations::of_poses(&likely, self.times, factor);
        let poses = likely.motion.poses(self.film);
        let mut frames = Vec::with_capacity(self.film.len());
        for ((&time_s, pose), deviation) in
            self.film.iter().zip(poses).zip(deviations::of_poses(&likely, self.film, factor))
        {
            frames.push(FramePose { time_s, pose, deviation });
        }
        HeldModel { state, expected, report, deviations, frames, intrinsics, decisions }
    }

    /// Standard deviation of the principal point, of the coordinate that is known less, as a share
    /// of that beforehand.
    fn share_of_prior(&self, held: &Held, intrinsics: FreeIntrinsics) -> Result<f64, SfmError> {
        let what = self.adjustment(intrinsics, Some(&held.expected));
        let (selected, options) = what.prepare(&held.state, self.job.input);
        let Some(covariance) = selected.problem.covariance(&options)? else { return Ok(f64::INFINITY) };
        let camera = &selected.problem.cameras[0];
        let first = camera.model.num_focals();
        let of = |k: usize| deviation(camera, &covariance.cameras[0], first + k) / point_sigma(camera);
        Ok(of(0).max(of(1)))
    }

    fn adjustment<'b>(
        &'b self,
        intrinsics: FreeIntrinsics,
        expected: Option<&'b ExpectedPoses>,
    ) -> FinalAdjustment<'b> {
        FinalAdjustment { known: self.job.known, starts: self.job.starts, intrinsics, expected }
    }

    /// The whole model and the motion, adjusted to each other; `None` where the observations do not
    /// determine the motion.
    fn held(&self, rough: TorqueFreeMotion, intrinsics: FreeIntrinsics) -> Result<Option<Held>, SfmError> {
        let mut state = self.free.state.clone();
        let mut motion = rough;
        let mut found = None;
        for _ in 0..ROUNDS {
            let Some(likely) = self.most_likely(&state, motion, intrinsics)? else { return Ok(None) };
            motion = likely.motion.clone();
            let expected = expectation(&motion, self.times, &self.known);
            let what = self.adjustment(intrinsics, Some(&expected));
            converge(&mut state, self.job.input, &what, self.job.progress)?;
            found = Some((expected, likely));
        }
        Ok(found.map(|(expected, likely)| Held { state, expected, likely }))
    }

    /// The motion that is most likely near another by all points of at most
    /// [`FRAMES_TO_CHOOSE`](crate::circular::limits::FRAMES_TO_CHOOSE) images.
    fn most_likely(
        &self,
        state: &MapState,
        motion: TorqueFreeMotion,
        intrinsics: FreeIntrinsics,
    ) -> Result<Option<LikelyMotion>, SfmError> {
        let mut part = state.clone();
        thin(&mut part);
        let (selected, options) = self.adjustment(intrinsics, None).prepare(&part, self.job.input);
        let times: Vec<f64> = selected.images.iter().map(|&i| self.times[i]).collect();
        let information = selected.problem.pose_information(&options)?;
        Ok(information.and_then(|i| motion.most_likely(&i, &times)))
    }
}
