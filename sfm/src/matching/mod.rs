//! Matching of descriptors: exhaustive or along known epipolar lines, with the ratio test and the
//! mutual test (Lowe 2004, section 7.1).
//!
//! No pair is skipped after a look at its coarsest features: on `temple_ring` the 300 largest of
//! each image, asked for five matches, would spare half of the unrelated pairs, but lose one in
//! eight of those with 30 to 60 matches, which hold wide steps together.
//!
//! ```
//! use scene::{Features, Keypoint};
//! use sfm::matching::{MatchConfig, PreparedFeatures, match_prepared};
//!
//! let mut descriptors = vec![0; 2 * Features::DIM];
//! // Two unrelated descriptors of the usual length, 512.
//! descriptors[..16].fill(128);
//! descriptors[Features::DIM + 16..Features::DIM + 32].fill(128);
//! let features = Features { keypoints: vec![Keypoint::default(); 2], descriptors };
//! let prepared = PreparedFeatures::new(&features);
//! assert_eq!(match_prepared(&prepared, &prepared, &MatchConfig::default()), [[0, 0], [1, 1]]);
//! ```

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod config;
mod guided;
mod kernel;
#[cfg(target_arch = "aarch64")]
mod neon;
mod prepared;
mod set;
#[cfg(test)]
mod tests;
mod top_two;

pub use config::MatchConfig;
pub(crate) use guided::guided_match_prepared;
pub use prepared::PreparedFeatures;
pub(crate) use set::PreparedSet;

use crate::error::SfmError;
use prepared::{dot_at_distance, squared_distance};
use rayon::prelude::*;
use scene::{Features, Progress};
use top_two::{TopTwo, remove_bias};

#[cfg(test)]
pub(crate) fn match_features(a: &Features, b: &Features, config: &MatchConfig) -> Vec<[u32; 2]> {
    match_prepared(&PreparedFeatures::new(a), &PreparedFeatures::new(b), config)
}

/// Matches (feature of a, feature of b), sorted by the feature of a.
pub fn match_prepared(a: &PreparedFeatures, b: &PreparedFeatures, config: &MatchConfig) -> Vec<[u32; 2]> {
    if a.is_empty() || b.is_empty() || config.match_ratio <= 0.0 {
        return Vec::new();
    }
    // A second-best farther away than this rejects nobody, so it need not be known.
    let floor = dot_at_distance(config.match_max_distance / config.match_ratio.min(1.0));
    let (rows, columns) = kernel::top_two(a, b, floor);
    let ratio2 = config.match_ratio * config.match_ratio;
    let max2 = config.match_max_distance * config.match_max_distance;
    let mut matches = Vec::new();
    for i in 0..a.len() {
        let Some(j) = rows.partner(i).filter(|_| is_distinct(&rows, i, ratio2, max2)) else { continue };
        let mutual =
            columns.partner(j as usize) == Some(i as u32) && is_distinct(&columns, j as usize, ratio2, max2);
        if mutual || config.one_way_matches {
            matches.push([i as u32, j]);
        }
    }
    matches
}

/// Whether the best partner of descriptor `i` is near, and much nearer than the second-best; both
/// limits squared.
fn is_distinct(side: &TopTwo, i: usize, ratio2: f32, max2: f32) -> bool {
    let (best, second) = (remove_bias(side.best[i]), remove_bias(side.second[i]));
    let d2 = squared_distance(best);
    d2 <= max2 && d2 < ratio2 * squared_distance(second)
}

/// The matches of one pair of images: `(a, b, matches)`.
pub type PairMatches = (usize, usize, Vec<[u32; 2]>);

/// Matches of every pair, in the order of `pairs`; pairs that name a missing image have none. The
/// same for any number of threads.
pub fn match_pairs(
    features: &[Features],
    pairs: &[(usize, usize)],
    config: &MatchConfig,
    progress: &Progress,
) -> Result<Vec<PairMatches>, SfmError> {
    match_prepared_pairs(&PreparedSet::new(features), pairs, config, progress)
}

/// [`match_pairs`] of descriptors that are prepared already.
pub(crate) fn match_prepared_pairs(
    prepared: &PreparedSet,
    pairs: &[(usize, usize)],
    config: &MatchConfig,
    progress: &Progress,
) -> Result<Vec<PairMatches>, SfmError> {
    progress.begin("matching", pairs.len());
    let found = pairs.par_iter().map(|&(a, b)| {
        progress.check()?;
        let matches = match (prepared.get(a), prepared.get(b)) {
            (Some(left), Some(right)) => match_prepared(&left, &right, config),
            _ => Vec::new(),
        };
        progress.tick()?;
        Ok((a, b, matches))
    });
    found.collect()
}
