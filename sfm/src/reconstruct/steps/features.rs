//! A second set of features, of blurred images, where the first leaves images loosely tied: in the dark the finest
//! structure is noise, and what is left of the object shows at larger scales only.

use super::matching::most_are_loose;
use crate::matching::{PairMatches, PreparedFeatures, match_prepared};
use crate::reconstruct::ReconstructionRequest;
use crate::{SfmError, pairs, sift, two_view};
use scene::decision::{Choice, Decision, Measurement, Quantity, Rule, Subject};
use scene::{Features, FrameSet, TwoViewGeometry};
use std::collections::BTreeMap;

/// Blur of the second set, pixels.
const BLUR: f32 = 1.4;
/// Factor by which the matches of loosely tied pairs must grow for it to be kept: where both sets find the same spots they
/// are half as many again, and nothing is won.
const WORTH: f64 = 2.0;

/// Pairs that are tried before all are, and the number of images beyond which they are.
const PROBES: usize = 16;
const PROBE_BEYOND: usize = 48;

/// Features of both sets (the first set's keep their numbers), and the pairs verified with both.
pub(crate) struct BlurredFeatures {
    pub features: Vec<Features>,
    pub geometries: Vec<TwoViewGeometry>,
    /// Matches of the loosely tied pairs before verification.
    pub matches: Vec<PairMatches>,
    pub decision: Decision,
}

/// Looks for matches of the images that `loose` marks in blurred copies. `matches`: those of the first set before
/// verification. `None` where that yields no more.
pub(crate) fn enrich(
    features: &[Features],
    matches: &[PairMatches],
    geometries: &[TwoViewGeometry],
    loose: &[bool],
    job: &ReconstructionRequest<'_>,
) -> Result<Option<BlurredFeatures>, SfmError> {
    let ReconstructionRequest { frames, config, setup, progress, .. } = *job;
    if !most_are_loose(loose) || !promising(geometries, loose, job)? {
        return Ok(None);
    }
    let coarse = sift::extract_all(frames, &blurring(job), progress)?;
    let of_loose = |a: usize, b: usize| loose[a] || loose[b];
    let found = pairs::match_related(frames, &coarse, &config.pairs, &config.matching, progress)?;
    let found: Vec<PairMatches> = found.into_iter().filter(|m| of_loose(m.0, m.1)).collect();
    let first: Vec<usize> = features.iter().map(Features::len).collect();
    let union = join_matches(matches.iter().filter(|m| of_loose(m.0, m.1)), found, &first);
    let features: Vec<Features> = features.iter().zip(&coarse).map(|(a, b)| both(a, b)).collect();
    let cameras = setup.of_frames();
    let verified =
        two_view::verify_pairs(&features, &cameras, union.clone(), &config.two_view, config.seed, progress)?;
    let count = |all: &[TwoViewGeometry]| -> usize {
        all.iter().filter(|g| of_loose(g.a, g.b)).map(|g| g.inliers.len()).sum()
    };
    let (before, after) = (count(geometries), count(&verified));
    if (after as f64) < WORTH * before as f64 {
        return Ok(None);
    }
    let mut all: Vec<TwoViewGeometry> =
        geometries.iter().filter(|g| !of_loose(g.a, g.b)).cloned().chain(verified).collect();
    all.sort_by_key(|g| (g.a, g.b));
    let enriched = loose.iter().filter(|l| **l).count();
    let decision =
        Decision::new(Subject::BlurredFeatures, Choice::share(enriched, loose.len()), Rule::Evidence)
            .measured(Quantity::Blur, f64::from(BLUR))
            .with_all([
                Measurement::count(Quantity::MatchesBefore, before),
                Measurement::count(Quantity::MatchesAfter, after),
            ]);
    Ok(Some(BlurredFeatures { features, geometries: all, matches: union, decision }))
}

fn blurring(job: &ReconstructionRequest<'_>) -> sift::SiftConfig {
    let given = &job.config.sift;
    sift::SiftConfig { pre_blur: BLUR.hypot(given.pre_blur), ..given.clone() }
}

/// Whether the blurred copies alone, of some loosely tied pairs, have as many matches as would be worth it: those of both
/// sets together are no fewer.
fn promising(
    geometries: &[TwoViewGeometry],
    loose: &[bool],
    job: &ReconstructionRequest<'_>,
) -> Result<bool, SfmError> {
    let ReconstructionRequest { frames, config, setup, progress, .. } = *job;
    let tied: Vec<&TwoViewGeometry> = geometries.iter().filter(|g| loose[g.a] || loose[g.b]).collect();
    if loose.len() <= PROBE_BEYOND || tied.len() <= 2 * PROBES {
        return Ok(true);
    }
    let probes: Vec<&TwoViewGeometry> = tied.iter().step_by(tied.len().div_ceil(PROBES)).copied().collect();
    let mut images: Vec<usize> = probes.iter().flat_map(|g| [g.a, g.b]).collect();
    images.sort_unstable();
    images.dedup();
    let place = |image: usize| images.partition_point(|&i| i < image);
    let some = FrameSet {
        frames: images.iter().map(|&i| frames.frames[i].clone()).collect(),
        ..FrameSet::default()
    };
    let features = sift::extract_all(&some, &blurring(job), progress)?;
    let prepared: Vec<PreparedFeatures> = features.iter().map(PreparedFeatures::new).collect();
    let matched = |g: &&TwoViewGeometry| {
        let (a, b) = (place(g.a), place(g.b));
        (a, b, match_prepared(&prepared[a], &prepared[b], &config.matching))
    };
    let matches = probes.iter().map(matched).collect();
    let all = setup.of_frames();
    let cameras: Vec<_> = images.iter().map(|&i| all[i].clone()).collect();
    let found =
        two_view::verify_pairs(&features, &cameras, matches, &config.two_view, config.seed, progress)?;
    let after: usize = found.iter().map(|g| g.inliers.len()).sum();
    let before: usize = probes.iter().map(|g| g.inliers.len()).sum();
    Ok(after as f64 >= (WORTH - 1.0) * before as f64)
}

/// Matches of both sets by pair `(a, b)`, `a < b`; `first`: by image, the number of features of the first set.
fn join_matches<'a>(
    fine: impl Iterator<Item = &'a PairMatches>,
    coarse: Vec<PairMatches>,
    first: &[usize],
) -> Vec<PairMatches> {
    let mut by_pair: BTreeMap<(usize, usize), Vec<[u32; 2]>> = BTreeMap::new();
    for (a, b, pairs) in fine {
        let turned = pairs.iter().map(|&[i, k]| if a < b { [i, k] } else { [k, i] });
        by_pair.entry((*a.min(b), *a.max(b))).or_default().extend(turned);
    }
    for (a, b, pairs) in coarse {
        let [from, to] = [a, b].map(|image| first[image] as u32);
        let moved = pairs.iter().map(|&[i, k]| if a < b { [i + from, k + to] } else { [k + to, i + from] });
        by_pair.entry((a.min(b), a.max(b))).or_default().extend(moved);
    }
    by_pair.into_iter().map(|((a, b), pairs)| (a, b, pairs)).collect()
}

fn both(a: &Features, b: &Features) -> Features {
    Features {
        keypoints: a.keypoints.iter().chain(&b.keypoints).copied().collect(),
        descriptors: a.descriptors.iter().chain(&b.descriptors).copied().collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matches_of_both_sets_are_joined_whatever_way_round_their_pairs_are() {
        let fine = [(0, 1, vec![[3, 4]]), (2, 1, vec![[7, 8]])];
        let coarse = vec![(1, 0, vec![[0, 1]]), (1, 2, vec![[5, 6]])];
        let all = join_matches(fine.iter(), coarse, &[10, 20, 30]);
        assert_eq!(all, vec![(0, 1, vec![[3, 4], [11, 20]]), (1, 2, vec![[8, 7], [25, 36]])]);
    }
}
