//! How far the matches of all verified pairs, and the keypoints that they tie, agree with a model:
//! within a limit in pixels that the model's own errors do not widen.

use crate::incremental::state::{MapState, MappingInput};
use crate::solvers::{essential_from_pose, sampson_sq};
use crate::tracks::NONE;
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use scene::{Camera, TwoViewGeometry};

/// Largest distance of what agrees, longer image sides: 2 px of 640.
/// Source: derived; keypoints are found to half a pixel, and matches are verified to 2 px.
const LIMIT: f64 = 1.0 / 320.0;
/// What agrees within the limit, pixels.
pub(super) fn limit_px(camera: &Camera) -> f64 {
    LIMIT * f64::from(camera.width.max(camera.height))
}

/// Share of the matches of verified pairs between images with a pose that agree with the model.
pub(super) fn agreeing_share(state: &MapState, input: &MappingInput<'_>) -> f64 {
    let of_pairs: Vec<(usize, usize)> =
        input.geometries.par_iter().filter_map(|g| agreeing(state, input, g)).collect();
    let (agree, all) = of_pairs.iter().fold((0, 0), |s, p| (s.0 + p.0, s.1 + p.1));
    agree as f64 / all as f64
}

/// Matches of a pair: (within the limit of their epipolar lines, all); `None` without two poses.
fn agreeing(state: &MapState, input: &MappingInput<'_>, g: &TwoViewGeometry) -> Option<(usize, usize)> {
    let [a, b] = [state.poses[g.a]?, state.poses[g.b]?];
    let cameras = [g.a, g.b].map(|i| &state.cameras[input.camera_of[i]]);
    let inverse =
        cameras.map(|c| DMat3::from_diagonal(DVec3::new(1.0, 1.0, c.mean_focal()) / c.mean_focal()));
    let m = inverse[1] * essential_from_pose(&b.compose(&a.inverse())) * inverse[0];
    let limit = limit_px(cameras[0]).max(limit_px(cameras[1]));
    let (mut count, mut all) = (0, 0);
    for pair in &g.inliers {
        let (Some(u), Some(v)) =
            (input.keypoints[g.a].get(pair[0] as usize), input.keypoints[g.b].get(pair[1] as usize))
        else {
            continue;
        };
        let [u, v] = [cameras[0].unproject(*u), cameras[1].unproject(*v)];
        let (u, v) = (u * cameras[0].mean_focal(), v * cameras[1].mean_focal());
        count += usize::from(sampson_sq(&m, u, v) < limit * limit);
        all += 1;
    }
    (all > 0).then_some((count, all))
}

/// For each image with a pose that verified pairs tie to others: its keypoints that they tie, and
/// how many of these see a point of the model within the limit: (these, all).
pub(super) fn explained_keypoints(state: &MapState, input: &MappingInput<'_>) -> Vec<(usize, usize)> {
    let mut tied: Vec<Vec<bool>> = input.keypoints.iter().map(|k| vec![false; k.len()]).collect();
    for g in input.geometries {
        if state.poses[g.a].is_none() || state.poses[g.b].is_none() {
            continue;
        }
        for m in &g.inliers {
            for (image, feature) in [(g.a, m[0]), (g.b, m[1])] {
                if let Some(tied) = tied[image].get_mut(feature as usize) {
                    *tied = true;
                }
            }
        }
    }
    let mut images = state.order.clone();
    images.sort_unstable();
    let mut counts = Vec::with_capacity(images.len());
    for image in images {
        let features: Vec<usize> = (0..tied[image].len()).filter(|&f| tied[image][f]).collect();
        let explained = features.iter().filter(|&&f| is_explained(state, input, image, f)).count();
        counts.push((explained, features.len()));
    }
    // Of frames between the key frames of a video no pair says anything.
    counts.retain(|(_, all)| *all > 0);
    counts
}

fn is_explained(state: &MapState, input: &MappingInput<'_>, image: usize, feature: usize) -> bool {
    let point = state.point_of[image][feature];
    if point == NONE {
        return false;
    }
    let limit = limit_px(&state.cameras[input.camera_of[image]]);
    let position = state.points[point as usize].as_ref().map(|p| p.position);
    position.is_some_and(|x| state.error_sq(input, [image as u32, feature as u32], x) < limit * limit)
}
