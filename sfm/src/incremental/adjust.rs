//! Bundle adjustment of the growing model.

use super::state::{MapState, MappingInput};
use crate::bundle::{BundleObservation, BundleProblem, IntrinsicsPrior, SolveOptions};
use crate::error::SfmError;
use scene::{Camera, Pose, Progress};
use std::collections::HashMap;

/// What an adjustment of the growing model solves for.
#[derive(Clone, Debug)]
pub(crate) struct Adjustment {
    /// For each camera, which parameters are free.
    pub free: Vec<Vec<bool>>,
    /// Priors on intrinsics.
    pub priors: Vec<IntrinsicsPrior>,
    /// Images that may move; `None`: all.
    pub moving: Option<Vec<usize>>,
    /// Points enough that every image sees so many of them; `None`: all points.
    pub points_per_image: Option<usize>,
    /// When to stop, and the loss.
    pub solve: SolveOptions,
}

impl Adjustment {
    /// While the model grows: rough, robust.
    pub(crate) fn growing(free: Vec<Vec<bool>>, priors: Vec<IntrinsicsPrior>) -> Self {
        Self { free, priors, moving: None, points_per_image: None, solve: SolveOptions::rough() }
    }
}

/// The adjustment as plain arrays, with the numbers of its points and the images of its poses.
pub(crate) struct Selected {
    pub problem: BundleProblem,
    pub points: Vec<u32>,
    pub images: Vec<usize>,
}

/// Adjusts the model in place; returns the root mean square residual after (robust cost), pixels.
pub(crate) fn adjust(
    state: &mut MapState,
    input: &MappingInput<'_>,
    what: &Adjustment,
    progress: &Progress,
) -> Result<f64, SfmError> {
    let mut selected = select(state, input, what);
    let summary = selected.problem.solve(&what.solve, progress)?;
    if !summary.usable {
        return Ok(f64::INFINITY);
    }
    take(state, &selected);
    if what.points_per_image.is_some() {
        let chosen: Vec<bool> = mark(state.points.len(), &selected.points);
        match &what.moving {
            Some(moved) => {
                let touched = state.seen_by(moved).into_iter().filter(|&id| !chosen[id as usize]);
                touched.for_each(|id| state.refine_point(input, id));
            }
            None => state.refine_points(input, |id| chosen[id as usize]),
        }
    }
    Ok(summary.final_rms)
}

fn mark(n: usize, chosen: &[u32]) -> Vec<bool> {
    let mut marks = vec![false; n];
    chosen.iter().for_each(|&id| marks[id as usize] = true);
    marks
}

/// Writes the solved values back.
pub(crate) fn take(state: &mut MapState, selected: &Selected) {
    state.cameras.clone_from(&selected.problem.cameras);
    for (&image, pose) in selected.images.iter().zip(&selected.problem.poses) {
        state.poses[image] = Some(*pose);
    }
    for (&id, position) in selected.points.iter().zip(&selected.problem.points) {
        if let Some(point) = &mut state.points[id as usize] {
            point.position = *position;
        }
    }
}

/// Chooses points and images and fills the arrays.
pub(crate) fn select(state: &MapState, input: &MappingInput<'_>, what: &Adjustment) -> Selected {
    let mut images = state.order.clone();
    images.sort_unstable();
    let index: HashMap<usize, u32> = images.iter().copied().zip(0..).collect();
    let mut moves = vec![what.moving.is_none(); state.poses.len()];
    what.moving.iter().flatten().for_each(|&image| moves[image] = true);
    let candidates: Vec<u32> = match &what.moving {
        Some(moving) => state.seen_by(moving),
        None => state.live().map(|(id, _)| id).collect(),
    };
    let points = match what.points_per_image {
        Some(wanted) => covering_points(state, candidates, wanted, &moves),
        None => candidates,
    };
    let mut problem = BundleProblem {
        cameras: state.cameras.clone(),
        camera_free: what.free.clone(),
        priors: what.priors.clone(),
        poses: images.iter().map(|&i| state.poses[i].unwrap_or(Pose::IDENTITY)).collect(),
        pose_camera: images.iter().map(|&i| input.camera_of[i] as u32).collect(),
        pose_constant: images.iter().map(|&i| !moves[i]).collect(),
        ..BundleProblem::default()
    };
    for &id in &points {
        let Some(point) = &state.points[id as usize] else { continue };
        let number = problem.points.len() as u32;
        problem.points.push(point.position);
        for &[image, feature] in &point.views {
            let Some(&pose) = index.get(&(image as usize)) else { continue };
            let pixel = input.keypoints[image as usize][feature as usize];
            let sigma_px = input.sigmas.get(image as usize).map_or(1.0, |s| f64::from(s[feature as usize]));
            problem.observations.push(BundleObservation { pose, point: number, pixel, sigma_px });
        }
    }
    problem.point_constant = vec![false; problem.points.len()];
    Selected { problem, points, images }
}

/// The longest tracks first, until every image that `moves` sees `wanted` of the chosen points or
/// has no more.
fn covering_points(state: &MapState, candidates: Vec<u32>, wanted: usize, moves: &[bool]) -> Vec<u32> {
    let mut ranked: Vec<(usize, u32)> = Vec::with_capacity(candidates.len());
    for id in candidates {
        ranked.push((state.points[id as usize].as_ref().map_or(0, |p| p.views.len()), id));
    }
    ranked.sort_unstable_by_key(|&(n, id)| (std::cmp::Reverse(n), id));
    let mut seen = vec![0usize; state.poses.len()];
    let mut chosen = Vec::new();
    for (_, id) in ranked {
        let Some(point) = &state.points[id as usize] else { continue };
        if point.views.iter().any(|v| seen[v[0] as usize] < wanted && moves[v[0] as usize]) {
            point.views.iter().for_each(|v| seen[v[0] as usize] += 1);
            chosen.push(id);
        }
    }
    chosen.sort_unstable();
    chosen
}

/// Whether intrinsics are such as real cameras have: fields of view of 1° to 150°, mild distortion,
/// a principal point inside the image.
pub(crate) fn plausible(camera: &Camera) -> bool {
    let size = f64::from(camera.width.max(camera.height));
    let focal = camera.focal() / size;
    let centre = camera.principal_point();
    focal.min_element() > 0.1
        && focal.max_element() < 60.0
        && camera.distortion().iter().all(|k| k.abs() < 2.0 * (1.0 + focal.x * focal.x))
        && centre.x > 0.0
        && centre.y > 0.0
        && centre.x < f64::from(camera.width)
        && centre.y < f64::from(camera.height)
}
