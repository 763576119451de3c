//! The circle of a model's cameras in the order of its frames, and whether it closes.

use super::{Arc, Ring};
use crate::{FrameSet, Pose, Reconstruction};

/// Camera centres farther from their circle than this go round nothing, radii.
/// Source: chosen by hand, never measured.
const MAX_MISFIT: f64 = 0.1;
/// A gap of an eighth of a rotation is wide: surfaces that face it are seen at a grazing angle
/// only, degrees. Source: derived, incidence beyond 90° − 45°/2 from the nearest camera.
const WIDE_GAP_DEG: f64 = 45.0;
/// A gap is wide beyond this many steps, too. Source: chosen by hand, never measured.
const WIDE_GAP_STEPS: f64 = 4.0;
/// A jump is this many median steps, and at least so many degrees.
/// Source: chosen by hand, never measured.
const JUMP: (f64, f64) = (6.0, 20.0);

/// A ring with the frames that stand on it.
#[derive(Clone, Debug, PartialEq)]
pub struct RingSequence {
    /// The circle; its angles are in the order of the frames.
    pub ring: Ring,
    /// Names of the frames.
    pub names: Vec<String>,
    /// Index of each frame among all frames: frames without a pose leave gaps.
    pub places: Vec<f64>,
}

/// How well a ring closes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Closure {
    /// No wide arc is without a camera.
    Closed,
    /// A wide arc is without a camera.
    Open,
    /// Frames that follow each other in time lie far apart.
    Jump,
}

/// What [`RingSequence::closure`] found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RingClosure {
    /// How well it closes.
    pub closure: Closure,
    /// The largest gap, or the jump for one step of the frames.
    pub arc: Arc,
    /// Median angle from a frame to the next, radians.
    pub step: f64,
}

impl RingSequence {
    /// The circle of the cameras that have a pose; `None` where they stand on none (see
    /// [`Ring::fit`]).
    pub fn of(model: &Reconstruction, frames: &FrameSet) -> Option<Self> {
        let placed = frames.frames.iter().enumerate();
        let found: Vec<(f64, &str, Pose)> = placed
            .filter_map(|(i, frame)| Some((i as f64, &*frame.name, model.image_named(&frame.name)?.pose)))
            .collect();
        let poses: Vec<Pose> = found.iter().map(|f| f.2).collect();
        let ring = Ring::fit(&poses).filter(|r| r.misfit < MAX_MISFIT)?;
        let names = found.iter().map(|f| f.1.to_owned()).collect();
        Some(Self { ring, names, places: found.iter().map(|f| f.0).collect() })
    }

    /// Whether the cameras go all the way round, and in a video without a jump.
    pub fn closure(&self, is_video: bool) -> RingClosure {
        let (gap, (jump, step)) = (self.ring.largest_gap(), self.ring.steps(&self.places));
        if is_video && jump.angle > (JUMP.0 * step).max(JUMP.1.to_radians()) {
            return RingClosure { closure: Closure::Jump, arc: jump, step };
        }
        // Without an order in time the mean distance of the cameras is the measure.
        let mean = std::f64::consts::TAU / self.names.len() as f64;
        let allowed = (WIDE_GAP_STEPS * step.min(mean)).max(WIDE_GAP_DEG.to_radians());
        let closure = if gap.angle <= allowed { Closure::Closed } else { Closure::Open };
        RingClosure { closure, arc: gap, step }
    }

    /// Names of the frames at the ends of an arc.
    pub fn ends(&self, arc: &Arc) -> [&str; 2] {
        arc.ends.map(|i| self.names[i].as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Frame, PosedImage};
    use glam::DVec3;

    /// Cameras at these angles (degrees) on a circle, filmed in this order.
    fn filmed(angles: &[f64]) -> (Reconstruction, FrameSet) {
        let (mut model, mut frames) =
            (Reconstruction::default(), FrameSet { is_video: true, ..FrameSet::default() });
        for (i, a) in angles.iter().enumerate() {
            let (sin, cos) = a.to_radians().sin_cos();
            let pose = Pose::look_at(DVec3::new(cos, sin, 0.2), DVec3::ZERO, DVec3::Z);
            let (id, name) = (i as u32 + 1, format!("{i:03}.png"));
            let image = PosedImage { id, camera: 1, name: name.clone(), pose, observations: vec![] };
            model.images.insert(id, image);
            frames.frames.push(Frame { name, ..Frame::default() });
        }
        (model, frames)
    }

    fn steps(from: f64, step: f64, count: usize) -> Vec<f64> {
        (0..count).map(|i| from + step * i as f64).collect()
    }

    fn closure(angles: &[f64]) -> Closure {
        let (model, frames) = filmed(angles);
        RingSequence::of(&model, &frames).unwrap().closure(true).closure
    }

    #[test]
    fn a_full_rotation_is_closed_half_a_rotation_is_open_and_frames_far_apart_are_a_jump() {
        assert_eq!(closure(&steps(0.0, 5.0, 72)), Closure::Closed);
        assert_eq!(closure(&steps(0.0, 5.0, 36)), Closure::Open);
        // A gap counts from an eighth of a rotation on, however densely the rest was filmed.
        assert_eq!(closure(&steps(0.0, 4.0, 81)), Closure::Closed, "a gap of 40°");
        assert_eq!(closure(&steps(0.0, 4.0, 78)), Closure::Open, "a gap of 52°");
        assert_eq!(closure(&[steps(0.0, 5.0, 36), steps(0.0, 5.0, 36)].concat()), Closure::Jump);
    }

    #[test]
    fn frames_without_a_pose_are_no_jump() {
        let (mut model, frames) = filmed(&steps(0.0, 5.0, 72));
        (20..32).for_each(|id| drop(model.images.remove(&id)));
        let sequence = RingSequence::of(&model, &frames).unwrap();
        let found = sequence.closure(true);
        assert_eq!(found.closure, Closure::Open);
        assert_eq!(sequence.ends(&found.arc), ["018.png", "031.png"]);
    }
}
