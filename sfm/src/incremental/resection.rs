//! Which image comes next, and where it was taken.

use super::adjust::plausible;
use super::state::{MapState, MappingInput};
use crate::ransac::{RansacConfig, estimate_absolute_pose};
use crate::solvers::{AbsoluteRefinement, refine_absolute};
use crate::tracks::NONE;
use glam::{DVec2, DVec3};
use scene::{Camera, Pose};

/// Focal lengths to try for a camera that nothing is known of, as factors of the guess: fields of
/// view of about 90° to 12° for a guess of 1.2 image widths.
/// Source: derived: a geometric series of factors of about 1.45 over the fields of view.
pub(crate) const FOCAL_FACTORS: [f64; 6] = [1.0, 0.7, 1.45, 0.45, 2.1, 3.2];

/// Observations of model points by an image that is not registered: (feature, point).
pub(crate) fn visible(state: &MapState, input: &MappingInput<'_>, image: usize) -> Vec<(u32, u32)> {
    let tracks = input.tracks.of[image].iter().zip(0u32..).filter(|(t, _)| **t != NONE);
    tracks.filter_map(|(&t, feature)| Some((feature, *state.of_track[t as usize].first()?))).collect()
}

/// How well the observations are spread: on each of six grids of 2ˡ × 2ˡ cells an occupied cell
/// counts 4ˡ (Schönberger & Frahm, CVPR 2016, §4.2).
pub(crate) fn spread(camera: &Camera, pixels: impl Iterator<Item = DVec2>) -> usize {
    /// Source: Schönberger & Frahm, CVPR 2016, section 4.2.
    const LEVELS: usize = 6;
    let finest = 1usize << LEVELS;
    let mut occupied = vec![false; finest * finest];
    let size = DVec2::new(f64::from(camera.width.max(1)), f64::from(camera.height.max(1)));
    for pixel in pixels {
        let cell = (pixel / size * finest as f64).clamp(DVec2::ZERO, DVec2::splat(finest as f64 - 1.0));
        occupied[cell.y as usize * finest + cell.x as usize] = true;
    }
    let (mut score, mut side) = (0, finest);
    while side > 1 {
        score += occupied.iter().filter(|&&o| o).count() * side * side;
        let half = side / 2;
        let any = |i: usize| {
            let (x, y) = (2 * (i % half), 2 * (i / half));
            [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)].iter().any(|(x, y)| occupied[y * side + x])
        };
        occupied = (0..half * half).map(any).collect();
        side = half;
    }
    score
}

/// Unregistered images by how well their observations of the model are spread, best first: (image,
/// observations).
pub(crate) fn next_images(state: &MapState, input: &MappingInput<'_>) -> Vec<(usize, usize)> {
    let mut ranked: Vec<(usize, usize, usize)> = Vec::new();
    for image in (0..state.poses.len()).filter(|&i| state.poses[i].is_none()) {
        let seen = visible(state, input, image);
        if seen.len() < input.config.min_observations {
            continue;
        }
        let pixels = seen.iter().map(|(f, _)| input.keypoints[image][*f as usize]);
        ranked.push((spread(&state.cameras[input.camera_of[image]], pixels), image, seen.len()));
    }
    ranked.sort_unstable_by_key(|&(score, image, _)| (std::cmp::Reverse(score), image));
    ranked.into_iter().map(|(_, image, count)| (image, count)).collect()
}

/// A resected image.
pub(crate) struct Resection {
    pub pose: Pose,
    /// Focal length found with the pose, where the camera's was unknown.
    pub focal: Option<f64>,
}

/// P3P in LO-RANSAC. With `search_focal`, several focal lengths are tried and the best one refined
/// with the pose.
pub(crate) fn resect(
    state: &MapState,
    input: &MappingInput<'_>,
    image: usize,
    search_focal: bool,
) -> Option<Resection> {
    let seen = visible(state, input, image);
    let pixels: Vec<DVec2> = seen.iter().map(|(f, _)| input.keypoints[image][*f as usize]).collect();
    let positions =
        seen.iter().map(|(_, p)| state.points[*p as usize].as_ref().map_or(DVec3::NAN, |p| p.position));
    let points: Vec<DVec3> = positions.collect();
    let camera = &state.cameras[input.camera_of[image]];
    let config = RansacConfig {
        threshold: 2.0 * input.config.max_reprojection_px,
        min_inliers: input.config.min_observations.max(6),
        max_iterations: 3000,
        seed: input.seed,
        ..RansacConfig::default()
    };
    let factors: &[f64] = if search_focal { &FOCAL_FACTORS } else { &[1.0] };
    let mut best: Option<(f64, Vec<usize>, Pose, Camera)> = None;
    for (i, factor) in factors.iter().enumerate() {
        let mut tried = camera.clone();
        tried.params[..camera.model.num_focals()].iter_mut().for_each(|f| *f *= factor);
        let stream = (image * FOCAL_FACTORS.len() + i) as u64;
        let Some(found) = estimate_absolute_pose(&tried, &pixels, &points, &config, stream) else { continue };
        if best.as_ref().is_none_or(|(score, ..)| found.score < *score) {
            best = Some((found.score, found.inliers, found.model, tried));
        }
    }
    let (_, inliers, pose, camera) = best?;
    if (inliers.len() as f64) < input.config.min_observation_ratio * seen.len() as f64 {
        return None;
    }
    if !search_focal {
        return Some(Resection { pose, focal: None });
    }
    let focal = camera.mean_focal();
    let ideal: Vec<DVec2> = pixels.iter().map(|p| camera.unproject(*p) * focal).collect();
    let start = AbsoluteRefinement { pose, focal };
    let refined = refine_absolute(start, &ideal, &points, &inliers, true, 2.0, 30);
    let mut solved = camera;
    solved.params[..solved.model.num_focals()].fill(refined.focal);
    plausible(&solved).then_some(Resection { pose: refined.pose, focal: Some(refined.focal) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::CameraModel;

    #[test]
    fn points_that_are_spread_out_count_more_than_a_cluster() {
        let camera = Camera::centred(1, CameraModel::SimplePinhole, 640, 480, 500.0);
        let cluster = (0..100).map(|i| DVec2::new(300.0 + f64::from(i % 10), 200.0 + f64::from(i / 10)));
        let wide =
            (0..100).map(|i| DVec2::new(60.0 * f64::from(i % 10) + 30.0, 45.0 * f64::from(i / 10) + 20.0));
        assert!(spread(&camera, wide) > 10 * spread(&camera, cluster));
        assert_eq!(spread(&camera, std::iter::empty()), 0);
        assert!(spread(&camera, std::iter::once(DVec2::new(1e9, -1e9))) > 0);
    }
}
