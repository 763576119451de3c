//! How firmly images are tied by their matches, and what is said where they are not.

use crate::reconstruct::model::SfmModel;
use crate::sift::{Doubling, SiftConfig};
use scene::TwoViewGeometry;
use scene::decision::{Choice, Decision, Measurement, Quantity, Rule, Subject};

/// Other images that hold an image firmly. What is held by fewer gains by matches along its
/// epipolar lines; what is held by more loses, for those are less exact.
/// Source: chosen by hand, never measured.
const TIES: usize = 2;
/// Matches that each of them must share with it, of the default number of features.
/// Source: chosen by hand, never measured.
pub(super) const STRONG_TIE: usize = 300;

/// [`STRONG_TIE`] where fewer features are asked for: fewer matches hold an image then as firmly as
/// that allows. Images that are not doubled have about a quarter of the features.
pub(super) fn strong_tie(sift: &SiftConfig) -> usize {
    let share = if sift.doubling == Doubling::Never { 4 } else { 1 };
    let usual = SiftConfig::default().max_features;
    STRONG_TIE * sift.max_features.min(usual / share) / usual
}

/// Images that fewer than [`TIES`] others share `strong` matches with.
pub(super) fn find_weakly_tied(images: usize, geometries: &[TwoViewGeometry], strong: usize) -> Vec<bool> {
    let mut ties = vec![0; images];
    for g in geometries.iter().filter(|g| g.inliers.len() >= strong) {
        ties[g.a] += 1;
        ties[g.b] += 1;
    }
    ties.into_iter().map(|n| n < TIES).collect()
}

/// Whether half of the images are weakly tied, so that other ways to match them are looked for
/// (docs/decisions/09).
pub(super) fn most_are_weak(weakly_tied: &[bool]) -> bool {
    2 * weakly_tied.iter().filter(|weak| **weak).count() >= weakly_tied.len()
}

/// How many pairs were verified.
pub(super) fn pairs_decision(model: &SfmModel) -> Decision {
    let (images, matched) = (model.features.len(), model.stats.pairs_matched);
    let all = images * images.saturating_sub(1) / 2;
    let inliers: usize = model.geometries.iter().map(|g| g.inliers.len()).sum();
    let choice = Choice::share(model.geometries.len(), matched);
    Decision::new(Subject::ImagePairs, choice, Rule::Evidence).with_all([
        Measurement::count(Quantity::PossiblePairs, all),
        Measurement::count(Quantity::Matches, inliers),
    ])
}
