//! How much two images look alike: a global descriptor whose vocabulary is made from the set's own
//! features (VLAD: Jégou et al., CVPR 2010; intra-normalisation: Arandjelović and Zisserman, "All
//! about VLAD", CVPR 2013).

use crate::sift::{LANES, dispatch};
use rayon::prelude::*;
use scene::Features;

/// Words of the vocabulary.
/// Source: Jégou et al., CVPR 2010 (16 to 256).
const WORDS: usize = 32;
/// Rounds of Lloyd's algorithm.
/// Source: measured: see `expansion`, with which it was halved and doubled.
const ROUNDS: usize = 5;
/// Features of an image that enter its global descriptor; from sixteen times as many, over all
/// images, the vocabulary is learnt.
/// Source: measured: see `expansion`, with which it was halved and doubled.
const PER_IMAGE: usize = 1024;

/// For every image the `most` others that look most like it, the most alike first; the same for any
/// number of threads.
pub(super) fn most_alike(features: &[Features], most: usize) -> Vec<Vec<usize>> {
    let n = features.len();
    let signatures = signatures(features);
    let ranked = (0..n).into_par_iter().map(|a| {
        let others = (0..n).filter(|&b| b != a);
        let mut scored: Vec<(f32, usize)> =
            others.map(|b| (dot(&signatures[a], &signatures[b]), b)).collect();
        scored.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        scored.into_iter().take(most).map(|(_, b)| b).collect()
    });
    ranked.collect()
}

/// In partial sums, which the compiler turns into vectors.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0_f32; LANES];
    for (x, y) in a.as_chunks::<LANES>().0.iter().zip(b.as_chunks::<LANES>().0) {
        for i in 0..LANES {
            sums[i] += x[i] * y[i];
        }
    }
    sums.iter().sum()
}

type Descriptor = [f32; Features::DIM];

/// Every `stride`-th descriptor of an image, at most `most`.
fn sample(features: &Features, most: usize) -> impl Iterator<Item = Descriptor> + '_ {
    let stride = features.len().div_ceil(most.max(1)).max(1);
    let (rows, _) = features.descriptors.as_chunks::<{ Features::DIM }>();
    rows.iter().step_by(stride).map(|row| row.map(f32::from))
}

/// [n × (WORDS · 128)] unit vectors; their dot product says how much two images look alike.
fn signatures(features: &[Features]) -> Vec<Vec<f32>> {
    let share = (16 * PER_IMAGE / features.len().max(1)).max(8);
    let training: Vec<Descriptor> = features.iter().flat_map(|f| sample(f, share)).collect();
    let words = vocabulary(&training);
    features.par_iter().map(|f| signature(f, &words)).collect()
}

dispatch! {
    /// Index of the word nearest to a descriptor.
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
}

/// k-means over the training descriptors, begun with evenly spaced ones.
fn vocabulary(training: &[Descriptor]) -> Vec<Descriptor> {
    let step = (training.len() / WORDS).max(1);
    let mut words: Vec<Descriptor> = training.iter().step_by(step).take(WORDS).copied().collect();
    for _ in 0..ROUNDS {
        let labels: Vec<usize> = training.par_iter().map(|d| nearest(&words, d)).collect();
        let mut sums = vec![([0.0_f64; Features::DIM], 0_u32); words.len()];
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
    let mut vlad = vec![0.0_f32; words.len() * Features::DIM];
    for d in sample(features, PER_IMAGE) {
        let k = nearest(words, &d);
        for ((v, d), w) in vlad[k * Features::DIM..(k + 1) * Features::DIM].iter_mut().zip(&d).zip(&words[k])
        {
            *v += d - w;
        }
    }
    vlad.chunks_exact_mut(Features::DIM).for_each(normalise);
    normalise(&mut vlad);
    vlad
}

fn normalise(v: &mut [f32]) {
    let norm = v.iter().map(|x| x * x).sum::<f32>().sqrt();
    if norm > 0.0 {
        v.iter_mut().for_each(|x| *x /= norm);
    }
}
