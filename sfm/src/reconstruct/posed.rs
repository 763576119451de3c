//! Poses that came without points: features of the images are matched along the lines of the given
//! poses and triangulated.
//!
//! in: frames and a model whose images bear their names · out: the same cameras and poses, with
//! observations and points. Nothing is adjusted: what does not agree with the poses becomes no
//! point.

use super::along_poses::PosedImages;
use super::export::{colour, convert};
use crate::config::SfmConfig;
use crate::error::SfmError;
use crate::incremental::state::{MapState, MappingInput};
use crate::limits::WIDEST_ANGLE;
use crate::sift;
use crate::tracks::{build_tracks, positions};
use crate::triangulation::angle_between;
use glam::{DVec2, DVec3};
use scene::{Camera, Frame, FrameSet, Pose, Progress, Reconstruction};
use std::collections::{BTreeMap, BTreeSet};

/// An image is matched with the one nearest to each of these angles from it, degrees, as with
/// neighbours alone a video has no baselines; and with as many nearest ones.
/// Source: chosen by hand, never measured.
const FARTHER_DEG: [f64; 5] = [6.0, 10.0, 15.0, 22.0, 30.0];

/// The model with points; without any where the images share none, or are fewer than two.
pub fn triangulate_given(
    frames: &FrameSet,
    model: &Reconstruction,
    config: &SfmConfig,
    progress: &Progress,
) -> Result<Reconstruction, SfmError> {
    let ids: BTreeMap<&str, u32> = model.images.values().map(|i| (i.name.as_str(), i.id)).collect();
    let posed: Vec<Frame> =
        frames.frames.iter().filter(|f| ids.contains_key(f.name.as_str())).cloned().collect();
    if posed.len() < 2 {
        return Ok(model.clone());
    }
    let frames = FrameSet { frames: posed, ..frames.clone() };
    let cameras: Vec<Camera> = model.cameras.values().cloned().collect();
    let image_of: Vec<u32> = frames.frames.iter().map(|f| ids[f.name.as_str()]).collect();
    let ids = image_of.iter().map(|id| model.images[id].camera);
    let camera_of: Vec<usize> = ids.map(|id| cameras.iter().position(|c| c.id == id).unwrap_or(0)).collect();
    let poses: Vec<Pose> = image_of.iter().map(|id| model.images[id].pose).collect();
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
    let pairs = neighbours(&poses);
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

/// Pairs of images that may share points, lower index first.
fn neighbours(poses: &[Pose]) -> Vec<(usize, usize)> {
    let axes: Vec<DVec3> = poses.iter().map(|p| p.rotation.conjugate() * DVec3::Z).collect();
    let centres: Vec<DVec3> = poses.iter().map(Pose::centre).collect();
    let mean = centres.iter().sum::<DVec3>() / centres.len().max(1) as f64;
    let extent = centres.iter().map(|c| c.distance(mean)).fold(1e-300, f64::max);
    let mut pairs = BTreeSet::new();
    for a in 0..poses.len() {
        // Cameras side by side look the same way: then the distance tells which are near.
        let mut others: Vec<(f64, usize)> = Vec::new();
        for b in (0..poses.len()).filter(|&b| b != a) {
            let distance = centres[a].distance(centres[b]) / extent;
            others.push((angle_between(axes[a], axes[b]) + 0.1 * distance, b));
        }
        others.retain(|(far, _)| *far <= WIDEST_ANGLE);
        others.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        let farther = FARTHER_DEG.map(f64::to_radians).into_iter();
        let farther = farther.filter_map(|angle| {
            others.iter().min_by(|x, y| (x.0 - angle).abs().total_cmp(&(y.0 - angle).abs()))
        });
        let partners = others.iter().take(FARTHER_DEG.len()).chain(farther);
        pairs.extend(partners.map(|&(_, b)| (a.min(b), a.max(b))));
    }
    pairs.into_iter().collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_paired_with_their_neighbours_and_with_some_farther_ones() {
        let ring = |n: usize| -> Vec<Pose> {
            let angle = |k: usize| k as f64 / n as f64 * std::f64::consts::TAU;
            let eye = |a: f64| DVec3::new(3.0 * a.cos(), 3.0 * a.sin(), 0.4);
            (0..n).map(|k| Pose::look_at(eye(angle(k)), DVec3::ZERO, DVec3::Z)).collect()
        };
        let pairs = neighbours(&ring(144));
        assert!(pairs.iter().all(|(a, b)| a < b) && pairs.len() < 144 * 10);
        let steps = |(a, b): &(usize, usize)| (b - a).min(144 - (b - a));
        assert!((1..=2).all(|s| pairs.iter().filter(|p| steps(p) == s).count() == 144));
        assert!(pairs.iter().any(|p| steps(p) >= 11), "nothing far enough to triangulate by");
        assert!(neighbours(&ring(1)).is_empty() && neighbours(&[]).is_empty());
        // Opposite sides of an object share nothing; cameras side by side are told apart by their
        // places.
        assert!(neighbours(&ring(2)).is_empty());
        let side = |k: i32| {
            let eye = DVec3::new(f64::from(k), 0.0, 0.0);
            Pose::look_at(eye, eye + DVec3::Y, DVec3::Z)
        };
        let row = neighbours(&(0..40).map(side).collect::<Vec<_>>());
        assert!((0..39).all(|k| row.contains(&(k, k + 1))) && row.len() < 400);
    }
}
