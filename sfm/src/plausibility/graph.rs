//! How firmly the images of a model hang together: by the points that cross its weakest place.

use crate::incremental::state::MapState;
use crate::statistics::median;
use std::collections::BTreeMap;

/// Rounds of the power iteration.
/// Source: derived; the order of the images along the weakest mode is all that is asked, and it
/// settles long before the vector.
const ROUNDS: usize = 300;

/// Images after each of a point's that are tied to it: all of a long track would say no more.
/// Source: derived; the mean length of tracks is 3 to 8.
const NEIGHBOURS: usize = 8;

/// Fewest points that tie two parts of a model to each other.
/// Source: derived; three fix a similarity (Horn, JOSA A 4, 1987).
const FEWEST_TIES: usize = 3;
/// Least share of an image's points that ties two parts: a few wrong points cross any cut.
/// Source: docs/results/plausibility.csv; 0.003 across a cut film, 0.09 at least in right models.
const LEAST_TIE: f64 = 0.02;

/// Images in the order of the second eigenvector of their normalised graph, whose edges weigh
/// `weights[(a, b)]` (a < b): what a weak place separates lies apart in it (Fiedler 1973; Shi &
/// Malik, "Normalized Cuts", PAMI 2000).
fn spectral_order(images: usize, weights: &BTreeMap<(usize, usize), f64>) -> Vec<usize> {
    let mut degree = vec![0.0; images];
    for (&(a, b), w) in weights {
        degree[a] += w;
        degree[b] += w;
    }
    let root: Vec<f64> = degree.iter().map(|d| d.max(f64::MIN_POSITIVE).sqrt()).collect();
    let length = root.iter().map(|r| r * r).sum::<f64>().sqrt();
    // A start that no symmetry of a ring makes orthogonal to the mode.
    let mut x: Vec<f64> = (0..images).map(|i| (1.0 + 1.7 * i as f64).sin() * root[i]).collect();
    for _ in 0..ROUNDS {
        let along = x.iter().zip(&root).map(|(a, b)| a * b).sum::<f64>() / (length * length);
        x.iter_mut().zip(&root).for_each(|(x, r)| *x -= along * r);
        // (I + D^-1/2 W D^-1/2) / 2: all its eigenvalues are positive.
        let mut next: Vec<f64> = x.iter().map(|v| 0.5 * v).collect();
        for (&(a, b), w) in weights {
            let share = 0.5 * w / (root[a] * root[b]);
            next[a] += share * x[b];
            next[b] += share * x[a];
        }
        let size = next.iter().map(|v| v * v).sum::<f64>().sqrt();
        if !(size > 0.0) {
            break;
        }
        x = next.into_iter().map(|v| v / size).collect();
    }
    let place: Vec<f64> = x.iter().zip(&root).map(|(v, r)| v / r).collect();
    let mut order: Vec<usize> = (0..images).collect();
    order.sort_by(|&a, &b| place[a].total_cmp(&place[b]).then(a.cmp(&b)));
    order
}

/// The place at which the images of a model hang together by the fewest points.
pub(super) struct WeakestLink {
    /// Points that are seen from both sides.
    pub points: usize,
    /// These relative to the points that an image sees in the median.
    pub share: f64,
}

impl WeakestLink {
    /// Whether it can hold two parts of a model in place.
    pub(super) fn ties(&self) -> bool {
        self.points >= FEWEST_TIES && self.share >= LEAST_TIE
    }
}

/// [`weakest_link`] of the images that have a pose.
pub(super) fn weakest_link_of(state: &MapState) -> Option<WeakestLink> {
    let mut images = state.order.clone();
    images.sort_unstable();
    let mut number = vec![0usize; state.poses.len()];
    images.iter().enumerate().for_each(|(k, &image)| number[image] = k);
    let mut points: Vec<Vec<usize>> = Vec::new();
    for (_, point) in state.live() {
        points.push(point.views.iter().map(|v| number[v[0] as usize]).collect());
    }
    weakest_link(images.len(), &points)
}

/// The cut of the images across which the fewest points are seen. `points`: for each the images
/// that see it. Each side has at least a tenth of the images. None of fewer than four images.
fn weakest_link(images: usize, points: &[Vec<usize>]) -> Option<WeakestLink> {
    if images < 4 {
        return None;
    }
    let mut weights = BTreeMap::new();
    let mut seen = vec![0.0; images];
    for views in points {
        for (i, &a) in views.iter().enumerate() {
            seen[a] += 1.0;
            for &b in views[i + 1..].iter().take(NEIGHBOURS) {
                *weights.entry((a.min(b), a.max(b))).or_insert(0.0) += 1.0;
            }
        }
    }
    let order = spectral_order(images, &weights);
    let mut place = vec![0usize; images];
    order.iter().enumerate().for_each(|(k, &image)| place[image] = k);
    // A point crosses every cut between the first and the last of its images.
    let mut change = vec![0i64; images + 1];
    for views in points {
        let places = views.iter().map(|&image| place[image]);
        if let (Some(first), Some(last)) = (places.clone().min(), places.max()) {
            change[first] += 1;
            change[last] -= 1;
        }
    }
    let (mut crossing, mut least) = (0i64, i64::MAX);
    for (k, step) in change.iter().enumerate().take(images - 1) {
        crossing += step;
        let smaller = (k + 1).min(images - k - 1);
        if smaller >= images.div_ceil(10).max(2) {
            least = least.min(crossing);
        }
    }
    Some(WeakestLink { points: least as usize, share: least as f64 / median(seen).max(1.0) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_groups_that_share_few_points_hang_together_weakly() {
        let group = |from: usize| (0..100).map(move |_| (from..from + 10).collect::<Vec<usize>>());
        let apart: Vec<Vec<usize>> = group(0).chain(group(10)).chain([vec![3, 14]]).collect();
        let share = |points: &[Vec<usize>]| weakest_link(20, points).unwrap().share;
        assert!((share(&apart) - 0.01).abs() < 1e-9, "{}", share(&apart));
        let few: Vec<Vec<usize>> = apart.iter().cloned().chain([vec![4, 15], vec![5, 16]]).collect();
        assert!(!weakest_link(20, &apart).unwrap().ties() && weakest_link(20, &few).unwrap().ties());
        assert_eq!(weakest_link(20, &apart[..200]).unwrap().points, 0);
        let chain: Vec<Vec<usize>> = (0..1600).map(|k| (k % 16..k % 16 + 5).collect()).collect();
        assert!(share(&chain) > 0.3, "{}", share(&chain));
    }
}
