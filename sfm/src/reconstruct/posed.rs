//! Poses that came without points: features of the images are matched along the lines of the given
//! poses and triangulated.
//!
//! in: frames and a model whose images bear their names · out: the same cameras and poses, with
//! observations and points. Nothing is adjusted: what does not agree with the poses becomes no
//! point.

use super::along_poses::PosedImages;
use super::export::{colour, convert};
use super::given::{GivenPoses, neighbours};
use crate::config::SfmConfig;
use crate::error::SfmError;
use crate::incremental::state::{MapState, MappingInput};
use crate::limits::WIDEST_ANGLE;
use crate::sift;
use crate::tracks::{build_tracks, positions};
use glam::DVec2;
use scene::{FrameSet, Progress, Reconstruction};

/// The model with points; without any where the images share none, or are fewer than two.
pub fn triangulate_given(
    frames: &FrameSet,
    model: &Reconstruction,
    config: &SfmConfig,
    progress: &Progress,
) -> Result<Reconstruction, SfmError> {
    let given = GivenPoses::of(frames, model);
    if given.poses.len() < 2 {
        return Ok(model.clone());
    }
    let GivenPoses { frames, ids: image_of, cameras, camera_of, poses } = given;
    let features = sift::extract_all(&frames, &config.sift, progress)?;
    let keypoints: Vec<Vec<DVec2>> = features.iter().map(positions).collect();
    let images = PosedImages {
        features: &features,
        keypoints: &keypoints,
        cameras: camera_of.iter().map(|&c| &cameras[c]).collect(),
        poses: poses.iter().copied().map(Some).collect(),
    };
    // Lines of poses that are given are more exact than those of two images' matches alone.
    let limits = (0.5 * config.two_view.max_error_px, config.mapper.min_observations);
    let pairs = neighbours(&poses, WIDEST_ANGLE);
    let geometries = images.match_along_lines(&pairs, &[], limits, &config.matching, progress)?;
    let tracks = build_tracks(&features, &geometries);
    let sigmas = vec![Vec::new(); features.len()];
    let input = MappingInput {
        keypoints: &keypoints,
        sigmas: &sigmas,
        tracks: &tracks,
        camera_of: &camera_of,
        geometries: &geometries,
        config: &config.mapper,
        is_video: frames.is_video,
        skip: &config.skip,
        seed: config.seed,
    };
    let mut state = MapState::new(&input, cameras.clone());
    poses.iter().enumerate().for_each(|(i, pose)| state.register(i, *pose));
    for _ in 0..2 {
        state.grow_all(&input);
        state.refine_points(&input, |_| false);
        state.filter(&input, config.mapper.max_reprojection_px);
    }
    let mut found = convert(&state, &camera_of, &keypoints, &frames.frames);
    colour(&mut found, &frames, progress)?;
    Ok(renumber(found, &image_of))
}

/// The model with the images' numbers as they were given.
fn renumber(mut model: Reconstruction, image_of: &[u32]) -> Reconstruction {
    let images = std::mem::take(&mut model.images);
    model.images = images
        .into_values()
        .map(|mut image| {
            image.id = image_of[image.id as usize - 1];
            (image.id, image)
        })
        .collect();
    for element in model.points.values_mut().flat_map(|p| &mut p.track) {
        element.image = image_of[element.image as usize - 1];
    }
    model
}
