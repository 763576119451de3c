//! How firmly images are tied by their matches, and what is said where they are not.

use scene::decision::{Choice, Decision, Measurement, Quantity, Rule, Subject};
use scene::{Features, TwoViewGeometry};

/// Other images that hold an image firmly, and the matches each must share with it. What is held by less gains by
/// matches along its epipolar lines; what is held by more loses, for those are less exact.
const TIES: usize = 2;
pub(crate) const STRONG_TIE: usize = 300;
/// The features an image may have, to which that number belongs (the default; undoubled images have about a quarter).
const FEATURES_OF_TIES: usize = 4096;

/// Share of the images that must be loosely tied for other ways to match them to be looked for.
const LOOSE_SHARE: f64 = 0.5;

/// [`STRONG_TIE`] where fewer features are asked for: fewer matches hold an image then as firmly as that allows.
pub(crate) fn strong_tie(sift: &crate::sift::SiftConfig) -> usize {
    let share = if sift.doubling == crate::sift::Doubling::Never { 4 } else { 1 };
    STRONG_TIE * sift.max_features.min(FEATURES_OF_TIES / share) / FEATURES_OF_TIES
}

/// Images that fewer than [`TIES`] others share `strong` matches with.
pub(crate) fn find_weakly_tied(images: usize, geometries: &[TwoViewGeometry], strong: usize) -> Vec<bool> {
    let mut ties = vec![0; images];
    for g in geometries.iter().filter(|g| g.inliers.len() >= strong) {
        ties[g.a] += 1;
        ties[g.b] += 1;
    }
    ties.into_iter().map(|n| n < TIES).collect()
}

/// Whether so many images are loosely tied that other ways to match them are looked for.
pub(crate) fn most_are_loose(loose: &[bool]) -> bool {
    loose.iter().filter(|l| **l).count() as f64 >= LOOSE_SHARE * loose.len() as f64
}

pub(crate) fn pairs_decision(pairs: usize, images: usize, geometries: &[TwoViewGeometry]) -> Decision {
    let all = images * images.saturating_sub(1) / 2;
    let inliers: usize = geometries.iter().map(|g| g.inliers.len()).sum();
    Decision::new(Subject::ImagePairs, Choice::share(geometries.len(), pairs), Rule::Evidence).with_all([
        Measurement::count(Quantity::PossiblePairs, all),
        Measurement::count(Quantity::Matches, inliers),
    ])
}

pub(crate) fn why_no_model(features: &[Features], geometries: &[TwoViewGeometry]) -> String {
    let most = features.iter().map(Features::len).max().unwrap_or(0);
    if most < 50 {
        return format!(
            "at most {most} features were found in an image: too dark, too blurred or without texture"
        );
    }
    if geometries.is_empty() {
        return "no two images show the same points: film more slowly, or from fewer sides".to_owned();
    }
    format!(
        "{} image pairs agree, but none has enough baseline to start from: move the camera sideways",
        geometries.len()
    )
}
