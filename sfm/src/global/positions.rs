//! Global positioning: all camera centres and points at once from bearings, once rotations are
//! known (Pan et al., "Global Structure-from-Motion Revisited", ECCV 2024). No pair's direction of
//! motion is asked, which says nothing where cameras move along a line, and no start is needed.

use crate::ceres::{self, PositionInput};
use crate::error::SfmError;
use crate::incremental::state::MappingInput;
use glam::{DQuat, DVec3};
use rand::Rng as _;
use scene::{Camera, Progress, rng};

/// Tracks of which every image should see as many, as long as there are any.
/// Source: judgement: keeps the problem small; no bench chose it.
const TRACKS_PER_IMAGE: usize = 120;
/// Where the loss bends: bearings off by so much (radians) pull less.
/// Source: judgement, about 6°: pairs that verify are exact to far less.
const BEND: f64 = 0.1;

/// Centres of the images with a rotation, and the points that gave them with their tracks; `None`
/// where too few tracks are seen often enough.
pub(crate) struct Positions {
    /// World frame; images without a rotation or without a track have none.
    pub centres: Vec<Option<DVec3>>,
    /// (track, position).
    pub points: Vec<(u32, DVec3)>,
}

/// Solves for the images that have `rotations` (`image_from_world`).
pub(crate) fn solve(
    input: &MappingInput<'_>,
    cameras: &[Camera],
    rotations: &[Option<DQuat>],
    progress: &Progress,
) -> Result<Option<Positions>, SfmError> {
    let tracks = choose_tracks(input, rotations);
    let mut number = vec![u32::MAX; rotations.len()];
    let mut images = 0;
    let mut problem = PositionInput {
        loss_scale: BEND,
        max_iterations: 100,
        function_tolerance: 1e-5,
        ..PositionInput::default()
    };
    for (point, (_, views)) in (0u32..).zip(&tracks) {
        for &[image, feature] in views {
            let image = image as usize;
            let Some(rotation) = rotations[image] else { continue };
            if number[image] == u32::MAX {
                number[image] = images;
                images += 1;
            }
            let ray = cameras[input.camera_of[image]].ray(input.keypoints[image][feature as usize]);
            let direction = rotation.conjugate() * ray;
            if direction.is_finite() {
                problem.observation_camera.push(number[image]);
                problem.observation_point.push(point);
                problem.directions.extend(direction.to_array());
            }
        }
    }
    if images < 3 {
        return Ok(None);
    }
    let mut random = rng::rng(input.seed, "global positions", 0);
    let mut anywhere =
        |n: usize| -> Vec<f64> { (0..3 * n).map(|_| random.random_range(-1.0..1.0)).collect() };
    let (mut centres, mut points) = (anywhere(images as usize), anywhere(tracks.len()));
    if !ceres::positions(&problem, &mut centres, &mut points, progress)? {
        return Ok(None);
    }
    let mut found = Positions { centres: Vec::new(), points: Vec::new() };
    for n in number {
        let known = n != u32::MAX;
        found.centres.push(known.then(|| DVec3::from_slice(&centres[3 * n as usize..])));
    }
    for ((track, _), point) in tracks.iter().zip(points.chunks_exact(3)) {
        found.points.push((*track, DVec3::from_slice(point)));
    }
    Ok(Some(found))
}

/// The longest tracks, until every image sees enough of them: (track, views in images with a
/// rotation).
fn choose_tracks(input: &MappingInput<'_>, rotations: &[Option<DQuat>]) -> Vec<(u32, Vec<[u32; 2]>)> {
    let mut ranked: Vec<(usize, u32)> = Vec::new();
    for (track, views) in (0u32..).zip(&input.tracks.views) {
        let known = views.iter().filter(|v| rotations[v[0] as usize].is_some()).count();
        // Two bearings meet nearly somewhere whatever the directions of motion.
        if known > 2 {
            ranked.push((known, track));
        }
    }
    ranked.sort_unstable_by_key(|&(n, track)| (std::cmp::Reverse(n), track));
    let mut seen = vec![0usize; rotations.len()];
    let mut chosen = Vec::new();
    for (_, track) in ranked {
        let views = input.tracks.views[track as usize].iter();
        let views: Vec<[u32; 2]> = views.copied().filter(|v| rotations[v[0] as usize].is_some()).collect();
        if views.iter().any(|v| seen[v[0] as usize] < TRACKS_PER_IMAGE) {
            views.iter().for_each(|v| seen[v[0] as usize] += 1);
            chosen.push((track, views));
        }
    }
    chosen
}
