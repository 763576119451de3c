//! Global mapping: rotations of all images at once, then positions, then points and their
//! adjustment. An alternative to the incremental mapper that no early mistake can lead astray, and
//! a check on it.

pub(crate) mod positions;
pub(crate) mod rotations;

use crate::bundle::RobustLoss;
use crate::incremental::adjust::{Adjustment, adjust};
use crate::incremental::growth::{expel, freedom, grow, settle, starts_of};
use crate::incremental::initial::relative_pose;
use crate::incremental::state::{MapState, MappingInput};
use crate::{Knowledge, SfmError};
use glam::DQuat;
use rayon::prelude::*;
use rotations::RotationEdge;
use scene::{Camera, Pose, Progress, TwoViewKind};

/// Pairs farther from the averaged rotations than this are wrong, radians.
/// Source: chosen by hand, never measured.
const WRONG_PAIR: f64 = 0.15;
/// Errors to which observations are held, one adjustment after the other, pixels for an image of
/// 1000.
/// Source: chosen by hand, never measured.
const LIMITS: [f64; 4] = [60.0, 25.0, 10.0, 5.0];

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
    let mut edges = view_graph(input, cameras);
    let mut rotations: Vec<Option<DQuat>>;
    loop {
        progress.check()?;
        rotations = rotations::average(images, &edges);
        let before = edges.len();
        let agrees =
            |e: &RotationEdge| rotations::residual(&rotations, e).is_none_or(|r| r.length() < WRONG_PAIR);
        edges.retain(agrees);
        if edges.len() == before {
            break;
        }
    }
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

/// Adjusts with ever smaller bounds on the errors, then takes out images that see next to nothing.
fn tighten(
    state: &mut MapState,
    input: &MappingInput<'_>,
    known: &[Knowledge],
    starts: &[Camera],
    progress: &Progress,
) -> Result<(), SfmError> {
    let side = starts.iter().map(|c| c.width.max(c.height)).max().unwrap_or(1000);
    for limit in LIMITS.map(|l| (l * f64::from(side) / 1000.0).max(input.config.max_reprojection_px)) {
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
