//! Matching round by round: the pairs that look promising, then those that matches lead to.

use super::{PairConfig, first_pairs};
use crate::error::SfmError;
use crate::matching::{MatchConfig, PairMatches, PreparedSet, match_prepared_pairs};
use scene::{Features, FrameSet, Progress};
use std::collections::{BTreeMap, BTreeSet};

/// Matches that make a pair a likely one.
/// Source: measured: halved and doubled with all of `pairs`, temple_ring (47 photos) keeps its
/// bytes.
const LIKELY: usize = 30;
/// Share of the smaller image's features that they must be.
/// Source: measured: halved and doubled with all of `pairs`, temple_ring (47 photos) keeps its
/// bytes.
const LIKELY_SHARE: f64 = 0.015;
/// Pairs that an image adds in a round.
/// Source: measured: halved and doubled with all of `pairs`, temple_ring (47 photos) keeps its
/// bytes.
const A_ROUND: usize = 6;

/// Matches of all pairs of a small set, and of those of a large one that may show the same points;
/// ascending by pair. The same for any number of threads.
pub(crate) fn match_related(
    frames: &FrameSet,
    features: &[Features],
    pairs: &PairConfig,
    matching: &MatchConfig,
    progress: &Progress,
) -> Result<Vec<PairMatches>, SfmError> {
    let prepared = PreparedSet::new(features);
    let n = frames.len().min(features.len());
    let mut batch = first_pairs(frames, features, pairs);
    let mut found = match_prepared_pairs(&prepared, &batch, matching, progress)?;
    if pairs.exhaustive(n, frames.is_video) {
        return Ok(found);
    }
    let mut graph = Graph::new(features, pairs.pair_candidates);
    let mut seen = 0;
    loop {
        graph.tried.extend(batch);
        found[seen..].iter().for_each(|(a, b, matches)| graph.add(*a, *b, matches.len()));
        seen = found.len();
        batch = graph.led_to();
        if batch.is_empty() {
            batch = graph.of_the_lonely();
            if batch.is_empty() {
                break;
            }
        }
        found.extend(match_prepared_pairs(&prepared, &batch, matching, progress)?);
    }
    found.sort_unstable_by_key(|(a, b, _)| (*a, *b));
    Ok(found)
}

/// What has been tried and what came of it.
struct Graph {
    tried: BTreeSet<(usize, usize)>,
    /// For each image its likely partners.
    partners: Vec<BTreeSet<usize>>,
    features: Vec<usize>,
    enough: usize,
    lonely_tried: bool,
}

impl Graph {
    fn new(features: &[Features], enough: usize) -> Self {
        Self {
            tried: BTreeSet::new(),
            partners: vec![BTreeSet::new(); features.len()],
            features: features.iter().map(Features::len).collect(),
            enough,
            lonely_tried: false,
        }
    }

    fn add(&mut self, a: usize, b: usize, matches: usize) {
        let fewer = self.features[a].min(self.features[b]) as f64;
        if matches >= LIKELY.max((LIKELY_SHARE * fewer) as usize) {
            self.partners[a].insert(b);
            self.partners[b].insert(a);
        }
    }

    /// Untried pairs with common partners, those with most of them first, [`A_ROUND`] an image that
    /// has not got enough.
    fn led_to(&self) -> Vec<(usize, usize)> {
        let mut next = BTreeSet::new();
        for (a, of_a) in self.partners.iter().enumerate() {
            if of_a.len() >= self.enough {
                continue;
            }
            let mut common: BTreeMap<usize, usize> = BTreeMap::new();
            for c in of_a.iter().flat_map(|&b| &self.partners[b]).filter(|&&c| c != a) {
                if !self.tried.contains(&(a.min(*c), a.max(*c))) {
                    *common.entry(*c).or_default() += 1;
                }
            }
            let mut ranked: Vec<(usize, usize)> = common.into_iter().map(|(c, n)| (n, c)).collect();
            ranked.sort_by_key(|&(n, c)| (std::cmp::Reverse(n), c));
            next.extend(ranked.into_iter().take(A_ROUND).map(|(_, c)| (a.min(c), a.max(c))));
        }
        next.into_iter().collect()
    }

    /// Once: all untried pairs of images that have found one partner or none, as long as they are
    /// few: two hold an image in a chain.
    fn of_the_lonely(&mut self) -> Vec<(usize, usize)> {
        if std::mem::replace(&mut self.lonely_tried, true) {
            return Vec::new();
        }
        let n = self.partners.len();
        let lonely = (0..n).filter(|&i| self.features[i] > 0 && self.partners[i].len() < 2);
        let all = lonely.take(self.enough).flat_map(|a| (0..n).map(move |b| (a.min(b), a.max(b))));
        let untried: BTreeSet<(usize, usize)> =
            all.filter(|p| p.0 != p.1 && !self.tried.contains(p)).collect();
        untried.into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Images in a row, each of which matches those up to `reach` away.
    fn explore(n: usize, reach: usize, enough: usize) -> Graph {
        let features =
            vec![Features { keypoints: vec![scene::Keypoint::default(); 1000], descriptors: Vec::new() }; n];
        let mut graph = Graph::new(&features, enough);
        let mut batch: Vec<(usize, usize)> = (0..n - 1).map(|a| (a, a + 1)).collect();
        while !batch.is_empty() {
            graph.tried.extend(batch.iter().copied());
            let truth = |&(a, b): &(usize, usize)| if b - a <= reach { 100 } else { 3 };
            batch.iter().for_each(|p| graph.add(p.0, p.1, truth(p)));
            batch = graph.led_to();
        }
        graph
    }

    #[test]
    fn matches_lead_from_neighbours_to_all_that_can_match_and_not_much_farther() {
        let graph = explore(60, 6, 100);
        for a in 0..60_usize {
            let all: BTreeSet<usize> = (a.saturating_sub(6)..=(a + 6).min(59)).filter(|&b| b != a).collect();
            assert_eq!(graph.partners[a], all, "image {a}");
        }
        assert!(graph.tried.len() <= 60 * 12, "{} pairs tried", graph.tried.len());
    }

    #[test]
    fn the_search_ends_when_an_image_has_partners_enough() {
        let graph = explore(200, 60, 20);
        assert!(graph.partners.iter().all(|p| p.len() >= 20));
        assert!(graph.tried.len() <= 200 * 20, "{} pairs tried", graph.tried.len());
    }

    #[test]
    fn an_image_that_has_found_nobody_is_matched_with_every_other_one_once() {
        let mut graph = explore(10, 3, 100);
        graph.partners.push(BTreeSet::new());
        graph.features.push(500);
        assert_eq!(graph.of_the_lonely(), (0..10).map(|i| (i, 10)).collect::<Vec<_>>());
        assert!(graph.of_the_lonely().is_empty());
    }
}
