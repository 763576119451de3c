//! Poses of the frames of a video that were not chosen, where no motion says them: between those of
//! the neighbours in time that have one.

use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};
use crate::result::{FramePose, PoseDeviation, outer_square};
use scene::Pose;

/// How much less an interpolation errs between neighbours than between frames twice as far apart.
/// Source: derived: its error grows with the square of the distance.
const FINER: f64 = 0.25;

/// Poses of all frames of the video.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let times = context.frames.film.as_ref().map_or(&[][..], |film| &film.times_s);
    if let (true, Some(of_images)) = (model.frames.is_empty(), context.frames.times()) {
        let mut known: Vec<(f64, Pose)> = Vec::new();
        if let Some(reconstruction) = &model.reconstruction {
            let posed = reconstruction.images.values();
            known.extend(posed.map(|image| (of_images[image.id as usize - 1], image.pose)));
        }
        known.sort_by(|a, b| a.0.total_cmp(&b.0));
        model.frames = interpolated(&known, times);
    }
    Ok((model, Vec::new()))
}

/// Poses at the times that lie between known ones. Their deviations are the errors that known poses
/// would have, were they interpolated between their own neighbours, a quarter of them.
fn interpolated(known: &[(f64, Pose)], times: &[f64]) -> Vec<FramePose> {
    let missed: Vec<PoseDeviation> =
        known.windows(3).map(|w| off(&between(&w[0], &w[2], w[1].0), &w[1].1)).collect();
    let mut found = Vec::new();
    for &time_s in times {
        let after = known.partition_point(|k| k.0 < time_s);
        if known.get(after).is_some_and(|k| k.0 == time_s) {
            found.push(FramePose { time_s, pose: known[after].1, deviation: PoseDeviation::default() });
        } else if after > 0 && after < known.len() && !missed.is_empty() {
            let pose = between(&known[after - 1], &known[after], time_s);
            let [a, b] = [after.saturating_sub(2), after - 1].map(|i| missed[i.min(missed.len() - 1)]);
            let rotation = std::array::from_fn(|k| FINER * a.rotation[k].max(b.rotation[k]));
            let worse = if a.centre_length() > b.centre_length() { a } else { b };
            let deviation = PoseDeviation { rotation, centre: worse.centre * (FINER * FINER) };
            found.push(FramePose { time_s, pose, deviation });
        }
    }
    found
}

/// The pose at a time between two: the rotation turns evenly, the centre goes along a line.
fn between(a: &(f64, Pose), b: &(f64, Pose), time: f64) -> Pose {
    let share = (time - a.0) / (b.0 - a.0);
    let rotation = a.1.rotation.slerp(b.1.rotation, share);
    Pose::new(rotation, -(rotation * a.1.centre().lerp(b.1.centre(), share)))
}

/// How far a pose is from another: rotation vector, camera frame; centre, world frame.
fn off(a: &Pose, b: &Pose) -> PoseDeviation {
    let turn = a.rotation * b.rotation.conjugate();
    let rotation = (if turn.w < 0.0 { -turn } else { turn }).to_scaled_axis().abs().to_array();
    PoseDeviation { rotation, centre: outer_square(a.centre() - b.centre()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};

    /// A camera that turns ever faster, at times 0, 2, 4 …
    fn known() -> Vec<(f64, Pose)> {
        let pose = |t: f64| {
            let rotation = DQuat::from_rotation_y(0.01 * t + 0.002 * t * t);
            Pose::new(rotation, rotation * DVec3::new(0.0, 0.0, 3.0))
        };
        (0..10).map(|i| 2.0 * f64::from(i)).map(|t| (t, pose(t))).collect()
    }

    #[test]
    fn frames_between_are_as_wrong_as_they_say() {
        let times: Vec<f64> = (0..20).map(f64::from).collect();
        let found = interpolated(&known(), &times);
        assert_eq!(found.len(), 19, "nothing is said of what is beyond the last known frame");
        for f in found.iter().filter(|f| f.time_s % 2.0 == 1.0) {
            let angle = 0.01 * f.time_s + 0.002 * f.time_s * f.time_s;
            let wrong = f.pose.rotation * DQuat::from_rotation_y(-angle);
            let ratio = wrong.to_scaled_axis().length() / f.deviation.rotation[1];
            assert!((0.9..1.1).contains(&ratio), "{}: {ratio}", f.time_s);
        }
        assert_eq!(found[4].pose, known()[2].1);
    }

    #[test]
    fn nothing_known_says_nothing() {
        assert!(interpolated(&[], &[0.0, 1.0]).is_empty());
        assert!(interpolated(&known()[..2], &[1.0]).is_empty());
    }
}
