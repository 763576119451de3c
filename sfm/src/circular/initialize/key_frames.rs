//! Keypoints and tracks of a video: points followed from frame to frame, and features of key frames
//! across wide steps.

use crate::circular::limits::{COMPARABLE, INLIER_PX, LEAST_OBSERVATIONS};
use crate::circular::model::AxisModel;
use crate::circular::motion::wrap_angle;
use crate::error::SfmError;
use crate::klt::KltTrack;
use crate::matching::{MatchConfig, match_pairs};
use crate::sift::{SiftConfig, extract_all};
use crate::solvers::{essential_from_pose, sampson_sq};
use crate::tracks::{Tracks, build_tracks, positions};
use glam::{DMat3, DVec2, DVec3};
use scene::{Features, FrameSet, Progress, TwoViewGeometry, TwoViewKind};

/// Turn between key frames, radians.
/// Source: docs/decisions/08; 0.1, 0.06 and 0.03 leave 0.103°, 0.074° and 0.073° of the mock-up
/// turned by hand.
const KEY_STEP: f64 = 0.03;
/// A match that moves by less is stationary, pixels.
/// Source: chosen by hand, never measured.
const STATIONARY_PX: f64 = 1.5;
/// A track that stays within this over its life is stationary, pixels a frame and at least one.
/// Source: chosen by hand, never measured.
const STATIONARY_RATE_PX: f64 = 0.08;

/// Drops tracks that do not move (the screen, the pole, a watermark). Returns how many there were.
pub(crate) fn drop_stationary(tracks: &mut Vec<KltTrack>) -> usize {
    let before = tracks.len();
    tracks.retain(|t| {
        let farthest = t.positions.iter().map(|p| p.distance(t.positions[0])).fold(0.0, f64::max);
        farthest > (STATIONARY_RATE_PX * t.positions.len() as f64).max(1.0)
    });
    before - tracks.len()
}

/// Keypoints by frame, and which of them are one point.
#[derive(Clone, Debug, Default)]
pub(crate) struct VideoTracks {
    pub keypoints: Vec<Vec<DVec2>>,
    pub tracks: Tracks,
}

impl VideoTracks {
    /// Of followed points alone.
    pub(crate) fn of_klt(tracks: &[KltTrack], frames: usize) -> Self {
        let mut material = Self {
            keypoints: vec![Vec::new(); frames],
            tracks: Tracks { of: vec![Vec::new(); frames], views: Vec::new() },
        };
        material.add_klt(tracks);
        material
    }

    fn add_klt(&mut self, tracks: &[KltTrack]) {
        for track in tracks {
            self.add((track.first..).zip(track.positions.iter().copied()));
        }
    }

    /// A point that was seen at a pixel of each of some frames.
    pub(crate) fn add(&mut self, observations: impl Iterator<Item = (usize, DVec2)>) {
        let id = self.tracks.views.len() as u32;
        let mut views = Vec::new();
        for (frame, p) in observations {
            views.push([frame as u32, self.keypoints[frame].len() as u32]);
            self.keypoints[frame].push(p);
            self.tracks.of[frame].push(id);
        }
        self.tracks.views.push(views);
    }

    /// Of features of some frames, joined by verified matches, and followed points after them.
    pub(crate) fn of_both(
        features: &[Features],
        geometries: &[TwoViewGeometry],
        tracks: &[KltTrack],
    ) -> Self {
        let mut material = Self {
            keypoints: features.iter().map(positions).collect(),
            tracks: build_tracks(features, geometries),
        };
        material.add_klt(tracks);
        material
    }
}

/// Features of key frames, and matches between them that agree with a turn.
pub(crate) struct KeyFrames {
    /// One per frame; empty for those that are not key frames.
    pub features: Vec<Features>,
    /// Matches between frames whose angles in the video are near each other.
    pub near: Vec<TwoViewGeometry>,
    /// Matches between frames that a whole turn brought together again.
    pub closure: Vec<TwoViewGeometry>,
    /// Pairs that were matched.
    pub matched: usize,
}

impl KeyFrames {
    /// Finds and matches features of frames at least [`KEY_STEP`] apart.
    pub(crate) fn new(
        frames: &FrameSet,
        model: &AxisModel,
        sift: &SiftConfig,
        matching: &MatchConfig,
        progress: &Progress,
    ) -> Result<Self, SfmError> {
        let keys = key_frames(&model.turn.angles);
        let some = some_frames(frames, keys.iter().map(|k| k.0));
        let of_keys = extract_all(&some, sift, progress)?;
        let (near_pairs, closing_pairs) = pairs_to_match(&keys);
        let mut verified = Vec::new();
        for pairs in [&near_pairs, &closing_pairs] {
            let mut geometries = Vec::new();
            for (i, k, m) in match_pairs(&of_keys, pairs, matching, progress)? {
                let inliers = agreeing_matches(model, [keys[i].0, keys[k].0], [&of_keys[i], &of_keys[k]], &m);
                if inliers.len() >= LEAST_OBSERVATIONS {
                    geometries.push(geometry(keys[i].0, keys[k].0, inliers));
                }
            }
            verified.push(geometries);
        }
        let closure = verified.pop().unwrap_or_default();
        let near = verified.pop().unwrap_or_default();
        let mut features = vec![Features::default(); frames.len()];
        for ((frame, _), f) in keys.iter().zip(of_keys) {
            features[*frame] = f;
        }
        Ok(Self { features, near, closure, matched: near_pairs.len() + closing_pairs.len() })
    }
}

/// Pairs of key frames whose angles are near each other, and pairs that a whole turn brought
/// together again.
fn pairs_to_match(keys: &[(usize, f64)]) -> (Vec<(usize, usize)>, Vec<(usize, usize)>) {
    let (mut near, mut closing) = (Vec::new(), Vec::new());
    for i in 0..keys.len() {
        for k in i + 1..keys.len() {
            let turn = keys[k].1 - keys[i].1;
            if turn.abs() <= 2.0 * COMPARABLE {
                near.push((i, k));
            } else if wrap_angle(turn).abs() <= 1.5 * COMPARABLE {
                closing.push((i, k));
            }
        }
    }
    (near, closing)
}

/// Frames about [`KEY_STEP`] apart, with their angles.
fn key_frames(angles: &[Option<f64>]) -> Vec<(usize, f64)> {
    let mut keys: Vec<(usize, f64)> = Vec::new();
    for (frame, angle) in angles.iter().enumerate() {
        let Some(angle) = *angle else { continue };
        if keys.last().is_none_or(|(_, last)| (angle - last).abs() >= KEY_STEP) {
            keys.push((frame, angle));
        }
    }
    keys
}

/// Matches that move, and agree with the relative pose.
fn agreeing_matches(
    model: &AxisModel,
    frames: [usize; 2],
    features: [&Features; 2],
    matches: &[[u32; 2]],
) -> Vec<[u32; 2]> {
    let [Some(a), Some(b)] = frames.map(|f| model.turn.pose(f)) else { return Vec::new() };
    let camera = &model.state.cameras[0];
    let f = camera.mean_focal();
    let inverse = DMat3::from_diagonal(DVec3::new(1.0 / f, 1.0 / f, 1.0));
    let m = inverse * essential_from_pose(&b.compose(&a.inverse())) * inverse;
    let mut agreeing = Vec::new();
    for &[i, k] in matches {
        let p = features[0].keypoints[i as usize].position();
        let q = features[1].keypoints[k as usize].position();
        let error = sampson_sq(&m, camera.unproject(p) * f, camera.unproject(q) * f);
        if p.distance(q) > STATIONARY_PX && error < INLIER_PX * INLIER_PX {
            agreeing.push([i, k]);
        }
    }
    agreeing
}

/// Some frames of a video, in their order.
pub(crate) fn some_frames(all: &FrameSet, numbers: impl Iterator<Item = usize>) -> FrameSet {
    let frames = numbers.map(|f| all.frames[f].clone()).collect();
    FrameSet { frames, is_video: true, ..FrameSet::default() }
}

fn geometry(a: usize, b: usize, inliers: Vec<[u32; 2]>) -> TwoViewGeometry {
    TwoViewGeometry {
        a,
        b,
        kind: TwoViewKind::Calibrated,
        inliers,
        f: None,
        e: None,
        h: None,
        b_from_a: None,
        median_angle: 0.0,
    }
}
