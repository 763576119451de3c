//! From frames to a model: the order of the steps, and what each costs.

mod clock;
mod export;
mod setup;

use crate::incremental::finish::{decide, polish, uncertainty};
use crate::incremental::state::{Input, State};
use crate::single_axis::{Free, Job, consider};
use crate::tracks::{build_tracks, positions};
use crate::{
    Decision, SfmConfig, SfmError, SfmResult, Uncertainty, incremental, matching, pairs, sift, two_view,
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
    Ok(result)
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
    let Some(mut state) = incremental::map(&input, &setup.cameras, &setup.known, progress)? else {
        return Ok(None);
    };
    let starts = incremental::starts_of(&setup.cameras, &setup.known, &state);
    let named = config.camera_model.model();
    let (intrinsics, decision) = decide(&state, &input, &setup.known, &starts, named, progress)?;
    polish(&mut state, &input, &setup.known, &starts, intrinsics, progress)?;
    let job = Job {
        input: &input,
        cameras: &setup.cameras,
        known: &setup.known,
        starts: &starts,
        named,
        config: &config.motion,
        progress,
    };
    let motion = consider(&job, Some(&Free { state: &state, intrinsics }))?;
    if let Some(turned) = motion.taken {
        let decisions = turned.decisions.into_iter().chain(motion.decision).collect();
        return Ok(Some(Solved {
            state: turned.state,
            keypoints,
            decisions,
            uncertainty: turned.uncertainty,
        }));
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
