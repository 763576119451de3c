//! A second set of features, of blurred images, where the first leaves images loosely tied: in the
//! dark the finest structure is noise, and what is left of the object shows at larger scales only.

use super::ties::{find_weakly_tied, most_are_weak, strong_tie};
use crate::error::SfmError;
use crate::matching::{PairMatches, PreparedFeatures, match_prepared};
use crate::model_selection::accept::{Change, Support, accept};
use crate::reconstruct::context::StepContext;
use crate::reconstruct::model::{SfmModel, StepResult};
use crate::{pairs, sift, two_view};
use scene::decision::{Choice, Decision, Measurement, Quantity, Rule, Subject};
use scene::{Camera, Features, FrameSet, TwoViewGeometry};
use std::collections::BTreeMap;

/// Blur of the second set, standard deviation in pixels.
/// Source: docs/decisions/09.
const BLUR: f32 = 1.4;
/// Pairs of which it is tried first whether the blurred copies have matches enough.
/// Source: chosen by hand, never measured.
const PROBES: usize = 16;

/// Looks for matches of weakly tied images in blurred copies; both sets are kept where their
/// matches double, for where both find the same spots they are half as many again and nothing is
/// won. The first set's features keep their numbers.
pub(super) fn run(mut model: SfmModel, context: &StepContext<'_>) -> StepResult {
    let StepContext { config, progress, .. } = *context;
    let Some(frames) = context.images() else { return Ok((model, Vec::new())) };
    if !most_are_weak(&model.weakly_tied) || !promising(&model, frames, context)? {
        return Ok((model, Vec::new()));
    }
    let coarse = sift::extract_all(frames, &blurring(context), progress)?;
    let found = pairs::match_related(frames, &coarse, &config.pairs, &config.matching, progress)?;
    let found: Vec<PairMatches> = found.into_iter().filter(|m| is_weak(&model, m.0, m.1)).collect();
    let first: Vec<usize> = model.features.iter().map(Features::len).collect();
    let fine = model.matches.iter().flatten().filter(|m| is_weak(&model, m.0, m.1));
    let union = join_matches(fine, found, &first);
    let features: Vec<Features> = model.features.iter().zip(&coarse).map(|(a, b)| both(a, b)).collect();
    let cameras = model.setup.of_frames();
    let verified =
        two_view::verify_pairs(&features, &cameras, union.clone(), &config.two_view, config.seed, progress)?;
    let (weak, firm): (Vec<_>, Vec<_>) =
        std::mem::take(&mut model.geometries).into_iter().partition(|g| is_weak(&model, g.a, g.b));
    let (before, after) = (matches_of(&weak), matches_of(&verified));
    let taken = accept(Change::BlurredFeatures, &before, &after);
    model.geometries = firm.into_iter().chain(if taken { verified } else { weak }).collect();
    model.geometries.sort_by_key(|g| (g.a, g.b));
    if !taken {
        return Ok((model, Vec::new()));
    }
    let images = model.weakly_tied.iter().filter(|weak| **weak).count();
    let choice = Choice::share(images, features.len());
    let decision = Decision::new(Subject::BlurredFeatures, choice, Rule::Evidence)
        .measured(Quantity::Blur, f64::from(BLUR))
        .with_all([
            Measurement::count(Quantity::MatchesBefore, before.explained),
            Measurement::count(Quantity::MatchesAfter, after.explained),
        ]);
    (model.features, model.blurred_matches) = (features, Some(union));
    model.weakly_tied = find_weakly_tied(frames.len(), &model.geometries, strong_tie(&config.sift));
    Ok((model, vec![decision]))
}

/// Whether a pair has a weakly tied image.
fn is_weak(model: &SfmModel, a: usize, b: usize) -> bool {
    model.weakly_tied[a] || model.weakly_tied[b]
}

/// The matches of pairs.
fn matches_of<'a>(pairs: impl IntoIterator<Item = &'a TwoViewGeometry>) -> Support {
    Support::of(pairs.into_iter().map(|g| g.inliers.len()).sum())
}

fn blurring(context: &StepContext<'_>) -> sift::SiftConfig {
    let given = &context.config.sift;
    sift::SiftConfig { pre_blur: BLUR.hypot(given.pre_blur), ..given.clone() }
}

/// Whether the blurred copies of some pairs of weakly tied images have as many matches by
/// themselves as the first set has: together they would be about twice as many.
fn promising(model: &SfmModel, frames: &FrameSet, context: &StepContext<'_>) -> Result<bool, SfmError> {
    let StepContext { config, progress, .. } = *context;
    let tied: Vec<&TwoViewGeometry> = model.geometries.iter().filter(|g| is_weak(model, g.a, g.b)).collect();
    if frames.len() <= 3 * PROBES || tied.len() <= 2 * PROBES {
        return Ok(true);
    }
    let probes: Vec<&TwoViewGeometry> = tied.iter().step_by(tied.len().div_ceil(PROBES)).copied().collect();
    let mut images: Vec<usize> = probes.iter().flat_map(|g| [g.a, g.b]).collect();
    images.sort_unstable();
    images.dedup();
    let some = FrameSet {
        frames: images.iter().map(|&i| frames.frames[i].clone()).collect(),
        ..FrameSet::default()
    };
    let features = sift::extract_all(&some, &blurring(context), progress)?;
    let prepared: Vec<PreparedFeatures> = features.iter().map(PreparedFeatures::new).collect();
    let mut matches: Vec<PairMatches> = Vec::with_capacity(probes.len());
    for g in &probes {
        let [a, b] = [g.a, g.b].map(|image| images.partition_point(|&i| i < image));
        matches.push((a, b, match_prepared(&prepared[a], &prepared[b], &config.matching)));
    }
    let all = model.setup.of_frames();
    let cameras: Vec<Camera> = images.iter().map(|&i| all[i].clone()).collect();
    let found =
        two_view::verify_pairs(&features, &cameras, matches, &config.two_view, config.seed, progress)?;
    Ok(matches_of(&found).explained >= matches_of(probes).explained)
}

/// Matches of both sets by pair `(a, b)`, `a < b`; `first`: by image, the number of features of the
/// first set.
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
