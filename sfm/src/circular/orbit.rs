//! A camera that goes round on a circle with small motions of its own: a turn whose frames have
//! offsets that are about as large as they turn out to be.

use super::initialize::free_poses::CircularMisfit;
use super::limits::{FARTHEST, HELD};
use super::model::{AxisModel, CircularContext};
use super::motion::CircularMotion;
use super::prior::AnglePrior;
use super::problem::CircularProblem;
use crate::bundle::BundleProblem;
use crate::error::SfmError;
use crate::incremental::state::MapState;
use crate::model_selection::camera::FreeIntrinsics;
use crate::statistics::{MEDIAN_LENGTH, median};
use glam::DVec3;
use scene::Pose;

/// Free poses as a turn with offsets, in the turntable's frame, and how far they are from a pure
/// turn. `None` where they do not turn.
pub(crate) fn of_free(free: &BundleProblem) -> Option<(CircularProblem, CircularMisfit)> {
    let poses: Vec<Option<Pose>> = free.poses.iter().copied().map(Some).collect();
    let (turn, misfit) = CircularMotion::of_poses(&poses)?;
    let table_from_world = turn.pose(0)?.inverse().compose(free.poses.first()?);
    let mut bundle = free.clone();
    move_world(&table_from_world, bundle.poses.iter_mut(), bundle.points.iter_mut());
    let angles = turn.angles.iter().map(|a| a.unwrap_or(0.0)).collect();
    Some((CircularProblem::with_offsets(bundle, turn.axis, angles), misfit))
}

/// Whether the poses are near enough to a circle for an orbit to be tried.
pub(crate) fn is_possible(state: &MapState) -> bool {
    CircularMotion::of_poses(&state.poses).is_some_and(|(_, misfit)| is_near(&misfit))
}

/// Whether free poses are near enough to a turn.
pub(crate) fn is_near(misfit: &CircularMisfit) -> bool {
    misfit.tilt < FARTHEST[0] && misfit.slip < FARTHEST[1]
}

/// Whether they are twice as near.
pub(crate) fn is_very_near(misfit: &CircularMisfit) -> bool {
    misfit.tilt <= 0.5 * FARTHEST[0] && misfit.slip <= 0.5 * FARTHEST[1]
}

/// Takes poses and points into another frame.
fn move_world<'a>(
    new_from_old: &Pose,
    poses: impl Iterator<Item = &'a mut Pose>,
    points: impl Iterator<Item = &'a mut DVec3>,
) {
    let back = new_from_old.inverse();
    poses.for_each(|p| *p = p.compose(&back));
    points.for_each(|x| *x = new_from_old.transform(*x));
}

/// Standard deviation of the offsets' coordinates: rotations, radians, and translations, radii.
/// From the median length, so that a few poses that few observations hold do not make the circle
/// wide.
pub(crate) fn strengths(problem: &CircularProblem) -> [f64; 2] {
    let turns = problem.offsets.iter().map(|o| 2.0 * o.rotation.xyz().length()).collect();
    let shifts = problem.offsets.iter().map(|o| o.translation.length()).collect();
    let [turn, shift]: [f64; 2] = [turns, shifts].map(|lengths| median(lengths) / MEDIAN_LENGTH);
    [turn.max(HELD), (shift / problem.radius()).max(HELD)]
}

/// A model held near the circle: adjusted with offsets of this strength, filtered and triangulated
/// a few times. `None` where not even the first adjustment comes to anything.
pub(crate) fn hold(
    state: &MapState,
    context: &CircularContext<'_>,
    intrinsics: FreeIntrinsics,
    sigma: [f64; 2],
) -> Result<Option<MapState>, SfmError> {
    let mut held: Option<MapState> = None;
    // What fits the first adjustment takes part in the second.
    for _ in 0..2 {
        let Some(mut next) = adjust(held.as_ref().unwrap_or(state), context, intrinsics, sigma)? else {
            break;
        };
        next.filter(context.input, context.input.config.max_reprojection_px);
        next.grow_all(context.input);
        held = Some(next);
    }
    Ok(held)
}

/// The model adjusted once more with offsets from a circle of about this strength; `None` where
/// that comes to nothing.
pub(crate) fn adjust(
    state: &MapState,
    context: &CircularContext<'_>,
    intrinsics: FreeIntrinsics,
    sigma: [f64; 2],
) -> Result<Option<MapState>, SfmError> {
    let Some((turn, _)) = CircularMotion::of_poses(&state.poses) else { return Ok(None) };
    let first = state.poses.iter().position(Option::is_some).unwrap_or(0);
    let (Some(new), Some(old)) = (turn.pose(first), state.poses[first]) else { return Ok(None) };
    let mut state = state.clone();
    let points = state.points.iter_mut().flatten().map(|p| &mut p.position);
    move_world(&new.inverse().compose(&old), state.poses.iter_mut().flatten(), points);
    let free: Vec<Option<Pose>> = state.poses.clone();
    let context =
        &CircularContext { priors: &[AnglePrior::ConstantStep], elevation: None, ..context.clone() };
    let mut model = AxisModel { elevation: None, state, turn };
    let (mut problem, selected, options) = model.prepare(context, intrinsics, None);
    problem.bundle.poses = selected.images.iter().filter_map(|&i| free[i]).collect();
    // The noise is that of the free poses; against the pure turn it would look larger.
    model.weigh(context, &mut problem.bundle, &selected);
    let mut problem = CircularProblem {
        offset_sigma: Some(sigma),
        relations: std::mem::take(&mut problem.relations),
        ..CircularProblem::with_offsets(problem.bundle, problem.axis, problem.angles)
    };
    let summary = problem.solve(&options, context.progress)?;
    if !summary.usable {
        return Ok(None);
    }
    model.take(problem, selected);
    Ok(Some(model.state))
}
