//! Images that a ring of cameras misses: where the images that stand go round in the order of their
//! files at an even rate, the places of the others are known but for the ring's small motions, and
//! few matches are enough to say whether an image is there (docs/decisions/09).

use super::limits::{FINAL_ROUNDS, LEAST_OBSERVATIONS, LEAST_SIGMA, TIGHT, is_majority};
use super::model::CircularContext;
use super::motion::{CircularMotion, pose_at, wrap_angle};
use super::orbit;
use super::prior::{EVEN, constant_rate};
use crate::error::SfmError;
use crate::incremental::state::MapState;
use crate::incremental::structureless_resection::consistency;
use crate::limits::OUTLIER_SIGMAS;
use crate::model_selection::camera::FreeIntrinsics;
use crate::statistics::{MEDIAN_LENGTH, median};
use scene::Pose;
use scene::decision::{Choice, Decision, Measurement, Quantity, Rule, Subject};
use std::f64::consts::TAU;

/// A ring and where its images stand on it.
#[derive(Clone, Debug)]
struct CameraRing {
    turn: CircularMotion,
    table_from_world: Pose,
    /// Standard deviations of the images' own motions: rotation (radians), translation (radii), a
    /// coordinate.
    sigma: [f64; 2],
}

impl CameraRing {
    /// The ring that most of the poses are on; `None` where they are on none.
    fn of(poses: &[Option<Pose>]) -> Option<Self> {
        if poses.iter().flatten().count() < LEAST_OBSERVATIONS {
            return None;
        }
        let (turn, misfit) = CircularMotion::of_poses(poses)?;
        if !orbit::is_very_near(&misfit) {
            return None;
        }
        let worlds: Vec<Pose> = (0..poses.len())
            .filter_map(|i| Some(turn.pose(i)?.inverse().compose(poses[i].as_ref()?)))
            .collect();
        let table_from_world = middle_of(&worlds, turn.radius())?;
        let mut ring = Self { turn, table_from_world, sigma: [LEAST_SIGMA; 2] };
        let offsets: Vec<[f64; 2]> =
            (0..poses.len()).filter_map(|i| ring.offset(i, poses[i].as_ref()?)).collect();
        for k in 0..2 {
            let middle = median(offsets.iter().map(|o| o[k]).collect());
            ring.sigma[k] = (middle / MEDIAN_LENGTH).max(LEAST_SIGMA);
        }
        Some(ring)
    }

    fn pose_at(&self, angle: f64) -> Pose {
        pose_at(&self.turn.axis, angle).compose(&self.table_from_world)
    }

    /// How far a pose of image `i` is from its place on the ring: rotation (radians), translation
    /// (radii).
    fn offset(&self, i: usize, pose: &Pose) -> Option<[f64; 2]> {
        let [turn, shift] = offset(pose, &self.pose_at(self.turn.angles[i]?));
        Some([turn, shift / self.turn.radius()])
    }

    fn suspects(&self, poses: &[Option<Pose>]) -> Vec<usize> {
        // What is as near as a rig keeps its cameras is never suspected.
        let limit = self.sigma.map(|sigma| OUTLIER_SIGMAS * sigma.max(0.5 * TIGHT));
        let mut found = Vec::new();
        for (i, pose) in poses.iter().enumerate() {
            let offset = pose.as_ref().and_then(|p| self.offset(i, p));
            if offset.is_some_and(|o| o[0] > limit[0] || o[1] > limit[1]) {
                found.push(i);
            }
        }
        found
    }
}

/// The pose with the smallest median distance from all of them, translations in radii.
fn middle_of(poses: &[Pose], radius: f64) -> Option<Pose> {
    let mut best: Option<(f64, Pose)> = None;
    for a in poses {
        let distances = poses.iter().map(|b| {
            let [turn, shift] = offset(a, b);
            turn + shift / radius
        });
        let typical = median(distances.collect());
        if best.is_none_or(|(least, _)| typical.total_cmp(&least).is_lt()) {
            best = Some((typical, *a));
        }
    }
    best.map(|(_, pose)| pose)
}

/// Standard deviations of the motions that cameras on a ring have of their own, a coordinate:
/// radians, radii; `None` where they are on none.
pub(crate) fn own_motions(poses: &[Option<Pose>]) -> Option<[f64; 2]> {
    CameraRing::of(poses).map(|ring| ring.sigma)
}

/// Rotation (radians) and translation between two poses.
fn offset(a: &Pose, b: &Pose) -> [f64; 2] {
    let between = a.compose(&b.inverse());
    [2.0 * between.rotation.xyz().length().min(1.0).asin(), between.translation.length()]
}

/// Angles of the images without one that lie between images with one, if the images go round evenly
/// in their order.
fn angles_between(angles: &[Option<f64>]) -> Vec<Option<f64>> {
    let mut found = vec![None; angles.len()];
    let known: Vec<(usize, f64)> = angles.iter().enumerate().filter_map(|(i, a)| Some((i, (*a)?))).collect();
    let Some(rate) = constant_rate(angles) else { return found };
    // Once round: after the last image comes the first.
    let Some(&(first, angle)) = known.first() else { return found };
    let closing = (first + angles.len(), angle);
    let pairs: Vec<[(usize, f64); 2]> =
        known.windows(2).map(|w| [w[0], w[1]]).chain(known.last().map(|&l| [l, closing])).collect();
    for [(i, from), (j, to)] in pairs {
        let count = (j - i) as f64;
        let expected = rate * count;
        let total = expected + wrap_angle(to - from - expected);
        // Between the last and the first the ring may not be closed: there the steps would not come
        // out even.
        if j - i < 2 || (total - expected).abs() > EVEN * rate.abs() * count.sqrt() || expected.abs() > TAU {
            continue;
        }
        for image in i + 1..j {
            found[image % angles.len()] = Some(from + total * (image - i) as f64 / count);
        }
    }
    found
}

/// The model with the images that it misses in their places, as far as their matches agree; `None`
/// where that adds none.
pub(crate) fn complete(
    state: &MapState,
    context: &CircularContext<'_>,
    intrinsics: FreeIntrinsics,
) -> Result<Option<(MapState, Decision)>, SfmError> {
    let Some(ring) = CameraRing::of(&state.poses) else { return Ok(None) };
    let mut next = state.clone();
    let suspects = ring.suspects(&state.poses);
    let mut angles = ring.turn.angles.clone();
    for &image in &suspects {
        next.unregister(image);
        angles[image] = None;
    }
    let mut added: Vec<usize> = Vec::new();
    for (image, angle) in angles_between(&angles).into_iter().enumerate() {
        if let (None, Some(angle)) = (next.poses[image], angle) {
            next.register(image, ring.pose_at(angle));
            added.push(image);
        }
    }
    // Back to where they were, unless their matches like the ring better.
    for image in suspects {
        let before = consistency(state, context.input, image).0;
        if !added.contains(&image) || consistency(&next, context.input, image).0 < before {
            next.unregister(image);
            next.register(image, state.poses[image].unwrap_or(Pose::IDENTITY));
            added.retain(|&i| i != image);
        }
    }
    drop_strangers(&mut next, &mut added, context);
    if added.is_empty() {
        return Ok(None);
    }
    for _ in 0..FINAL_ROUNDS {
        next.grow_all(context.input);
        let Some(adjusted) = orbit::adjust(&next, context, intrinsics, ring.sigma)? else {
            return Ok(None);
        };
        next = adjusted;
        next.filter(context.input, context.input.config.max_reprojection_px);
        drop_strangers(&mut next, &mut added, context);
    }
    let weak: Vec<usize> =
        added.iter().copied().filter(|&i| next.observations(i) < LEAST_OBSERVATIONS).collect();
    weak.iter().for_each(|&i| next.unregister(i));
    added.retain(|i| !weak.contains(i));
    let others = state.registered_count() - state.order.iter().filter(|i| added.contains(i)).count();
    let decision = Decision::new(Subject::CircleCompletion, Choice::count(added.len()), Rule::Evidence)
        .with_all([
            Measurement::count(Quantity::RegisteredImages, others),
            Measurement::new(Quantity::OrbitRotation, ring.sigma[0].to_degrees()),
            Measurement::new(Quantity::OrbitTranslation, ring.sigma[1]),
        ]);
    // Images that were suspected and fit nowhere may be gone: a smaller model is no completion.
    let larger = !added.is_empty() && next.registered_count() >= state.registered_count();
    Ok(larger.then_some((next, decision)))
}

/// Takes out the added images whose matches do not agree with their places, until all others' do.
fn drop_strangers(state: &mut MapState, added: &mut Vec<usize>, context: &CircularContext<'_>) {
    loop {
        let gone: Vec<usize> = added.iter().copied().filter(|&i| is_stranger(state, i, context)).collect();
        if gone.is_empty() {
            return;
        }
        gone.iter().for_each(|&i| state.unregister(i));
        added.retain(|i| !gone.contains(i));
    }
}

/// Whether few of the matches of an image agree with its place.
fn is_stranger(state: &MapState, image: usize, context: &CircularContext<'_>) -> bool {
    let (agreeing, all) = consistency(state, context.input, image);
    agreeing < LEAST_OBSERVATIONS || !is_majority(agreeing, all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn ring(n: usize) -> Vec<Option<f64>> {
        (0..n).map(|i| Some(i as f64 * TAU / n as f64)).collect()
    }

    #[test]
    fn gaps_of_an_even_ring_are_filled() {
        let mut angles = ring(36);
        let truth = angles.clone();
        for i in [5, 20, 21, 22, 23, 24, 25, 34, 35] {
            angles[i] = None;
        }
        let found = angles_between(&angles);
        for (i, angle) in found.iter().enumerate() {
            assert_eq!(angle.is_some(), angles[i].is_none(), "image {i}");
            if let Some(angle) = angle {
                assert!(wrap_angle(angle - truth[i].unwrap()).abs() < 1e-9, "image {i}");
            }
        }
    }

    #[test]
    fn what_does_not_go_round_evenly_is_left_alone() {
        // The order of the files is not that of the ring: a constant stride would still be even, so
        // it is broken.
        let mut shuffled: Vec<Option<f64>> =
            (0..36).map(|i| Some(f64::from(i * 23 % 36) * TAU / 36.0)).collect();
        [(1, 17), (3, 29), (8, 22), (12, 33)].into_iter().for_each(|(a, b)| shuffled.swap(a, b));
        shuffled.iter_mut().step_by(5).for_each(|a| *a = None);
        assert!(angles_between(&shuffled).iter().all(Option::is_none));
        // Half a turn only: nothing is said of what is beyond its ends.
        let mut half: Vec<Option<f64>> = (0..30).map(|i| Some(f64::from(i) * 0.1)).collect();
        (half[28], half[29], half[10]) = (None, None, None);
        let found = angles_between(&half);
        assert!(found[10].is_some() && found[28].is_none() && found[29].is_none());
        assert!(angles_between(&[]).is_empty());
        assert!(angles_between(&[None; 9]).iter().all(Option::is_none));
    }

    #[test]
    fn a_pose_off_the_ring_is_suspected() {
        let axis = Pose::new(glam::DQuat::from_rotation_x(1.8), DVec3::new(0.0, 0.1, 3.0));
        let mut poses: Vec<Option<Pose>> =
            (0..20).map(|i| Some(pose_at(&axis, f64::from(i) * TAU / 20.0))).collect();
        poses[7] = poses[7].map(|p| Pose::new(glam::DQuat::from_rotation_y(0.1) * p.rotation, p.translation));
        let ring = CameraRing::of(&poses).unwrap();
        assert_eq!(ring.suspects(&poses), [7]);
        assert!(CameraRing::of(&poses[..7]).is_none(), "too few");
    }
}
