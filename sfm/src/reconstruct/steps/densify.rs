//! Few images: once a model stands, its own epipolar lines are searched for matches in all pairs,
//! those that were too few to verify by themselves among them. The points gained bind wide steps
//! together.

use crate::error::SfmError;
use crate::incremental::finish::noise_of;
use crate::incremental::state::{MapState, MappingInput};
use crate::limits::{LEAST_ERROR_PX, OUTLIER_SIGMAS};
use crate::model_selection::accept::{Change, Support, accept};
use crate::reconstruct::along_poses::PosedImages;
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};
use crate::tracks::build_tracks;
use scene::TwoViewGeometry;

/// Images up to which it is worth its cost (some milliseconds a pair).
/// Source: docs/decisions/05.
const UP_TO: usize = 30;

/// Takes the pairs with what lies on the model's epipolar lines, and the tracks they make, where
/// that is more.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    if model.features.len() > UP_TO {
        return Ok((model, Vec::new()));
    }
    let more = match_along_model(&model, context)?;
    let [before, after] =
        [&model.geometries, &more].map(|pairs| Support::of(pairs.iter().map(|g| g.inliers.len()).sum()));
    if accept(Change::DenserTracks, &before, &after) {
        model.keep_verified();
        model.tracks = build_tracks(&model.features, &more);
        model.geometries = more;
        let input = model.input(context);
        model.state = model.settle(regrow(&model.state, &input), &input, model.intrinsics, context)?;
    }
    Ok((model, Vec::new()))
}

/// All pairs, with the matches that lie on the lines of the model's poses.
fn match_along_model(model: &SfmModel, context: &StepContext<'_>) -> Result<Vec<TwoViewGeometry>, SfmError> {
    let (state, input) = (&model.state, model.input(context));
    let n = model.features.len();
    let pairs: Vec<(usize, usize)> = (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b))).collect();
    let band = OUTLIER_SIGMAS * noise_of(state, &input);
    let band = band.clamp(LEAST_ERROR_PX, input.config.max_reprojection_px);
    let images = PosedImages {
        features: &model.features,
        keypoints: &model.keypoints,
        cameras: input.camera_of.iter().map(|&c| &state.cameras[c]).collect(),
        poses: state.poses.clone(),
    };
    let (fewest, matching) = (input.config.min_observations, &context.config.matching);
    images.match_along_lines(&pairs, input.geometries, (band, fewest), matching, context.progress)
}

/// The same poses and intrinsics with the points of other tracks.
fn regrow(state: &MapState, input: &MappingInput<'_>) -> MapState {
    let mut grown = MapState::new(input, state.cameras.clone());
    for &image in &state.order {
        if let Some(pose) = state.poses[image] {
            grown.register(image, pose);
        }
    }
    grown.grow_all(input);
    grown
}
