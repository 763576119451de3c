//! A camera that goes round on a circle with small motions of its own: a turn whose frames have offsets that are about
//! as large as they turn out to be.

use super::initialize::free_poses::CircularMisfit;
use super::model::{AxisModel, CircularContext};
use super::motion::{CircularMotion, wrap_angle};
use super::problem::{CircularProblem, Relation};
use crate::SfmError;
use crate::bundle::{BundleCovariance, BundleProblem};
use crate::incremental::state::MapState;
use crate::model_selection::camera::FreeIntrinsics;
use crate::statistics::median;
use glam::DVec3;
use scene::Pose;

/// Poses farther from a circle than this are no orbit and no turn: tilt (radians) and slip (radii).
const FARTHEST: [f64; 2] = [0.1, 0.2];
/// Offsets are at least about so large, radians and radii: less is none.
const LEAST: f64 = 1e-6;
/// The median length of a vector of three normal coordinates, and the median deviation of one, in standard deviations.
pub(crate) const MEDIAN_LENGTH: f64 = 1.538;
const MEDIAN_DEVIATION: f64 = 0.6745;
/// A step is even if it is no farther from the median than this share of it; so many of so many must be.
const EVEN: f64 = 0.35;
const EVEN_SHARE: f64 = 0.8;
const LEAST_STEPS: usize = 6;
/// Angles are never held to be more even than this, radians.
const LEAST_STRAY: f64 = 1e-4;

/// Free poses as a turn with offsets, in the turntable's frame, and how far they are from a pure turn. `None` where they
/// do not turn.
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

/// Standard deviation of the offsets' coordinates: rotations, radians, and translations, radii. From the median length, so
/// that a few poses that few observations hold do not make the others' circle wide.
pub(crate) fn strengths(problem: &CircularProblem) -> [f64; 2] {
    let turns = problem.offsets.iter().map(|o| 2.0 * o.rotation.xyz().length()).collect();
    let shifts = problem.offsets.iter().map(|o| o.translation.length()).collect();
    let sigma = |lengths: Vec<f64>| median(lengths) / MEDIAN_LENGTH;
    [sigma(turns).max(LEAST), (sigma(shifts) / problem.radius()).max(LEAST)]
}

/// The median step from an image to the next, radians, if most images that have a next one go round evenly.
pub(crate) fn even_rate(angles: &[Option<f64>]) -> Option<f64> {
    let steps: Vec<f64> = angles.windows(2).filter_map(|w| Some(wrap_angle(w[1]? - w[0]?))).collect();
    let rate = median(steps.clone());
    let even = steps.iter().filter(|s| (*s - rate).abs() <= EVEN * rate.abs()).count();
    let enough = steps.len() >= LEAST_STEPS && even as f64 >= EVEN_SHARE * steps.len() as f64;
    (enough && rate != 0.0).then_some(rate)
}

/// Where the images go round evenly in their order: that each angle is `c + i r`, as nearly as that turns out to be so for
/// most (a table or a gantry that is told where to go errs anew at each stop, it does not wander).
pub(crate) fn even_angles(angles: &[Option<f64>]) -> Vec<Relation> {
    let Some(rate) = even_rate(angles) else { return Vec::new() };
    let Some(first) = angles.iter().position(Option::is_some) else { return Vec::new() };
    let start = angles[first].unwrap_or(0.0);
    // Beside the median rate; with it the angles are not wrapped round any more.
    let left: Vec<(usize, f64)> = (first + 1..angles.len())
        .filter_map(|i| Some((i, wrap_angle(angles[i]? - start - rate * (i - first) as f64))))
        .collect();
    let slopes = left.iter().enumerate().flat_map(|(k, a)| left[..k].iter().map(move |b| (a, b)));
    // Theil (1950) and Sen (1968): the median slope, then the median intercept.
    let more = median(slopes.map(|(a, b)| (a.1 - b.1) / (a.0 - b.0) as f64).collect());
    let beside = |&(i, v): &(usize, f64)| v - more * (i - first) as f64;
    let intercept = median(left.iter().map(beside).collect());
    let deviation = median(left.iter().map(|l| (beside(l) - intercept).abs()).collect()) / MEDIAN_DEVIATION;
    let sigma = deviation.max(LEAST_STRAY);
    let relation = |l: &(usize, f64)| {
        let angle = angles[l.0].unwrap_or(0.0);
        Relation {
            frames: [Some(first as u32), Some(l.0 as u32), None],
            coefficients: [-1.0, 1.0, 0.0],
            // As many turns on as the angle itself.
            target: angle - start - wrap_angle(beside(l) - intercept),
            sigma,
        }
    };
    left.iter().map(relation).collect()
}

/// The effective number of the offsets, `Σ σ²/(σ² + s²)` with the standard deviations s to which the observations know a free
/// pose, and by how much twice the logarithm of the evidence grows because they are not free: `Σ ln (1 + 1/s²) − ln (1 +
/// σ²/s²)`, the widths of what is expected of a pose that may be anywhere within a radius and a radian, and of one near the
/// circle, over what is found (Occam factors: MacKay 1992). The angle stands for one of a pose's six numbers.
pub(crate) fn occam(problem: &CircularProblem, sigma: [f64; 2], known: &BundleCovariance) -> (f64, f64) {
    let of = |part: std::ops::Range<usize>| {
        median(known.poses.iter().flat_map(|d| d[part.clone()].to_vec()).filter(|d| *d > 0.0).collect())
    };
    let seen = [of(0..3), of(3..6) / problem.radius()];
    let count = 2.5 * problem.offsets.len() as f64;
    let (mut effective, mut gain) = (0.0, 0.0);
    for (sigma, seen) in sigma.into_iter().zip(seen) {
        let s2 = seen.max(1e-12).powi(2);
        let ratio = sigma * sigma / s2;
        effective += count * ratio / (1.0 + ratio);
        gain += count * ((1.0 + 1.0 / s2).ln() - (1.0 + ratio).ln());
    }
    (effective, gain)
}

/// The model adjusted once more with offsets from a circle of about this strength; `None` where that comes to nothing.
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
    let relations = even_angles(&turn.angles);
    let context = &CircularContext { relations: &relations, elevation: None, ..*context };
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
