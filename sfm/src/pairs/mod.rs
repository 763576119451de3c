//! Which pairs of images are matched at all.
//!
//! Small sets: every pair. Larger ones: neighbours in time (videos) and, for every image, those
//! that look most alike (`retrieval`); from there on along the matches themselves, for what matches
//! a common third image may match too (Agarwal et al., "Building Rome in a Day", ICCV 2009: query
//! expansion). So true pairs are found whatever the image retrieval says of them, and what cannot
//! match is not tried.

mod expansion;
mod retrieval;

pub(crate) use expansion::match_related;

use scene::flag::between;
use scene::{Features, FrameSet};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Settings of the choice of pairs.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize, Deserialize)]
#[serde(default)]
pub struct PairConfig {
    /// Up to so many photos every pair is matched.
    #[arg(long, value_parser = between::<usize>(0, 1_000_000), default_value_t = Self::default().exhaustive_up_to, help_heading = "Matching")]
    pub exhaustive_up_to: usize,
    /// The same for the frames of a video: what repeats on an object shows by the pairs that are
    /// missing.
    #[arg(long, value_parser = between::<usize>(0, 1_000_000), default_value_t = Self::default().exhaustive_frames_up_to, help_heading = "Matching")]
    pub exhaustive_frames_up_to: usize,
    /// Beyond that, every frame of a video is matched with so many that follow it.
    #[arg(long, value_parser = between::<usize>(0, 1_000_000), default_value_t = Self::default().pair_window, help_heading = "Matching")]
    pub pair_window: usize,
    /// Beyond that, the search for an image's partners ends when so many have been found.
    #[arg(long, value_parser = between::<usize>(0, 1_000_000), default_value_t = Self::default().pair_candidates, help_heading = "Matching")]
    pub pair_candidates: usize,
}

impl Default for PairConfig {
    fn default() -> Self {
        Self { exhaustive_up_to: 40, exhaustive_frames_up_to: 100, pair_window: 5, pair_candidates: 30 }
    }
}

impl PairConfig {
    /// Whether every pair of so many images is matched.
    fn exhaustive(&self, images: usize, is_video: bool) -> bool {
        let most = if is_video { self.exhaustive_frames_up_to } else { self.exhaustive_up_to };
        images <= most.max(2)
    }
}

/// The pairs `(a, b)`, `a < b`, in ascending order that are matched first: all of a small set. The
/// order of files is never trusted to be the order of a ring: of photos only image retrieval
/// counts, of videos image retrieval closes the loops. The same for any number of threads.
pub(crate) fn first_pairs(
    frames: &FrameSet,
    features: &[Features],
    config: &PairConfig,
) -> Vec<(usize, usize)> {
    let n = frames.len().min(features.len());
    if config.exhaustive(n, frames.is_video) {
        return (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b))).collect();
    }
    let window = if frames.is_video { config.pair_window } else { 0 };
    let mut pairs: BTreeSet<(usize, usize)> = BTreeSet::new();
    for a in 0..n {
        pairs.extend((a + 1..=(a + window).min(n - 1)).map(|b| (a, b)));
    }
    let first = config.pair_candidates.div_ceil(4);
    for (a, ranked) in retrieval::most_alike(&features[..n], first + 2 * window).into_iter().enumerate() {
        let others = ranked.into_iter().filter(|b| b.abs_diff(a) > window);
        pairs.extend(others.take(first).map(|b| (a.min(b), a.max(b))));
    }
    pairs.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng;
    use scene::{Frame, Keypoint, rng};

    fn frames(n: usize, is_video: bool) -> FrameSet {
        FrameSet { frames: vec![Frame::default(); n], is_video, ..FrameSet::default() }
    }

    /// A ring of places: each image sees 40 of them, and so shares some with its neighbours on the
    /// ring.
    fn ring(n: usize) -> Vec<Features> {
        let place = |p: usize| {
            let mut r = rng::rng(7, "place", p as u64);
            (0..Features::DIM).map(|_| r.random_range(0..90_u8)).collect::<Vec<u8>>()
        };
        let places: Vec<Vec<u8>> = (0..10 * n).map(place).collect();
        let image = |i: usize| Features {
            keypoints: vec![Keypoint::default(); 40],
            descriptors: (0..40).flat_map(|k| places[(10 * i + k) % places.len()].clone()).collect(),
        };
        (0..n).map(image).collect()
    }

    #[test]
    fn matches_every_pair_of_a_small_set_whatever_its_order() {
        let pairs = first_pairs(&frames(5, false), &vec![Features::default(); 5], &PairConfig::default());
        assert_eq!(pairs.len(), 10);
        assert!(pairs.iter().all(|&(a, b)| a < b && b < 5));
        assert!(first_pairs(&frames(1, false), &[Features::default()], &PairConfig::default()).is_empty());
        assert!(first_pairs(&frames(0, false), &[], &PairConfig::default()).is_empty());
    }

    #[test]
    fn finds_the_neighbours_of_a_ring_among_shuffled_photos() {
        let n = 60;
        let ring = ring(n);
        let position = |i: usize| (i * 23) % n; // 23 and 60 share no factor: a permutation
        let shuffled: Vec<Features> = (0..n).map(|i| ring[position(i)].clone()).collect();
        let config = PairConfig {
            exhaustive_up_to: 10,
            exhaustive_frames_up_to: 10,
            pair_window: 4,
            pair_candidates: 24,
        };
        let pairs: BTreeSet<_> = first_pairs(&frames(n, false), &shuffled, &config).into_iter().collect();
        assert!(pairs.len() <= 6 * n);
        for a in 0..n {
            for b in a + 1..n {
                let apart = position(a).abs_diff(position(b));
                if apart.min(n - apart) <= 2 {
                    assert!(pairs.contains(&(a, b)), "ring positions {} and {}", position(a), position(b));
                }
            }
        }
    }

    #[test]
    fn closes_the_loop_of_a_video() {
        let n = 60;
        let config = PairConfig {
            exhaustive_up_to: 10,
            exhaustive_frames_up_to: 10,
            pair_window: 4,
            pair_candidates: 12,
        };
        let pairs = first_pairs(&frames(n, true), &ring(n), &config);
        assert!(pairs.contains(&(0, n - 1)) && pairs.contains(&(0, 4)) && pairs.contains(&(30, 34)));
    }

    #[test]
    fn images_without_features_do_not_stop_the_choice() {
        let config = PairConfig {
            exhaustive_up_to: 2,
            exhaustive_frames_up_to: 2,
            pair_window: 1,
            pair_candidates: 4,
        };
        let pairs = first_pairs(&frames(4, true), &vec![Features::default(); 4], &config);
        assert!(pairs.contains(&(0, 1)) && pairs.contains(&(2, 3)));
    }
}
