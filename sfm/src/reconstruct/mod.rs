//! From frames to a model: the order of the steps, and what each costs.

mod clock;
mod export;
mod model;
mod posed;
mod setup;
mod steps;

use crate::circular::initialize::constant_step as constant_step_turn;
use crate::circular::{CircularSolution, FreeModel, Motion, VideoJob, VideoModel, consider, solve_video};
use crate::incremental::depths;
use crate::incremental::finish::{converge, decide, noise_of, polish, uncertainty};
use crate::incremental::state::{MapState, MappingInput};
use crate::tracks::{build_tracks, positions};
use crate::{SfmConfig, SfmError, SfmResult, Uncertainty, incremental, pairs, sift, two_view};
pub use posed::triangulate_given;

use clock::Clock;
use model::{MappedModel, StepContext, grow_model, keypoint_sigmas};
use scene::{Decision, Features, FrameSet, Progress, TwoViewGeometry};
use setup::Setup;
use steps::mapping::{complete_ring, remove_aliased_pairs, retry_unmatched_pairs};
use steps::matching::{find_weakly_tied, pairs_decision, strong_tie, why_no_model};
use steps::{constant_step, densify, features, plane_tracks, rotation, shared_cameras, subpixel};

/// Camera poses, intrinsics and a sparse cloud from images alone.
///
/// Features, pairs, matches, verification, incremental mapping, guided re-matching, the final adjustment, and that again with
/// keypoints where windows fit.
/// "No model" is a value: `reconstruction` is `None` and `reason` says why. Same seed, same result, for any number
/// of threads.
pub fn reconstruct(
    frames: &FrameSet,
    config: &SfmConfig,
    progress: &Progress,
) -> Result<SfmResult, SfmError> {
    reconstruct_from(None, frames, config, progress)
}

/// [`reconstruct`] from features (and matches) that were found before, by whatever tool.
pub fn reconstruct_from(
    supplied: Option<Supplied>,
    frames: &FrameSet,
    config: &SfmConfig,
    progress: &Progress,
) -> Result<SfmResult, SfmError> {
    let (setup, mut result) = begin(frames, config, progress)?;
    let mut clock = Clock::start();
    let turn = if supplied.is_none() { solve_along_video(frames, config, &setup, progress)? } else { None };
    let tried = match turn {
        Some(Ok((model, decision))) => {
            clock.lap("turn", &mut result.stats.steps);
            let solved = use_video_model(&mut result, &setup, model, decision);
            export::fill(&mut result, frames, solved, progress)?;
            export::colour(&mut result, frames, progress)?;
            clock.lap("points", &mut result.stats.steps);
            return Ok(result);
        }
        Some(Err(why)) => Some(why),
        None => None,
    };
    clock.lap("turn", &mut result.stats.steps);
    let Supplied { features, matches } = supplied.unwrap_or_default();
    let own = features.is_none();
    result.features = match features {
        Some(features) => features,
        None => sift::extract_all(frames, &config.sift, progress)?,
    };
    clock.lap("features", &mut result.stats.steps);
    let job = ReconstructionRequest { frames, config, setup: &setup, more_features: own, progress };
    from_features(&mut result, matches, &job, &mut clock)?;
    export::colour(&mut result, frames, progress)?;
    clock.lap("colours", &mut result.stats.steps);
    if let Some(why) = tried {
        result.decisions.push(why);
    }
    Ok(result)
}

/// [`reconstruct`] of features that are known already, one set a frame: no image is read, points stay grey.
pub fn reconstruct_features(
    frames: &FrameSet,
    features: Vec<Features>,
    config: &SfmConfig,
    progress: &Progress,
) -> Result<SfmResult, SfmError> {
    let (setup, mut result) = begin(frames, config, progress)?;
    if features.len() != frames.len() {
        return Err(SfmError::FeaturesMismatch { features: features.len(), frames: frames.len() });
    }
    result.features = features;
    let job = ReconstructionRequest { frames, config, setup: &setup, more_features: false, progress };
    from_features(&mut result, None, &job, &mut Clock::start())?;
    Ok(result)
}

fn begin(frames: &FrameSet, config: &SfmConfig, progress: &Progress) -> Result<(Setup, SfmResult), SfmError> {
    let setup = Setup::new(frames, config)?;
    config.motion.validate()?;
    progress.check()?;
    if frames.len() < 2 {
        return Err(SfmError::TooFewImages { found: frames.len(), needed: 2 });
    }
    let mut result = SfmResult { initial_cameras: setup.of_frames(), ..SfmResult::default() };
    result.stats.images = frames.len();
    Ok((setup, result))
}

/// What is asked for.
struct ReconstructionRequest<'a> {
    frames: &'a FrameSet,
    config: &'a SfmConfig,
    setup: &'a Setup,
    /// Whether more features may be taken from the images.
    more_features: bool,
    progress: &'a Progress,
}

/// From `result.features` to a model without colours.
fn from_features(
    result: &mut SfmResult,
    matches: Option<Vec<crate::matching::PairMatches>>,
    job: &ReconstructionRequest<'_>,
    clock: &mut Clock,
) -> Result<(), SfmError> {
    let ReconstructionRequest { frames, config, setup, progress, .. } = *job;
    let matches = match matches {
        Some(matches) => matches,
        None => pairs::match_related(frames, &result.features, &config.pairs, &config.matching, progress)?,
    };
    let matched = matches.len();
    result.stats.pairs_matched = matched;
    if config.keep_matches {
        result.matches.clone_from(&matches);
    }
    clock.lap("matching", &mut result.stats.steps);
    result.geometries = two_view::verify_pairs(
        &result.features,
        &result.initial_cameras,
        matches.clone(),
        &config.two_view,
        config.seed,
        progress,
    )?;
    clock.lap("verification", &mut result.stats.steps);
    let strong = strong_tie(&config.sift);
    let mut loose = find_weakly_tied(frames.len(), &result.geometries, strong);
    let mut along = None;
    if job.more_features && loose.contains(&true) {
        let mut more = features::enrich(&result.features, &matches, &result.geometries, &loose, job)?;
        let mut matches = &matches;
        if let Some(more) = &mut more {
            result.features = std::mem::take(&mut more.features);
            result.geometries = std::mem::take(&mut more.geometries);
            result.decisions.push(more.decision.clone());
            matches = &more.matches;
            loose = find_weakly_tied(frames.len(), &result.geometries, strong);
        }
        clock.lap("blurred features", &mut result.stats.steps);
        along = constant_step::match_along_motion(result, matches, &loose, job)?;
        clock.lap("constant-step circular motion", &mut result.stats.steps);
    }
    result.geometries = two_view::match_along_lines(
        &result.features,
        &result.initial_cameras,
        std::mem::take(&mut result.geometries),
        (&config.matching, &config.two_view),
        |g| loose[g.a] || loose[g.b],
        config.seed,
        progress,
    )?;
    clock.lap("guided matching", &mut result.stats.steps);
    result.stats.features = result.features.iter().map(Features::len).sum();
    result.stats.pairs_verified = result.geometries.len();
    result.decisions.push(pairs_decision(matched, frames.len(), &result.geometries));
    let mut lap = |step: &str| clock.lap(step, &mut result.stats.steps);
    let sigmas = result.features.iter().map(keypoint_sigmas).collect();
    let given = StepContext {
        images: job.more_features.then_some(frames),
        config,
        setup,
        is_video: frames.is_video,
        features: &result.features,
        sigmas,
        start: along,
    };
    let model = solve(&given, &mut result.geometries, &mut lap, progress)?;
    match model {
        Some(model) => export::fill(result, frames, model, progress)?,
        None => result.reason = why_no_model(&result.features, &result.geometries),
    }
    clock.lap("points", &mut result.stats.steps);
    Ok(())
}

/// What is known before the images are looked at.
#[derive(Clone, Debug, Default)]
pub struct Supplied {
    /// One per frame, each with a descriptor (zeros where there is none: it matches nothing) a keypoint.
    pub features: Option<Vec<Features>>,
    /// Matches before verification; without them the features are matched.
    pub matches: Option<Vec<crate::matching::PairMatches>>,
}

/// Looks for something that turns about one axis before the camera of a video; `None` where that is not asked for.
fn solve_along_video(
    frames: &FrameSet,
    config: &SfmConfig,
    setup: &Setup,
    progress: &Progress,
) -> Result<Option<Result<(VideoModel, Decision), Decision>>, SfmError> {
    if !frames.is_video || !matches!(config.motion.motion, Motion::Auto | Motion::SingleAxis) {
        return Ok(None);
    }
    let (cameras, camera_of, known) = (&setup.cameras, &setup.camera_of, &setup.known);
    solve_video(&VideoJob { frames, config, cameras, camera_of, known, progress }).map(Some)
}

/// Takes a turn's features, matches and decisions over; what is left is its model.
fn use_video_model(
    result: &mut SfmResult,
    setup: &Setup,
    model: VideoModel,
    decision: Decision,
) -> SolvedModel {
    result.stats.pairs_matched = model.matched;
    result.stats.pairs_verified = model.geometries.len();
    result.stats.features = model.keypoints.iter().map(Vec::len).sum();
    (result.features, result.geometries) = (model.features, model.geometries);
    circular_model(setup, model.solution, Some(decision), model.keypoints)
}

fn circular_model(
    setup: &Setup,
    solution: CircularSolution,
    motion: Option<Decision>,
    keypoints: Vec<Vec<glam::DVec2>>,
) -> SolvedModel {
    SolvedModel {
        state: solution.state,
        camera_of: setup.camera_of.clone(),
        keypoints,
        decisions: motion.into_iter().chain(solution.decisions).collect(),
        uncertainty: solution.uncertainty,
    }
}

/// A model, and what was learned with it.
pub(crate) struct SolvedModel {
    /// In the frames of the images as they are.
    state: MapState,
    /// For each image the camera of `state`.
    camera_of: Vec<usize>,
    keypoints: Vec<Vec<glam::DVec2>>,
    decisions: Vec<Decision>,
    uncertainty: Option<Uncertainty>,
}

/// `lap` is told the name of each step when it is done; pairs that were found on the way are added to `geometries`.
fn solve(
    given: &StepContext<'_>,
    geometries: &mut Vec<TwoViewGeometry>,
    lap: &mut dyn FnMut(&str),
    progress: &Progress,
) -> Result<Option<SolvedModel>, SfmError> {
    let StepContext { config, features, .. } = *given;
    progress.begin("mapping", features.len());
    let keypoints: Vec<_> = features.iter().map(positions).collect();
    let mut decisions = Vec::new();
    let mapped = map_images(given, &keypoints, geometries, &mut decisions, lap, progress)?;
    let Some(MappedModel { mut state, tracks, ringed, .. }) = mapped else {
        return circular_motion_alone(given, keypoints, geometries, progress);
    };
    let input = given.input(&keypoints, &tracks, geometries);
    let (shared, decision) = shared_cameras::share_cameras(given, &input, &state, progress)?;
    decisions.extend(decision);
    let joined = shared.map(|(setup, joined)| {
        state = joined;
        setup
    });
    let with_fewer = joined.as_ref().map(|setup| given.with_setup(setup));
    let given = with_fewer.as_ref().unwrap_or(given);
    let setup = given.setup;
    lap("cameras");
    let mut input = given.input(&keypoints, &tracks, geometries);
    let starts = incremental::starts_of(&setup.cameras, &setup.known, &state);
    let named = config.camera_model.model();
    let verdict = decide(&state, &input, &setup.known, &starts, named, progress)?;
    lap("camera model");
    // From here on every image is the way up that its sensor was.
    let rotated = verdict.rotated.clone().unwrap_or_else(|| vec![false; features.len()]);
    let (unrotated, unrotated_geometries) = rotation::rotate_inputs(&input, &setup.cameras, &rotated);
    rotation::rotate_poses(&mut state, &rotated);
    (input.keypoints, input.geometries) = (&unrotated, &unrotated_geometries);
    // Poses of which some are rotated by 180° are on no circle.
    let ringed = ringed && verdict.rotated.is_none();
    if ringed {
        state.cameras.clone_from(&verdict.adjusted.problem.cameras);
        state = constant_step_turn::hold_on_ring(
            &state,
            &given.motion_input(&input, &starts, progress),
            verdict.intrinsics,
        )?;
    } else {
        polish(&mut state, &input, &setup.known, &starts, &verdict, progress)?;
    }
    lap("final adjustment");
    let settled = |mut state: MapState, input: &MappingInput<'_>, intrinsics| -> Result<MapState, SfmError> {
        if ringed {
            return constant_step_turn::hold_on_ring(
                &state,
                &given.motion_input(input, &starts, progress),
                intrinsics,
            );
        }
        converge(&mut state, input, &setup.known, &starts, intrinsics, progress)?;
        Ok(state)
    };
    let mut intrinsics = verdict.intrinsics;
    let settle = |state: MapState, input: &MappingInput<'_>| settled(state, input, verdict.intrinsics);
    let denser = densify::along_the_model(given, &input, &state, noise_of(&state, &input), progress)?;
    if let Some((geometries, tracks)) = &denser {
        (input.geometries, input.tracks) = (geometries, tracks);
        state = settle(densify::regrow(&state, &input), &input)?;
    }
    lap("denser tracks");
    let (sharper, decision) =
        subpixel::refine_keypoints(given, (&state, &input), &rotated, settle, progress)?;
    decisions.extend(decision);
    let (refined, model) = sharper.unzip();
    state = model.unwrap_or(state);
    if let Some(refined) = &refined {
        (input.keypoints, input.sigmas) = (&refined.keypoints, &refined.sigmas);
    }
    lap("keypoints");
    let cameras = (starts.as_slice(), intrinsics);
    let (with_planes, found) =
        plane_tracks::add_plane_tracks(given, (&state, &input), &rotated, cameras, settled, progress)?;
    decisions.extend(found);
    if let Some(found) = &with_planes {
        (state, intrinsics) = (found.state.clone(), found.intrinsics);
        input = found.plane_tracks.input(&input);
    }
    depths::drop_lonely(&mut state, &input);
    lap("plane tracks");
    // Images that were rotated on their way get cameras of their own in the end: no turn before one camera.
    let free = FreeModel { state: &state, intrinsics };
    let motion =
        consider(&given.motion_input(&input, &starts, progress), Some(&free), !rotated.contains(&true))?;
    lap("motion");
    if let Some(t) = motion.taken {
        decisions.extend(motion.decision);
        let mut solved = circular_model(setup, t, None, input.keypoints.to_vec());
        solved.decisions.splice(0..0, decisions);
        return Ok(Some(solved));
    }
    decisions.extend(motion.decision);
    state = motion.circled.unwrap_or(state);
    let uncertainty = uncertainty(&state, &input, &setup.known, &starts, intrinsics)?;
    lap("covariance");
    decisions.extend(verdict.decisions);
    let keypoints = rotation::rotate_keypoints(&input, &setup.cameras, &rotated);
    let mut solved =
        SolvedModel { state, camera_of: setup.camera_of.clone(), keypoints, decisions, uncertainty };
    rotation::rotate_back(&mut solved, &rotated);
    Ok(Some(solved))
}

/// The model that the images grow into, without pairs that repeated structure explains, with what a ring and a second look add;
/// `None` where none grows.
fn map_images(
    given: &StepContext<'_>,
    keypoints: &[Vec<glam::DVec2>],
    geometries: &mut Vec<TwoViewGeometry>,
    decisions: &mut Vec<Decision>,
    lap: &mut dyn FnMut(&str),
    progress: &Progress,
) -> Result<Option<MappedModel>, SfmError> {
    let mapped = constant_step::grow_or_place(given, keypoints, geometries, decisions, progress)?;
    lap("mapping");
    let Some(mut model) = mapped else { return Ok(None) };
    if let Some((consistent, decision)) =
        remove_aliased_pairs(given, keypoints, geometries, &model, progress)?
    {
        model = consistent;
        decisions.push(decision);
    }
    lap("repeated structure");
    let completed = complete_ring(given, keypoints, &model, geometries, progress)?;
    lap("ring");
    let (mut model, completed) =
        retry_unmatched_pairs(given, keypoints, geometries, (model, completed), progress)?;
    lap("second attempt");
    decisions.extend(model.mapper.take());
    if let Some((whole, decision)) = completed {
        model.state = whole;
        decisions.push(decision);
    }
    Ok(Some(model))
}

/// Where no model grows: that of a turn from three images on, if there is one.
fn circular_motion_alone(
    given: &StepContext<'_>,
    keypoints: Vec<Vec<glam::DVec2>>,
    geometries: &[TwoViewGeometry],
    progress: &Progress,
) -> Result<Option<SolvedModel>, SfmError> {
    let tracks = build_tracks(given.features, geometries);
    let input = given.input(&keypoints, &tracks, geometries);
    let motion = consider(&given.motion_input(&input, &given.setup.cameras, progress), None, true)?;
    Ok(motion.taken.map(|t| circular_model(given.setup, t, motion.decision, keypoints)))
}

#[cfg(test)]
mod tests;
