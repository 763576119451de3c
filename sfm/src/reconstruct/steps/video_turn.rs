//! The model of a video in which something turns about one axis before a camera that stands still:
//! from followed points, without any of the other steps.

use crate::circular::{Motion, VideoJob, solve_video};
use crate::reconstruct::context::{FeatureOrigin, StepContext};
use crate::reconstruct::model::{SfmModel, StepResult};

/// Solves for a turn, where the frames are a video's and nothing was supplied.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let StepContext { frames, config, source, progress } = *context;
    let wanted = matches!(config.motion.motion, Motion::Auto | Motion::SingleAxis);
    if !frames.is_video || !wanted || source != FeatureOrigin::Images || model.matches.is_some() {
        return Ok((model, Vec::new()));
    }
    let (cameras, camera_of, known) = (&model.setup.cameras, &model.setup.camera_of, &model.setup.known);
    let found = solve_video(&VideoJob { frames, config, cameras, camera_of, known, progress })?;
    let (video, motion) = match found {
        Ok(found) => found,
        Err(why) => {
            model.no_video_motion = Some(why);
            return Ok((model, Vec::new()));
        }
    };
    model.stats.pairs_matched = video.matched;
    model.stats.pairs_verified = video.geometries.len();
    model.stats.features = video.keypoints.iter().map(Vec::len).sum();
    model.features = video.features;
    model.geometries = video.geometries;
    model.keypoints = video.keypoints;
    let mut decisions = vec![motion];
    decisions.extend(model.adopt_turn(video.solution));
    Ok((model, decisions))
}
