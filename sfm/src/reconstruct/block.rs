//! A part of the pairs of a large set of photos, to be matched by a job of its own.

use super::model::SfmModel;
use crate::config::SfmConfig;
use crate::error::SfmError;
use crate::matching::{PairMatches, PreparedSet, match_prepared_pairs};
use crate::pairs::{PairConfig, first_pairs};
use crate::sift;
use scene::{Camera, Features, FrameSet, Progress};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// One of several equal parts of all pairs, as `I/N` counts them: from 1/N to N/N.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PairBlock {
    /// Which part, from 1.
    number: usize,
    /// How many parts there are.
    count: usize,
}

impl FromStr for PairBlock {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match parts {
            Some((number, count)) if (1..=count).contains(&number) => Ok(Self { number, count }),
            _ => Err("expected I/N with I from 1 to N, for instance 2/8".to_owned()),
        }
    }
}

impl fmt::Display for PairBlock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.count)
    }
}

/// What a job finds: features of all photos, and matches of its pairs before verification.
#[derive(Clone, Debug)]
pub struct MatchedBlock {
    /// One set a frame.
    pub features: Vec<Features>,
    /// One a frame: intrinsics as they are assumed before a model is solved.
    pub initial_cameras: Vec<Camera>,
    /// Ascending by pair.
    pub matches: Vec<PairMatches>,
}

/// Detects features in all frames and matches the pairs of one block: of a small set every pair is
/// in one block, of a larger one every photo with the `pair_candidates` that look most alike. Jobs
/// cannot learn from each other's matches, so more candidates are tried than in a whole run.
pub fn match_block(
    frames: &FrameSet,
    config: &SfmConfig,
    block: PairBlock,
    progress: &Progress,
) -> Result<MatchedBlock, SfmError> {
    let initial_cameras = SfmModel::new(frames, config)?.setup.of_frames();
    let features = sift::extract_all(frames, &config.sift, progress)?;
    // `first_pairs` takes a quarter of the candidates, from which matches lead on.
    let pairs = PairConfig { pair_candidates: 4 * config.pairs.pair_candidates, ..config.pairs.clone() };
    let all = first_pairs(frames, &features, &pairs);
    let own: Vec<(usize, usize)> = all.into_iter().skip(block.number - 1).step_by(block.count).collect();
    let prepared = PreparedSet::new(&features);
    let matches = match_prepared_pairs(&prepared, &own, &config.matching, progress)?;
    Ok(MatchedBlock { features, initial_cameras, matches })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_counted_from_one_to_their_number() {
        assert_eq!("2/8".parse::<PairBlock>().unwrap().to_string(), "2/8");
        for odd in ["0/8", "9/8", "1/0", "a/b", "3", "-1/2", ""] {
            assert!(odd.parse::<PairBlock>().is_err(), "{odd}");
        }
    }
}
