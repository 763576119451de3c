//! The loop closure of a whole turn: the first frames show again what the last ones show, so points
//! are followed on from the last frame to the first, and say by how much the angles miss the whole
//! turn (docs/decisions/10).

use crate::circular::initialize::key_frames::{drop_stationary, some_frames};
use crate::circular::limits::{COMPARABLE, INLIER_PX, LEAST_OBSERVATIONS, is_majority};
use crate::circular::model::AxisModel;
use crate::circular::motion::wrap_angle;
use crate::circular::register::resect_angle;
use crate::error::SfmError;
use crate::klt::{KltConfig, track};
use crate::triangulation::{Gates, PointView, triangulate};
use glam::{DVec2, DVec3};
use scene::{FrameSet, Progress};
use std::collections::BTreeMap;

/// Frames on either side.
/// Source: docs/decisions/10; twelve changed nothing for the better (docs/decisions/09).
const SIDE: usize = 6;
/// Largest reprojection error of a point, pixels, and the least angle between its rays, radians.
/// Source of the angle: derived; half a step of the coarsest videos that are followed.
const GATES: Gates = Gates { max_error_px: INLIER_PX, min_angle: 0.02 };

/// What a frame or a pair of frames says of a closed turn.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LoopGap {
    /// By how much the angle across the loop closure is too small, radians.
    pub missing: f64,
    /// That angle, radians.
    pub angle: f64,
}

/// Points followed across the loop closure.
#[derive(Clone, Debug, Default)]
pub(crate) struct LoopClosure {
    /// By point its frame and pixel, first those before the loop closure.
    pub tracks: Vec<Vec<(usize, DVec2)>>,
    /// The last frame before it.
    last: usize,
}

impl LoopClosure {
    /// Follows points from the last frames to those that a whole turn later show the same; none
    /// where no frame does.
    pub(crate) fn follow(
        frames: &FrameSet,
        angles: &[Option<f64>],
        klt: &KltConfig,
        progress: &Progress,
    ) -> Result<Self, SfmError> {
        let Some((last, next)) = ends(angles) else { return Ok(Self::default()) };
        let order: Vec<usize> = (last + 1 - SIDE..=last).chain(next..next + SIDE).collect();
        let mut followed = track(&some_frames(frames, order.iter().copied()), klt, progress)?;
        drop_stationary(&mut followed);
        // Two observations on one side make a point, one on the other a tie.
        followed.retain(|t| t.first + 1 < SIDE && t.first + t.positions.len() > SIDE);
        let mut tracks = Vec::new();
        for t in &followed {
            tracks.push(order[t.first..].iter().copied().zip(t.positions.iter().copied()).collect());
        }
        Ok(Self { tracks, last })
    }

    /// For each frame after the loop closure by how much the angle from there to the last frame is
    /// too small, and that angle.
    pub(crate) fn gaps(&self, model: &AxisModel) -> Vec<LoopGap> {
        let Some(end) = model.turn.angles.get(self.last).copied().flatten() else { return Vec::new() };
        let camera = &model.state.cameras[0];
        let mut gaps = Vec::new();
        for (frame, seen) in self.seen_again(model) {
            let Some(start) = model.turn.angles[frame].filter(|_| seen.len() >= LEAST_OBSERVATIONS) else {
                continue;
            };
            let found = resect_angle(camera, &model.turn.axis, &seen, start, COMPARABLE);
            if found.inliers >= LEAST_OBSERVATIONS && is_majority(found.inliers, found.asked) {
                gaps.push(LoopGap { missing: -wrap_angle(found.angle - start), angle: end - start });
            }
        }
        gaps
    }

    /// By frame after the loop closure the points that it sees, triangulated before it.
    fn seen_again(&self, model: &AxisModel) -> BTreeMap<usize, Vec<(DVec2, DVec3)>> {
        let camera = &model.state.cameras[0];
        let mut seen: BTreeMap<usize, Vec<(DVec2, DVec3)>> = BTreeMap::new();
        for track in &self.tracks {
            let before = track.iter().filter(|(frame, _)| self.is_before(*frame));
            let views: Vec<PointView<'_>> = before
                .filter_map(|&(frame, pixel)| Some(PointView::new(&model.turn.pose(frame)?, camera, pixel)))
                .collect();
            let Some(point) = triangulate(&views, &GATES) else { continue };
            for &(frame, pixel) in track.iter().filter(|(frame, _)| !self.is_before(*frame)) {
                seen.entry(frame).or_default().push((pixel, point.position));
            }
        }
        seen
    }

    fn is_before(&self, frame: usize) -> bool {
        frame <= self.last && frame + SIDE > self.last
    }
}

/// The last frame that has an angle, and the first of the frames that go on from it a whole turn
/// before.
fn ends(angles: &[Option<f64>]) -> Option<(usize, usize)> {
    let last = angles.iter().rposition(Option::is_some)?;
    let (start, end) = (angles.iter().flatten().next().copied()?, angles[last]?);
    let whole = std::f64::consts::TAU.copysign(end - start);
    let enough = (last + 1).checked_sub(2 * SIDE)?;
    let known = (0..=enough).filter_map(|frame| Some(((angles[frame]? - (end - whole)).abs(), frame)));
    let (off, next) = known.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (off <= COMPARABLE).then_some((last, next))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::circular::initialize::key_frames::VideoTracks;
    use crate::circular::motion::CircularMotion;
    use crate::circular::tests::{Filmed, Turntable};

    /// What the loop closure says of a turn whose angles are all `share` of the true ones.
    fn gaps(share: f64, sense: f64) -> Vec<LoopGap> {
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
            for LoopGap { missing, angle } in found {
                let (said, stretch) = (missing / angle, 1.0 / share - 1.0);
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
