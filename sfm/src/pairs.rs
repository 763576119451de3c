//! Which pairs of images are matched at all.
//!
//! Small sets: every pair. Larger ones: neighbours in time (videos) and, for every image, those that look most
//! alike by a global descriptor whose vocabulary is made from the set's own features (VLAD: Jégou et al., CVPR
//! 2010; intra-normalisation: Arandjelović and Zisserman, "All about VLAD", CVPR 2013).

use rayon::prelude::*;
use scene::{Features, FrameSet};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Settings of the choice of pairs.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize, Deserialize)]
#[serde(default)]
pub struct PairConfig {
    /// Up to so many images every pair is matched.
    #[arg(long, default_value_t = Self::default().exhaustive_up_to, help_heading = "Matching")]
    pub exhaustive_up_to: usize,
    /// Beyond that, every frame of a video is matched with so many that follow it.
    #[arg(long, default_value_t = Self::default().pair_window, help_heading = "Matching")]
    pub pair_window: usize,
    /// Beyond that, every image is matched with so many that look most alike (of a video: outside the window).
    #[arg(long, default_value_t = Self::default().pair_candidates, help_heading = "Matching")]
    pub pair_candidates: usize,
}

impl Default for PairConfig {
    fn default() -> Self {
        Self { exhaustive_up_to: 200, pair_window: 15, pair_candidates: 30 }
    }
}

/// Words of the vocabulary.
const WORDS: usize = 32;
/// Descriptors that the vocabulary is learnt from, over all images.
const TRAINING: usize = 16_384;
/// Rounds of Lloyd's algorithm.
const ROUNDS: usize = 8;
/// Features of an image that enter its global descriptor.
const PER_IMAGE: usize = 1024;
const DIM: usize = Features::DIM;

/// Pairs `(a, b)`, `a < b`, in ascending order. The order of files is never trusted to be the order of a ring: of
/// photos only likeness counts, of videos likeness outside the window closes the loops. The same for any number of
/// threads.
pub fn choose_pairs(frames: &FrameSet, features: &[Features], config: &PairConfig) -> Vec<(usize, usize)> {
    let n = frames.len().min(features.len());
    if n <= config.exhaustive_up_to.max(2) {
        return (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b))).collect();
    }
    let window = if frames.is_video { config.pair_window } else { 0 };
    let mut pairs: BTreeSet<(usize, usize)> = BTreeSet::new();
    for a in 0..n {
        pairs.extend((a + 1..=(a + window).min(n - 1)).map(|b| (a, b)));
    }
    let signatures = signatures(&features[..n]);
    let alike: Vec<Vec<usize>> = (0..n)
        .into_par_iter()
        .map(|a| {
            let likeness =
                |b: usize| signatures[a].iter().zip(&signatures[b]).map(|(x, y)| x * y).sum::<f32>();
            let others = (0..n).filter(|&b| b.abs_diff(a) > window);
            let mut scored: Vec<(f32, usize)> = others.map(|b| (likeness(b), b)).collect();
            scored.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
            scored.into_iter().take(config.pair_candidates).map(|(_, b)| b).collect()
        })
        .collect();
    for (a, candidates) in alike.into_iter().enumerate() {
        pairs.extend(candidates.into_iter().map(|b| (a.min(b), a.max(b))));
    }
    pairs.into_iter().collect()
}

type Descriptor = [f32; DIM];

/// Every `stride`-th descriptor of an image, at most `most`.
fn sample(features: &Features, most: usize) -> impl Iterator<Item = Descriptor> + '_ {
    let stride = features.len().div_ceil(most.max(1)).max(1);
    let (rows, _) = features.descriptors.as_chunks::<DIM>();
    rows.iter().step_by(stride).map(|row| row.map(f32::from))
}

/// [n × (WORDS · 128)] unit vectors; their dot product says how much two images look alike.
fn signatures(features: &[Features]) -> Vec<Vec<f32>> {
    let share = (TRAINING / features.len().max(1)).max(8);
    let training: Vec<Descriptor> = features.iter().flat_map(|f| sample(f, share)).collect();
    let words = vocabulary(&training);
    features.par_iter().map(|f| signature(f, &words)).collect()
}

fn nearest(words: &[Descriptor], d: &Descriptor) -> usize {
    let mut best = (f32::INFINITY, 0);
    for (k, word) in words.iter().enumerate() {
        let mut sums = [0.0_f32; 8];
        for (w, d) in word.as_chunks::<8>().0.iter().zip(d.as_chunks::<8>().0) {
            for i in 0..8 {
                sums[i] += (w[i] - d[i]) * (w[i] - d[i]);
            }
        }
        let distance: f32 = sums.iter().sum();
        if distance < best.0 {
            best = (distance, k);
        }
    }
    best.1
}

/// k-means over the training descriptors, begun with evenly spaced ones.
fn vocabulary(training: &[Descriptor]) -> Vec<Descriptor> {
    let step = (training.len() / WORDS).max(1);
    let mut words: Vec<Descriptor> = training.iter().step_by(step).take(WORDS).copied().collect();
    for _ in 0..ROUNDS {
        let labels: Vec<usize> = training.par_iter().map(|d| nearest(&words, d)).collect();
        let mut sums = vec![([0.0_f64; DIM], 0_u32); words.len()];
        for (d, label) in training.iter().zip(labels) {
            for (s, v) in sums[label].0.iter_mut().zip(d) {
                *s += f64::from(*v);
            }
            sums[label].1 += 1;
        }
        for (word, (sum, count)) in words.iter_mut().zip(&sums) {
            if *count > 0 {
                *word = sum.map(|s| (s / f64::from(*count)) as f32);
            }
        }
    }
    words
}

/// Sums of residuals to the nearest word, each word's sum and then the whole scaled to unit length.
fn signature(features: &Features, words: &[Descriptor]) -> Vec<f32> {
    let mut vlad = vec![0.0_f32; words.len() * DIM];
    for d in sample(features, PER_IMAGE) {
        let k = nearest(words, &d);
        for ((v, d), w) in vlad[k * DIM..(k + 1) * DIM].iter_mut().zip(&d).zip(&words[k]) {
            *v += d - w;
        }
    }
    vlad.chunks_exact_mut(DIM).for_each(normalise);
    normalise(&mut vlad);
    vlad
}

fn normalise(v: &mut [f32]) {
    let norm = v.iter().map(|x| x * x).sum::<f32>().sqrt();
    if norm > 0.0 {
        v.iter_mut().for_each(|x| *x /= norm);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng;
    use scene::{Frame, Keypoint, rng};

    fn frames(n: usize, is_video: bool) -> FrameSet {
        FrameSet { frames: vec![Frame::default(); n], is_video, notes: Vec::new() }
    }

    /// A ring of places: each image sees 40 of them, and so shares some with its neighbours on the ring.
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
        let pairs = choose_pairs(&frames(5, false), &vec![Features::default(); 5], &PairConfig::default());
        assert_eq!(pairs.len(), 10);
        assert!(pairs.iter().all(|&(a, b)| a < b && b < 5));
        assert!(choose_pairs(&frames(1, false), &[Features::default()], &PairConfig::default()).is_empty());
        assert!(choose_pairs(&frames(0, false), &[], &PairConfig::default()).is_empty());
    }

    #[test]
    fn finds_the_neighbours_of_a_ring_among_shuffled_photos() {
        let n = 60;
        let ring = ring(n);
        let position = |i: usize| (i * 23) % n; // 23 and 60 share no factor: a permutation
        let shuffled: Vec<Features> = (0..n).map(|i| ring[position(i)].clone()).collect();
        let config = PairConfig { exhaustive_up_to: 10, pair_window: 4, pair_candidates: 6 };
        let pairs: BTreeSet<_> = choose_pairs(&frames(n, false), &shuffled, &config).into_iter().collect();
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
        let config = PairConfig { exhaustive_up_to: 10, pair_window: 4, pair_candidates: 3 };
        let pairs = choose_pairs(&frames(n, true), &ring(n), &config);
        assert!(pairs.contains(&(0, n - 1)) && pairs.contains(&(0, 4)) && pairs.contains(&(30, 34)));
    }

    #[test]
    fn images_without_features_do_not_stop_the_choice() {
        let config = PairConfig { exhaustive_up_to: 2, pair_window: 1, pair_candidates: 1 };
        let pairs = choose_pairs(&frames(4, true), &vec![Features::default(); 4], &config);
        assert!(pairs.contains(&(0, 1)) && pairs.contains(&(2, 3)));
    }
}
