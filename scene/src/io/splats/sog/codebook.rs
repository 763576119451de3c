//! Codebooks: the 256 numbers, or the few thousand vectors, that stand for all others.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Entries of a codebook of numbers. Source: the format, a byte.
const BOOK: usize = 256;

/// 256 ascending numbers that cover `values`: `step` apart about their median and, where that does
/// not reach both ends, ever farther apart, by sinh, so that a few values far out cost the others
/// nothing. Equal steps compress better than equal shares of the values.
pub(super) fn of_numbers(values: &[f32], step: f32) -> Vec<f32> {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f32::total_cmp);
    let n = sorted.len();
    let [low, median, high] = [0, n / 2, n - 1].map(|i| f64::from(sorted[i]));
    let step = f64::from(step);
    let [low, high] = [low, high].map(|v| (v - median) / step);
    let bend = least_bend(low, high);
    let first = place(low, bend);
    (0..BOOK).map(|i| (median + step * value(first + i as f64, bend)) as f32).collect()
}

/// Where a value lies, in entries from the median; both in steps: asinh(bend x) / bend.
fn place(x: f64, bend: f64) -> f64 {
    if bend > 0.0 { (bend * x).asinh() / bend } else { x }
}

/// The inverse of [`place`].
fn value(u: f64, bend: f64) -> f64 {
    if bend > 0.0 { (bend * u).sinh() / bend } else { u }
}

/// The least bend with which the entries reach from `low` to `high`, by bisection.
fn least_bend(low: f64, high: f64) -> f64 {
    let entries = (BOOK - 1) as f64;
    let (mut less, mut bend) = (0.0_f64, 0.0_f64);
    while place(high, bend) - place(low, bend) > entries {
        (less, bend) = (bend, (2.0 * bend).max(1e-6));
    }
    for _ in 0..f64::MANTISSA_DIGITS {
        let mid = less.midpoint(bend);
        if place(high, mid) - place(low, mid) > entries {
            less = mid;
        } else {
            bend = mid;
        }
    }
    bend
}

/// The number of the nearest entry of an ascending codebook.
pub(super) fn nearest(book: &[f32], value: f32) -> u8 {
    let above = book.partition_point(|v| *v < value).min(book.len() - 1);
    let below = above.saturating_sub(1);
    (if (book[above] - value).abs() < (value - book[below]).abs() { above } else { below }) as u8
}

/// Vectors of one entry of the palette.
struct Leaf {
    /// Sum of the squared distances from their mean.
    error: f64,
    members: Vec<u32>,
    /// The component that varies most, and its mean.
    split: (usize, f64),
}

impl PartialEq for Leaf {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for Leaf {}
impl PartialOrd for Leaf {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Leaf {
    fn cmp(&self, other: &Self) -> Ordering {
        self.error.total_cmp(&other.error).then_with(|| other.members[0].cmp(&self.members[0]))
    }
}

impl Leaf {
    fn new(vectors: &[f32], width: usize, members: Vec<u32>) -> (Self, Vec<f64>) {
        let n = members.len() as f64;
        let (mut mean, mut squares) = (vec![0.0_f64; width], vec![0.0_f64; width]);
        for &m in &members {
            for (c, v) in vectors[m as usize * width..][..width].iter().enumerate() {
                mean[c] += f64::from(*v);
                squares[c] += f64::from(*v).powi(2);
            }
        }
        mean.iter_mut().for_each(|m| *m /= n);
        let spreads: Vec<f64> =
            squares.iter().zip(&mean).map(|(square, mean)| (square - n * mean * mean).max(0.0)).collect();
        let widest = (0..width).max_by(|&a, &b| spreads[a].total_cmp(&spreads[b])).unwrap_or(0);
        let error = spreads.iter().sum();
        (Self { error, members, split: (widest, mean[widest]) }, mean)
    }
}

/// A palette of at most `size` vectors and the entry of each vector: what varies most is halved
/// until there are so many (a tree-structured quantiser: Gersho and Gray 1992, section 12.4).
pub(super) fn of_vectors(vectors: &[f32], width: usize, size: usize) -> (Vec<f32>, Vec<u16>) {
    let count = vectors.len() / width;
    let mut leaves = BinaryHeap::from([Leaf::new(vectors, width, (0..count as u32).collect()).0]);
    let mut done = Vec::new();
    while leaves.len() + done.len() < size {
        let Some(Leaf { error, members, split: (axis, mean) }) = leaves.pop() else { break };
        let (low, high): (Vec<u32>, Vec<u32>) =
            members.into_iter().partition(|m| f64::from(vectors[*m as usize * width + axis]) <= mean);
        if error <= 0.0 || low.is_empty() || high.is_empty() {
            let members = if low.is_empty() { high } else { [low, high].concat() };
            done.push(Leaf { error, members, split: (axis, mean) });
            continue;
        }
        leaves.extend([low, high].map(|members| Leaf::new(vectors, width, members).0));
    }
    let (mut palette, mut labels) = (Vec::new(), vec![0_u16; count]);
    let all = leaves.into_sorted_vec().into_iter().chain(done);
    for (number, leaf) in (0..=u16::MAX).zip(all) {
        let (leaf, mean) = Leaf::new(vectors, width, leaf.members);
        palette.extend(mean.iter().map(|v| *v as f32));
        leaf.members.iter().for_each(|m| labels[*m as usize] = number);
    }
    (palette, labels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::rng;
    use rand::Rng;

    #[test]
    fn numbers_are_near_their_entry_and_few_numbers_are_kept() {
        let mut r = rng(1, "codebook", 0);
        let values: Vec<f32> = (0..5000).map(|_| r.random_range(-1.0_f32..1.0).powi(3)).collect();
        let book = of_numbers(&values, 0.01);
        let worst = values.iter().map(|v| (v - book[usize::from(nearest(&book, *v))]).abs());
        assert!(worst.fold(0.0, f32::max) < 0.02);
        for far in [2.0, 50.0, 1e9] {
            let book = of_numbers(&[far, 0.0, -1.0, 0.01, 0.0], 0.01);
            assert!(book.windows(2).all(|w| w[0] < w[1]) && book.len() == 256);
            for v in [far, 0.0, -1.0, 0.01] {
                let off = (book[usize::from(nearest(&book, v))] - v).abs();
                assert!(off <= 0.006_f32.max(0.2 * v.abs()), "{v} of {far}: {off}");
            }
        }
        assert_eq!(nearest(&of_numbers(&[3.0; 9], 0.01), 3.0), 0);
    }

    #[test]
    fn a_palette_as_large_as_the_vectors_keeps_them_and_a_small_one_their_clusters() {
        let mut r = rng(2, "palette", 0);
        let vectors: Vec<f32> = (0..300).map(|_| r.random_range(-1.0..1.0)).collect();
        let (palette, labels) = of_vectors(&vectors, 3, 100);
        let kept = |i: usize| palette[usize::from(labels[i]) * 3..][..3] == vectors[i * 3..][..3];
        assert!((0..100).all(kept));
        let clustered: Vec<f32> = (0..100).flat_map(|i| [(i % 4) as f32, 0.0, (i % 2) as f32]).collect();
        let (palette, labels) = of_vectors(&clustered, 3, 64);
        assert_eq!(palette.len(), 4 * 3);
        assert!((0..100).all(|i| labels[i] == labels[i % 4]));
    }

    #[test]
    fn more_vectors_than_the_palette_holds_share_entries_with_their_likes() {
        let mut r = rng(3, "palette", 0);
        let (count, size) = (70_000, usize::from(u16::MAX) + 1);
        let vectors: Vec<f32> = (0..count * 3).map(|_| r.random_range(-1.0..1.0)).collect();
        let (palette, labels) = of_vectors(&vectors, 3, size);
        assert_eq!((palette.len(), labels.len()), (size * 3, count));
        let off = |i: usize| {
            let (a, b) = (&vectors[i * 3..][..3], &palette[usize::from(labels[i]) * 3..][..3]);
            a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
        };
        let exact = (0..count).filter(|i| off(*i) == 0.0).count();
        // The likest 4,464 pairs share an entry; among 70,000 in a cube of side 2 they are near.
        assert!(exact >= count - 4 * (count - size), "{exact}");
        assert!((0..count).map(off).fold(0.0, f32::max) < 0.1);
    }
}
