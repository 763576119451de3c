//! Which way is up, by how cameras are held.

use crate::Pose;
use crate::sim3::least_eigenvector;
use glam::{DMat3, DVec3};

/// The direction that is up in the world. Source: as for cameras held level, whose y points down.
pub const UP: DVec3 = DVec3::NEG_Y;

/// Usual standard deviations of a camera's roll and pitch, degrees: people hold cameras level far
/// better than they point them at the horizon. Source: chosen by hand, never measured.
const ROLL_AND_PITCH_DEG: [f64; 2] = [3.0, 20.0];

/// The direction that is up for cameras that are held level, world frame, unit: as far as may be
/// perpendicular to their x axes (Brown and Lowe, IJCV 74(1), 2007, section 5), and near their −y
/// axes where those do not say. `None` without cameras.
pub fn level_up<'a>(poses: impl IntoIterator<Item = &'a Pose>) -> Option<DVec3> {
    let [roll, pitch] = ROLL_AND_PITCH_DEG.map(|d| 1.0 / d.to_radians().powi(2));
    let (mut spread, mut mean) = (DMat3::ZERO, DVec3::ZERO);
    for pose in poses {
        let world_from_camera = pose.rotation.conjugate();
        let (right, up) = (world_from_camera * DVec3::X, world_from_camera * DVec3::NEG_Y);
        spread += outer(right) * roll + (DMat3::IDENTITY - outer(up)) * pitch;
        mean += up;
    }
    if spread == DMat3::ZERO || !spread.is_finite() {
        return None;
    }
    let up = least_eigenvector(spread);
    Some(if up.dot(mean) < 0.0 { -up } else { up })
}

/// Metadata agree on what is up where they differ by less, degrees: phones are held for seconds,
/// gimbals to a degree. Source: chosen by hand, never measured.
const AGREEMENT_DEG: f64 = 10.0;

/// What metadata say is up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StatedUp {
    /// The direction, world frame, unit: the mean of those that agree.
    pub up: DVec3,
    /// On how many photos' metadata it rests, and how many say something.
    pub agreeing_and_all: [usize; 2],
}

/// What is up by the photos' metadata: of all directions the one with which most agree. `stated`:
/// pose, and what is up in the camera's frame. `None` where fewer than two say it, or no more than
/// half agree, as of an object that was turned before a camera.
pub fn stated_up(stated: &[(Pose, DVec3)]) -> Option<StatedUp> {
    let all: Vec<DVec3> = stated.iter().map(|(pose, up)| pose.rotation.conjugate() * *up).collect();
    let best = all.iter().copied().rev().max_by_key(|up| near(&all, *up).count())?;
    let agreeing = near(&all, best).count();
    let up = near(&all, best).sum::<DVec3>().try_normalize()?;
    let is_agreed = agreeing > 1 && 2 * agreeing > all.len();
    is_agreed.then_some(StatedUp { up, agreeing_and_all: [agreeing, all.len()] })
}

/// Those that agree with a direction.
fn near(all: &[DVec3], up: DVec3) -> impl Iterator<Item = &DVec3> {
    let most = AGREEMENT_DEG.to_radians().cos();
    all.iter().filter(move |other| other.dot(up) > most)
}

fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}

/// Root mean square angle between the cameras' x axes and the plane across `up`, degrees.
pub(crate) fn roll_deg(poses: &[Pose], up: DVec3) -> f64 {
    let squares = poses.iter().map(|p| (p.rotation.conjugate() * DVec3::X).dot(up).asin().powi(2));
    (squares.sum::<f64>() / poses.len().max(1) as f64).sqrt().to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    /// Cameras that look ahead at these angles (degrees), down by `pitch` degrees, rolled by
    /// `roll`.
    fn cameras(angles: &[f64], pitch: f64, roll: f64) -> Vec<Pose> {
        let look = |a: &f64| {
            let (sin, cos) = a.to_radians().sin_cos();
            let (down, ahead) = pitch.to_radians().sin_cos();
            let pose = Pose::look_at(DVec3::ZERO, DVec3::new(cos * ahead, sin * ahead, -down), DVec3::Z);
            Pose::new(DQuat::from_rotation_z(roll.to_radians()) * pose.rotation, DVec3::ZERO)
        };
        angles.iter().map(look).collect()
    }

    #[test]
    fn cameras_that_look_down_do_not_tilt_what_is_up() {
        let poses = cameras(&[0.0, 20.0, 40.0, 60.0], 40.0, 0.0);
        let up = level_up(&poses).unwrap();
        assert!(up.angle_between(DVec3::Z).to_degrees() < 6.0, "{up}");
        let mean: DVec3 = poses.iter().map(|p| p.rotation.conjugate() * DVec3::NEG_Y).sum();
        assert!(mean.angle_between(DVec3::Z).to_degrees() > 35.0, "the mean of their own does: {mean}");
    }

    #[test]
    fn cameras_side_by_side_have_their_own_up() {
        let poses = cameras(&[30.0; 5], 20.0, 0.0);
        let own = poses[0].rotation.conjugate() * DVec3::NEG_Y;
        assert!(level_up(&poses).unwrap().angle_between(own) < 1e-6);
        assert_eq!(level_up(&[]), None);
    }

    #[test]
    fn metadata_say_what_is_up_unless_they_contradict_each_other() {
        let poses = cameras(&[0.0, 20.0, 40.0, 60.0, 80.0], 30.0, 12.0);
        let true_up = |p: &Pose| (*p, p.rotation * DVec3::Z);
        let mut stated: Vec<(Pose, DVec3)> = poses.iter().map(true_up).collect();
        let found = stated_up(&stated).unwrap();
        assert!(found.up.distance(DVec3::Z) < 1e-12 && found.agreeing_and_all == [5, 5], "{found:?}");
        stated[0].1 = DVec3::X;
        stated[3].1 = DVec3::NEG_Z;
        let found = stated_up(&stated).unwrap();
        assert!(found.up.distance(DVec3::Z) < 1e-12 && found.agreeing_and_all == [3, 5], "{found:?}");
        // An object is turned before a camera that stands still.
        let turned: Vec<_> = poses.iter().map(|p| (*p, DVec3::NEG_Y)).collect();
        let tumbled: Vec<_> = (0..8)
            .map(|i| (Pose::new(DQuat::from_rotation_x(f64::from(i)), DVec3::ZERO), DVec3::NEG_Y))
            .collect();
        assert_eq!(stated_up(&tumbled), None);
        assert!(stated_up(&turned[..1]).is_none() && stated_up(&[]).is_none());
    }

    #[test]
    fn the_roll_is_the_angle_with_the_horizon() {
        let poses = cameras(&[0.0, 120.0, 240.0], 10.0, 7.0);
        assert!((roll_deg(&poses, DVec3::Z) - 6.89).abs() < 0.05, "{}", roll_deg(&poses, DVec3::Z));
    }
}
