//! Few images: once a model stands, its own epipolar lines are searched for matches in all pairs,
//! those that were too few to verify by themselves among them. The points gained bind wide steps
//! together.

use crate::SfmError;
use crate::incremental::finish::noise_of;
use crate::incremental::initial::calibration;
use crate::incremental::state::{MapState, MappingInput};
use crate::limits::{LEAST_ERROR_PX, OUTLIER_SIGMAS, WIDEST_ANGLE};
use crate::matching::{PreparedFeatures, guided_match_prepared};
use crate::model_selection::accept::{Change, Support, accept};
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};
use crate::solvers::essential_from_pose;
use crate::tracks::build_tracks;
use crate::triangulation::angle_between;
use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;
use scene::{Camera, Features, Pose, TwoViewGeometry, TwoViewKind};
use std::collections::HashSet;

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
    let (state, input, progress) = (&model.state, model.input(context), context.progress);
    let n = model.features.len();
    let cameras: Vec<&Camera> = input.camera_of.iter().map(|&c| &state.cameras[c]).collect();
    let ideal: Vec<Features> =
        (0..n).map(|i| undistort_features(&model.features[i], &input.keypoints[i], cameras[i])).collect();
    let prepared: Vec<PreparedFeatures> = model.features.par_iter().map(PreparedFeatures::new).collect();
    let band = OUTLIER_SIGMAS * noise_of(state, &input);
    let band = band.clamp(LEAST_ERROR_PX, input.config.max_reprojection_px);
    let pairs: Vec<(usize, usize)> = (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b))).collect();
    progress.begin("matching along the model's lines", pairs.len());
    let one = |&(a, b): &(usize, usize)| -> Result<Option<TwoViewGeometry>, SfmError> {
        progress.tick()?;
        let known = input.geometries.iter().find(|g| (g.a, g.b) == (a, b));
        let (Some(pose_a), Some(pose_b)) = (&state.poses[a], &state.poses[b]) else {
            return Ok(known.cloned());
        };
        let [axis_a, axis_b] = [pose_a, pose_b].map(|pose| pose.rotation.conjugate() * DVec3::Z);
        if angle_between(axis_a, axis_b) > WIDEST_ANGLE {
            return Ok(known.cloned());
        }
        let (f, b_from_a) = line_between((pose_a, cameras[a]), (pose_b, cameras[b]));
        let [a_side, b_side] = [a, b].map(|i| (&ideal[i], &prepared[i]));
        let found = guided_match_prepared(a_side, b_side, &f, band, &context.config.matching);
        Ok(merge_geometry(known, (a, b), found, &f, b_from_a, input.config.min_observations))
    };
    let more: Result<Vec<Option<TwoViewGeometry>>, SfmError> = pairs.par_iter().map(one).collect();
    Ok(more?.into_iter().flatten().collect())
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

/// The fundamental matrix between the ideal images of two posed cameras, and the pose of b in a.
pub(crate) fn line_between(a: (&Pose, &Camera), b: (&Pose, &Camera)) -> (DMat3, Pose) {
    let b_from_a = b.0.compose(&a.0.inverse());
    let e = essential_from_pose(&b_from_a);
    (calibration(b.1).inverse().transpose() * e * calibration(a.1).inverse(), b_from_a)
}

/// One-to-one matches: the pair's own inliers first, then what was found and does not contradict
/// them.
pub(crate) fn merge_geometry(
    known: Option<&TwoViewGeometry>,
    (a, b): (usize, usize),
    found: Vec<[u32; 2]>,
    f: &DMat3,
    b_from_a: Pose,
    fewest: usize,
) -> Option<TwoViewGeometry> {
    let mut inliers = known.map(|g| g.inliers.clone()).unwrap_or_default();
    let (of_a, of_b): (HashSet<u32>, HashSet<u32>) = inliers.iter().map(|m| (m[0], m[1])).unzip();
    let fresh: Vec<[u32; 2]> =
        found.into_iter().filter(|m| !of_a.contains(&m[0]) && !of_b.contains(&m[1])).collect();
    if known.is_none() && fresh.len() < fewest {
        return None;
    }
    inliers.extend(fresh);
    inliers.sort_unstable();
    if let Some(known) = known {
        return Some(TwoViewGeometry { inliers, ..known.clone() });
    }
    Some(TwoViewGeometry {
        a,
        b,
        kind: TwoViewKind::Calibrated,
        inliers,
        f: Some(*f),
        e: Some(essential_from_pose(&b_from_a)),
        h: None,
        b_from_a: Some(b_from_a),
        median_angle: 0.0,
    })
}

/// Keypoints where an ideal camera of the same focal length would see them.
pub(crate) fn undistort_features(features: &Features, keypoints: &[DVec2], camera: &Camera) -> Features {
    let mut result = Features { keypoints: features.keypoints.clone(), descriptors: Vec::new() };
    for (k, pixel) in result.keypoints.iter_mut().zip(keypoints) {
        let p = camera.unproject(*pixel) * camera.focal() + camera.principal_point();
        (k.x, k.y) = (p.x as f32, p.y as f32);
    }
    result
}
