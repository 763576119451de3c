//! Global mapping: rotations of all images at once, then positions, then points and their
//! adjustment. An alternative to the incremental mapper that no early mistake can lead astray, and
//! a check on it.

pub(crate) mod positions;
pub(crate) mod rotations;

use crate::bundle::RobustLoss;
use crate::error::SfmError;
use crate::incremental::adjust::{Adjustment, adjust};
use crate::incremental::growth::{expel, freedom, grow, settle, starts_of};
use crate::incremental::initial::relative_pose;
use crate::incremental::state::{MapState, MappingInput};
use crate::knowledge::Knowledge;
use glam::DQuat;
use rayon::prelude::*;
use rotations::RotationEdge;
use scene::{Camera, Pose, Progress, TwoViewKind};

/// Error to which observations are held at first, as a share of the longer side.
/// Source: judgement: loose, since global positions are rough; no bench chose it.
const START: f64 = 0.06;

/// The model of the largest connected part of the view graph; `None` where it has fewer than three
/// images. `cameras`: intrinsics that are about right.
pub(crate) fn map(
    input: &MappingInput<'_>,
    cameras: &[Camera],
    known: &[Knowledge],
    progress: &Progress,
) -> Result<Option<MapState>, SfmError> {
    progress.begin("global mapping", 0);
    let images = input.keypoints.len();
    let rotations = rotations_of_pairs(input, cameras, progress)?;
    let Some(found) = positions::solve(input, cameras, &rotations, progress)? else { return Ok(None) };
    let mut state = MapState::new(input, cameras.to_vec());
    for (image, (rotation, centre)) in rotations.iter().zip(&found.centres).enumerate() {
        if let (Some(rotation), Some(centre)) = (rotation, centre) {
            state.register(image, Pose::from_centre(*rotation, *centre));
        }
    }
    found.points.iter().for_each(|&(track, position)| state.place(input, track, position));
    let starts = starts_of(cameras, known, &state);
    tighten(&mut state, input, known, &starts, progress)?;
    if state.registered_count() < 3 {
        return Ok(None);
    }
    settle(&mut state, input, known, &starts, progress)?;
    expel(&mut state, input);
    grow(&mut state, input, known, &starts, images, progress)?;
    settle(&mut state, input, known, &starts, progress)?;
    expel(&mut state, input);
    Ok((state.registered_count() >= 3).then_some(state))
}

/// Rotations of the images in the largest part of the view graph, from those of the verified pairs;
/// pairs that do not agree with the others are left out.
pub(crate) fn rotations_of_pairs(
    input: &MappingInput<'_>,
    cameras: &[Camera],
    progress: &Progress,
) -> Result<Vec<Option<DQuat>>, SfmError> {
    let mut edges = view_graph(input, cameras);
    loop {
        progress.check()?;
        let rotations = rotations::average(input.keypoints.len(), &edges);
        let before = edges.len();
        edges.retain(|e| rotations::agrees(&rotations, e));
        if edges.len() == before {
            return Ok(rotations);
        }
    }
}

/// The rotations of all verified pairs for the present intrinsics.
fn view_graph(input: &MappingInput<'_>, cameras: &[Camera]) -> Vec<RotationEdge> {
    let moving = input
        .geometries
        .par_iter()
        .filter(|g| !matches!(g.kind, TwoViewKind::Watermark | TwoViewKind::Degenerate));
    let edges = moving.filter_map(|g| {
        let of_pair = [g.a, g.b].map(|i| &cameras[input.camera_of[i]]);
        let pose = relative_pose(input, of_pair, g).or(g.b_from_a)?;
        let weight = (g.inliers.len() as f64).sqrt();
        pose.is_finite().then_some(RotationEdge { a: g.a, b: g.b, b_from_a: pose.rotation, weight })
    });
    edges.collect()
}

/// Adjusts with bounds on the errors that are halved again and again, then takes out images that
/// see next to nothing.
fn tighten(
    state: &mut MapState,
    input: &MappingInput<'_>,
    known: &[Knowledge],
    starts: &[Camera],
    progress: &Progress,
) -> Result<(), SfmError> {
    let side = starts.iter().map(|c| c.width.max(c.height)).max().unwrap_or(1000);
    let last = input.config.max_reprojection_px;
    let halved = std::iter::successors(Some(START * f64::from(side)), |l| (*l > last).then_some(l / 2.0));
    for limit in halved.map(|l| l.max(last)) {
        let (free, priors) = freedom(&state.cameras, known, starts, state.registered_count());
        let mut what = Adjustment::growing(free, priors);
        what.solve.loss = RobustLoss::SoftL1(0.25 * limit);
        adjust(state, input, &what, progress)?;
        state.filter(input, limit);
        state.grow_all(input);
    }
    let mut blind = state.order.clone();
    blind.retain(|&image| state.observations(image) < input.config.min_observations);
    blind.into_iter().for_each(|image| state.unregister(image));
    Ok(())
}
