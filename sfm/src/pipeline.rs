//! From frames to a model: the order of the steps, and what each costs.

mod clock;
mod export;
mod setup;

use crate::incremental::finish::{decide, polish, uncertainty};
use crate::incremental::state::{Input, State};
use crate::single_axis::{Free, Job, Motion, Turned, VideoJob, VideoModel, consider, solve_video};
use crate::tracks::{build_tracks, positions};
use crate::{
    Decision, SfmConfig, SfmError, SfmResult, Uncertainty, incremental, matching, pairs, sift, single_axis,
    two_view,
};
use clock::Clock;
use scene::{Features, FrameSet, Progress, TwoViewGeometry};
use setup::Setup;

/// Camera poses, intrinsics and a sparse cloud from images alone.
///
/// Features, pairs, matches, verification, incremental mapping, guided re-matching and the final adjustment.
/// "No model" is a value: `reconstruction` is `None` and `reason` says why. Same seed, same result, for any number
/// of threads.
pub fn reconstruct(
    frames: &FrameSet,
    config: &SfmConfig,
    progress: &Progress,
) -> Result<SfmResult, SfmError> {
    let setup = Setup::new(frames, config)?;
    config.motion.validate()?;
    progress.check()?;
    if frames.len() < 2 {
        return Err(SfmError::TooFewImages { found: frames.len(), needed: 2 });
    }
    let mut clock = Clock::start();
    let mut result = SfmResult { initial_cameras: setup.of_frames(), ..SfmResult::default() };
    result.stats.images = frames.len();
    let motion = config.motion.motion;
    let mut tried = None;
    if frames.is_video && matches!(motion, Motion::Auto | Motion::SingleAxis) {
        let job = VideoJob {
            frames,
            config,
            cameras: &setup.cameras,
            camera_of: &setup.camera_of,
            known: &setup.known,
            progress,
        };
        let solved = solve_video(&job)?;
        clock.lap("turn", &mut result.stats.steps);
        match solved {
            Ok((model, decision)) => {
                let solved = turned(&mut result, model, decision);
                export::fill(&mut result, frames, &setup, solved, progress)?;
                clock.lap("points", &mut result.stats.steps);
                return Ok(result);
            }
            Err(why) => tried = Some(why),
        }
    }
    result.features = sift::extract_all(frames, &config.sift, progress)?;
    clock.lap("features", &mut result.stats.steps);
    let pairs = pairs::choose_pairs(frames, &result.features, &config.pairs);
    result.stats.pairs_matched = pairs.len();
    let matches = matching::match_pairs(&result.features, &pairs, &config.matching, progress)?;
    clock.lap("matching", &mut result.stats.steps);
    result.geometries = two_view::verify_pairs(
        &result.features,
        &result.initial_cameras,
        matches,
        &config.two_view,
        config.seed,
        progress,
    )?;
    clock.lap("verification", &mut result.stats.steps);
    result.stats.features = result.features.iter().map(Features::len).sum();
    result.stats.pairs_verified = result.geometries.len();
    result.decisions.push(pairs_decision(pairs.len(), frames.len(), &result.geometries));
    let model = solve(config, &setup, &result.features, &result.geometries, progress)?;
    clock.lap("mapping", &mut result.stats.steps);
    match model {
        Some(model) => export::fill(&mut result, frames, &setup, model, progress)?,
        None => result.reason = why_no_model(&result.features, &result.geometries),
    }
    clock.lap("points", &mut result.stats.steps);
    if let Some(why) = tried {
        note_attempt(&mut result.decisions, why);
    }
    Ok(result)
}

/// Takes a turn's features, matches and decisions over; what is left is its model.
fn turned(result: &mut SfmResult, model: VideoModel, decision: Decision) -> Solved {
    result.stats.pairs_matched = model.matched;
    result.stats.pairs_verified = model.geometries.len();
    result.stats.features = model.keypoints.iter().map(Vec::len).sum();
    (result.features, result.geometries) = (model.features, model.geometries);
    let state = model.turned.state;
    let decisions = std::iter::once(decision).chain(model.turned.decisions).collect();
    Solved { state, keypoints: model.keypoints, decisions, uncertainty: model.turned.uncertainty }
}

/// Says beside the decision on the motion what the search along the video came to.
fn note_attempt(decisions: &mut Vec<Decision>, why: String) {
    match decisions.iter_mut().find(|d| d.what == "motion") {
        Some(d) => d.evidence = format!("{}; along the video: {why}", d.evidence),
        None => decisions.push(single_axis::decision("free", format!("along the video: {why}"))),
    }
}

/// A model, and what was learned with it.
pub(crate) struct Solved {
    state: State,
    keypoints: Vec<Vec<glam::DVec2>>,
    decisions: Vec<Decision>,
    uncertainty: Option<Uncertainty>,
}

fn solve(
    config: &SfmConfig,
    setup: &Setup,
    features: &[Features],
    geometries: &[TwoViewGeometry],
    progress: &Progress,
) -> Result<Option<Solved>, SfmError> {
    progress.begin("mapping", features.len());
    let keypoints: Vec<_> = features.iter().map(positions).collect();
    let tracks = build_tracks(features, geometries);
    let input = Input {
        keypoints: &keypoints,
        tracks: &tracks,
        camera_of: &setup.camera_of,
        geometries,
        config: &config.mapper,
        seed: config.seed,
    };
    let named = config.camera_model.model();
    let job = |starts| Job {
        input: &input,
        cameras: &setup.cameras,
        known: &setup.known,
        starts,
        named,
        config: &config.motion,
        features: &[],
        progress,
    };
    let done = |turned: Turned, motion: Option<Decision>, keypoints: Vec<Vec<glam::DVec2>>| Solved {
        state: turned.state,
        keypoints,
        decisions: motion.into_iter().chain(turned.decisions).collect(),
        uncertainty: turned.uncertainty,
    };
    let Some(mut state) = incremental::map(&input, &setup.cameras, &setup.known, progress)? else {
        let motion = consider(&job(&setup.cameras), None)?;
        return Ok(motion.taken.map(|turned| done(turned, motion.decision, keypoints.clone())));
    };
    let starts = incremental::starts_of(&setup.cameras, &setup.known, &state);
    let (intrinsics, decision) = decide(&state, &input, &setup.known, &starts, named, progress)?;
    polish(&mut state, &input, &setup.known, &starts, intrinsics, progress)?;
    let motion = consider(&job(&starts), Some(&Free { state: &state, intrinsics }))?;
    if let Some(turned) = motion.taken {
        return Ok(Some(done(turned, motion.decision, keypoints.clone())));
    }
    let uncertainty = uncertainty(&state, &input, &setup.known, &starts, intrinsics)?;
    let decisions = std::iter::once(decision).chain(motion.decision).collect();
    Ok(Some(Solved { state, keypoints, decisions, uncertainty }))
}

fn pairs_decision(pairs: usize, images: usize, geometries: &[TwoViewGeometry]) -> Decision {
    let all = images * images.saturating_sub(1) / 2;
    let inliers: usize = geometries.iter().map(|g| g.inliers.len()).sum();
    Decision {
        what: "image pairs".to_owned(),
        chosen: format!("{} of {pairs} matched pairs", geometries.len()),
        evidence: format!(
            "{pairs} of {all} possible pairs were matched; {inliers} matches agree with one motion a pair"
        ),
    }
}

fn why_no_model(features: &[Features], geometries: &[TwoViewGeometry]) -> String {
    let most = features.iter().map(Features::len).max().unwrap_or(0);
    if most < 50 {
        return format!(
            "at most {most} features were found in an image: too dark, too blurred or without texture"
        );
    }
    if geometries.is_empty() {
        return "no two images show the same points: film more slowly, or from fewer sides".to_owned();
    }
    format!(
        "{} image pairs agree, but none has enough baseline to start from: move the camera sideways",
        geometries.len()
    )
}

#[cfg(test)]
mod tests;
