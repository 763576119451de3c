//! The loop closure of a whole turn: the first frames show again what the last ones show, so points are followed on from the
//! last frame to the first, and say by how much the angles miss the whole turn.

use crate::SfmError;
use crate::circular::initialize::key_frames::drop_still;
use crate::circular::model::AxisModel;
use crate::circular::motion::wrap_angle;
use crate::circular::register::resect_angle;
use crate::klt::{KltConfig, track};
use crate::triangulation::{Gates, PointView, triangulate};
use glam::{DVec2, DVec3};
use scene::{FrameSet, Progress};

/// Frames on either side.
const SIDE: usize = 6;
/// The frame that goes on from the last one shows the object turned by no more, as far as the angles are known, radians.
const JUMP: f64 = 0.5;
/// Search for the error of a closed turn, radians to either side.
const SPAN: f64 = 0.5;
/// Points with which a frame's angle is asked, at least.
const FEWEST: usize = 6;
/// Largest reprojection error of such a point, pixels, and the least angle between its rays, radians.
const GATES: Gates = Gates { max_error_px: 4.0, min_angle: 0.02 };

/// Points followed across the loop closure.
#[derive(Clone, Debug, Default)]
pub(crate) struct LoopClosure {
    /// By point its frame and pixel, first those before the loop closure.
    pub tracks: Vec<Vec<(usize, DVec2)>>,
    /// The last frame before it.
    last: usize,
}

impl LoopClosure {
    /// Follows points from the last frames to those that a whole turn later show the same; none where no frame does.
    pub fn follow(
        frames: &FrameSet,
        angles: &[Option<f64>],
        klt: &KltConfig,
        progress: &Progress,
    ) -> Result<Self, SfmError> {
        let Some((last, next)) = ends(angles) else { return Ok(Self::default()) };
        let order: Vec<usize> = (last + 1 - SIDE..=last).chain(next..next + SIDE).collect();
        let some = FrameSet {
            frames: order.iter().map(|&f| frames.frames[f].clone()).collect(),
            is_video: true,
            ..FrameSet::default()
        };
        let mut followed = track(&some, klt, progress)?;
        drop_still(&mut followed);
        // Two observations on one side make a point, one on the other a tie.
        followed.retain(|t| t.first + 1 < SIDE && t.first + t.positions.len() > SIDE);
        let views = |first: usize, positions: &[DVec2]| {
            order[first..].iter().copied().zip(positions.iter().copied()).collect()
        };
        Ok(Self { tracks: followed.iter().map(|t| views(t.first, &t.positions)).collect(), last })
    }

    /// For each frame after the loop closure by how much the angle from there to the last frame is too small, and that angle.
    pub fn gaps(&self, model: &AxisModel) -> Vec<(f64, f64)> {
        let Some(end) = model.turn.angles.get(self.last).copied().flatten() else { return Vec::new() };
        let camera = &model.state.cameras[0];
        let before = |frame: usize| frame <= self.last && frame + SIDE > self.last;
        let mut seen: std::collections::BTreeMap<usize, Vec<(DVec2, DVec3)>> = Default::default();
        for track in &self.tracks {
            let view = |&(frame, pixel): &(usize, DVec2)| {
                model.turn.pose(frame).filter(|_| before(frame)).map(|p| PointView::new(&p, camera, pixel))
            };
            let views: Vec<PointView<'_>> = track.iter().filter_map(view).collect();
            let Some(point) = triangulate(&views, &GATES) else { continue };
            for &(frame, pixel) in track.iter().filter(|(frame, _)| !before(*frame)) {
                seen.entry(frame).or_default().push((pixel, point.position));
            }
        }
        let gap = |(frame, seen): (&usize, &Vec<(DVec2, DVec3)>)| {
            let start = model.turn.angles[*frame].filter(|_| seen.len() >= FEWEST)?;
            let found = resect_angle(camera, &model.turn.axis, seen, start, SPAN);
            let agreed = found.inliers >= FEWEST && found.inliers * 2 >= found.asked;
            agreed.then(|| (-wrap_angle(found.angle - start), end - start))
        };
        seen.iter().filter_map(gap).collect()
    }
}

/// The last frame that has an angle, and the first of the frames that go on from it a whole turn before.
fn ends(angles: &[Option<f64>]) -> Option<(usize, usize)> {
    let last = angles.iter().rposition(Option::is_some)?;
    let (start, end) = (angles.iter().flatten().next().copied()?, angles[last]?);
    let whole = std::f64::consts::TAU.copysign(end - start);
    let off = |frame: usize| angles[frame].map(|a| (a - (end - whole)).abs());
    let enough = (last + 1).checked_sub(2 * SIDE)?;
    let known = (0..=enough).filter_map(|frame| Some((off(frame)?, frame)));
    let (off, next) = known.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (off <= JUMP).then_some((last, next))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::circular::initialize::key_frames::VideoTracks;
    use crate::circular::motion::CircularMotion;
    use crate::circular::tests::{Filmed, Turntable};

    /// What the loop closure says of a turn whose angles are all `share` of the true ones.
    fn gaps(share: f64, sense: f64) -> Vec<(f64, f64)> {
        let table = Turntable::new(72, 5.0 * sense, 3);
        let filmed = Filmed::new(72, table.camera.clone(), true);
        let material = VideoTracks::of_klt(&[], 72);
        let angles = table.turn.angles.iter().map(|a| a.map(|a| a * share)).collect();
        let turn = CircularMotion { angles, ..table.turn.clone() };
        let model = AxisModel::new(&filmed.video().input(&material), filmed.cameras.to_vec(), turn);
        let (last, next) = ends(&model.turn.angles).unwrap();
        let order = (last + 1 - SIDE..=last).chain(next..next + SIDE);
        let track = |x: &DVec3| order.clone().map(|f| Some((f, table.sees(f, *x)?))).collect();
        LoopClosure { tracks: table.points.iter().filter_map(track).collect(), last }.gaps(&model)
    }

    #[test]
    fn the_gap_is_what_the_angles_lack_of_a_whole_turn() {
        for (share, sense) in [(1.0, 1.0), (0.95, 1.0), (0.95, -1.0), (1.04, 1.0), (1.04, -1.0)] {
            let found = gaps(share, sense);
            assert_eq!(found.len(), SIDE, "{share} {sense}");
            for (gap, angle) in found {
                let (said, stretch) = (gap / angle, 1.0 / share - 1.0);
                // The steps within the six frames lack their share too.
                let near = 1e-6 + 0.12 * stretch.abs();
                assert!((said - stretch).abs() < near, "{share} {sense}: {said} for {stretch}");
            }
        }
    }

    #[test]
    fn the_frame_that_goes_on_lies_a_whole_turn_before_the_last() {
        let steps = |n: usize, step: f64| (0..n).map(|i| Some(step * i as f64)).collect::<Vec<_>>();
        let degrees = f64::to_radians(1.0);
        for sign in [1.0, -1.0] {
            assert_eq!(ends(&steps(72, 5.0 * degrees * sign)), Some((71, 0)));
            assert_eq!(ends(&steps(90, 5.0 * degrees * sign)), Some((89, 17)));
            assert_eq!(ends(&steps(60, 5.0 * degrees * sign)), None, "300° do not close");
            assert_eq!(ends(&steps(8, 45.0 * degrees * sign)), None, "too few frames for two sides");
        }
        let mut some = steps(72, 5.0 * degrees);
        (some[0], some[71]) = (None, None);
        assert_eq!(ends(&some), Some((70, 1)));
        assert_eq!(ends(&[]), None);
        assert_eq!(ends(&[None; 40]), None);
    }
}
