//! Where the model of a video begins: key frames as far apart as followed points need to move, and
//! what may be their motion.

use super::seed::{AnglePattern, FocalSearch, KEYS, KeyPair, Seed, explained_share, seeds};
use crate::circular::job::VideoJob;
use crate::circular::limits::LEAST_OBSERVATIONS;
use crate::klt::KltTrack;
use crate::statistics::median;
use glam::DVec2;
use scene::Camera;
use scene::decision::{Decision, Quantity, Remark, Rule, Subject};
use std::cmp::Reverse;

/// Motion between two key frames, as a share of the longer image side; a quarter of it is enough
/// where tracks do not last until they have moved as far.
/// Source: docs/decisions/09.
const KEY_MOTION: f64 = 0.012;

/// Key frames, `stride` apart from the `first`, and what may be their motion.
pub(crate) struct VideoStart {
    pub seeds: Vec<Seed>,
    first: usize,
    stride: usize,
    keys: usize,
}

impl VideoStart {
    /// Seeds from a few key frames: as far apart as the tracks need to move, or nearer where that
    /// leaves too few of them. Points on the axis or near it hardly move at all. Key frames are
    /// sought far from those of the starts that have `failed`.
    pub(crate) fn find(
        job: &VideoJob<'_>,
        tracks: &[KltTrack],
        failed: &[Self],
    ) -> Result<Self, Box<Decision>> {
        let not_found = Decision::new(Subject::VideoMotion, false, Rule::Evidence);
        let (n, camera) = (job.frames.len(), &job.cameras[0]);
        let Some(widest) = stride(tracks, n, camera.width.max(camera.height)) else {
            return Err(Box::new(not_found.remarked(Remark::NoMotion)));
        };
        let focal = FocalSearch::new(camera, &job.known[0]);
        let strides: Vec<usize> =
            std::iter::successors(Some(widest), |s| (*s > 1).then_some(s / 2)).collect();
        let mut best: Option<f64> = None;
        // Key frames that are all tied to the next, if there are such.
        for (is_tied, &stride) in
            [true, false].iter().flat_map(|tied| strides.iter().map(move |s| (*tied, s)))
        {
            let keys = KEYS.min((n - 1) / stride + 1);
            let Some((first, pairs)) = KeyWindow { tracks, camera, stride, keys }.best(n, failed) else {
                continue;
            };
            if is_tied && !all_keys_tied(&pairs, keys) {
                continue;
            }
            let seeds = seeds(&pairs, keys, &AnglePattern::Video.angles(), &focal);
            let share = seeds.first().map_or(0.0, |s| explained_share(&pairs, s));
            if share >= 0.5 {
                return Ok(Self { seeds, first, stride, keys });
            }
            best = Some(best.map_or(share, |b| b.max(share)));
        }
        Err(Box::new(match best {
            Some(share) => {
                not_found.remarked(Remark::WeakExplanation).measured(Quantity::ExplainedMotion, share)
            }
            None => not_found.remarked(Remark::ShortTracks),
        }))
    }

    /// Whether a window with another first frame is so near that it shows much the same.
    fn is_near(&self, first: usize, frames: usize) -> bool {
        first.abs_diff(self.first) < ((self.keys - 1) * self.stride).max(frames / 4)
    }

    /// Angles of a seed by frame; frames between key frames get angles in between.
    pub(crate) fn angles(&self, seed: &Seed, frames: usize) -> Vec<Option<f64>> {
        let mut angles = vec![None; frames];
        for k in 0..self.keys - 1 {
            for i in 0..=self.stride {
                let share = i as f64 / self.stride as f64;
                angles[self.first + k * self.stride + i] =
                    Some(seed.angles[k] + share * (seed.angles[k + 1] - seed.angles[k]));
            }
        }
        angles
    }
}

/// The fewest frames over which the tracks move by [`KEY_MOTION`]; where they do not last as long,
/// those over which they move farthest.
fn stride(tracks: &[KltTrack], frames: usize, side: u32) -> Option<usize> {
    let wanted = KEY_MOTION * f64::from(side);
    let mut farthest = (0.0, 0);
    for s in 1..=((frames - 1) / 2).max(1) {
        let mut all = Vec::new();
        for track in tracks {
            all.extend(track.positions.windows(s + 1).step_by(s).map(|w| w[0].distance(w[s])));
        }
        if all.len() < 20 {
            break;
        }
        let moved = median(all);
        if moved > farthest.0 {
            farthest = (moved, s);
        }
        if moved >= wanted {
            break;
        }
    }
    (farthest.0 >= 0.25 * wanted).then_some(farthest.1)
}

/// Whether every key frame shares tracks with the next.
fn all_keys_tied(pairs: &[KeyPair], keys: usize) -> bool {
    (0..keys - 1).all(|k| pairs.iter().any(|p| p.keys == [k, k + 1]))
}

/// So many key frames at a stride, somewhere in a video.
struct KeyWindow<'a> {
    tracks: &'a [KltTrack],
    camera: &'a Camera,
    stride: usize,
    keys: usize,
}

impl KeyWindow<'_> {
    /// The first frame of the window whose key frames share most tracks, and their matches, beside
    /// those that have failed.
    fn best(&self, frames: usize, failed: &[VideoStart]) -> Option<(usize, Vec<KeyPair>)> {
        let span = (self.keys - 1) * self.stride;
        if self.keys < 3 || span >= frames {
            return None;
        }
        let firsts = (0..frames - span).step_by(self.stride);
        let others = firsts.filter(|first| !failed.iter().any(|start| start.is_near(*first, frames)));
        let windows = others.map(|first| (first, self.pairs(first)));
        let (first, mut pairs) = windows.max_by_key(|(first, pairs)| {
            (pairs.iter().map(|p| p.points.len().min(100)).sum::<usize>(), Reverse(*first))
        })?;
        pairs.retain(|p| p.points.len() >= LEAST_OBSERVATIONS);
        Some((first, pairs))
    }

    /// Matches of key frames up to three places apart.
    fn pairs(&self, first: usize) -> Vec<KeyPair> {
        let mut pairs = Vec::new();
        for i in 0..self.keys {
            for k in i + 1..self.keys.min(i + 4) {
                let frames = [i, k].map(|key| first + key * self.stride);
                let points = self.tracks.iter().filter_map(|t| self.matched(t, frames)).collect();
                pairs.push(KeyPair { keys: [i, k], points });
            }
        }
        pairs
    }

    /// Ideal pixels of a track in two frames.
    fn matched(&self, track: &KltTrack, frames: [usize; 2]) -> Option<[DVec2; 2]> {
        let [a, b] = frames.map(|f| track.positions.get(f.checked_sub(track.first)?).copied());
        Some([a?, b?].map(|p| self.camera.unproject(p) * self.camera.mean_focal()))
    }
}
