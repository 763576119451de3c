//! From frames to a model: the order of the steps, and what each costs.

mod clock;
mod export;
mod setup;
mod turn;

use crate::incremental::finish::{decide, polish, uncertainty};
use crate::incremental::folds;
use crate::incremental::state::{Input, State};
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
    let mut lap = |step: &str| clock.lap(step, &mut result.stats.steps);
    let given = Given { config, setup: &setup, is_video: frames.is_video, features: &result.features };
    let model = solve(&given, &result.geometries, &mut lap, progress)?;
    match model {
        Some(model) => export::fill(&mut result, frames, model, progress)?,
        None => result.reason = why_no_model(&result.features, &result.geometries),
    }
    clock.lap("points", &mut result.stats.steps);
    Ok(result)
}

/// A model, and what was learned with it.
pub(crate) struct Solved {
    /// In the frames of the images as they are.
    state: State,
    /// For each image the camera of `state`.
    camera_of: Vec<usize>,
    keypoints: Vec<Vec<glam::DVec2>>,
    decisions: Vec<Decision>,
    uncertainty: Option<Uncertainty>,
}

/// What is known before the first pose.
struct Given<'a> {
    config: &'a SfmConfig,
    setup: &'a Setup,
    is_video: bool,
    features: &'a [Features],
}

/// `lap` is told the name of each step when it is done.
fn solve(
    given: &Given<'_>,
    geometries: &[TwoViewGeometry],
    lap: &mut dyn FnMut(&str),
    progress: &Progress,
) -> Result<Option<Solved>, SfmError> {
    let Given { config, setup, is_video, features } = *given;
    progress.begin("mapping", features.len());
    let keypoints: Vec<_> = features.iter().map(positions).collect();
    let tracks = build_tracks(features, geometries);
    let mut input = Input {
        keypoints: &keypoints,
        tracks: &tracks,
        camera_of: &setup.camera_of,
        geometries,
        config: &config.mapper,
        may_be_turned: !is_video,
        seed: config.seed,
    };
    let mapped = incremental::map(&input, &setup.cameras, &setup.known, progress)?;
    lap("mapping");
    let Some(mut state) = mapped else { return Ok(None) };
    let mut decisions = Vec::new();
    let (kept, kept_tracks);
    if let Some(plausible) = folds::unfolded(&state, &input, is_video) {
        kept = plausible.iter().map(|&i| geometries[i].clone()).collect::<Vec<_>>();
        kept_tracks = build_tracks(features, &kept);
        let whole = Input { tracks: &kept_tracks, geometries: &kept, ..input };
        let second = incremental::map(&whole, &setup.cameras, &setup.known, progress)?;
        if let Some(second) = second.filter(|s| folds::better(s, &state, &input, is_video)) {
            decisions.push(folds::decision(&second, &state, &input, kept.len(), is_video));
            (state, input) = (second, whole);
        }
    }
    lap("repeated structure");
    let starts = incremental::starts_of(&setup.cameras, &setup.known, &state);
    let named = config.camera_model.model();
    let verdict = decide(&state, &input, &setup.known, &starts, named, progress)?;
    lap("camera model");
    // From here on every image is the way up that its sensor was.
    let turned = verdict.turned.unwrap_or_else(|| vec![false; features.len()]);
    let (upright, upright_geometries) = turn::inputs(&input, &setup.cameras, &turned);
    turn::poses(&mut state, &turned);
    (input.keypoints, input.geometries) = (&upright, &upright_geometries);
    polish(&mut state, &input, &setup.known, &starts, verdict.intrinsics, progress)?;
    lap("final adjustment");
    let uncertainty = uncertainty(&state, &input, &setup.known, &starts, verdict.intrinsics)?;
    lap("covariance");
    decisions.extend(verdict.decisions);
    let mut solved = Solved { state, camera_of: setup.camera_of.clone(), keypoints, decisions, uncertainty };
    turn::back(&mut solved, &turned);
    Ok(Some(solved))
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
