//! Which pairs of images are matched at all.

use scene::{Features, FrameSet};
use serde::{Deserialize, Serialize};

/// Settings of the choice of pairs.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize, Deserialize)]
#[serde(default)]
pub struct PairConfig {
    /// Up to so many images every pair is matched.
    #[arg(long, default_value_t = Self::default().exhaustive_up_to, help_heading = "Matching")]
    pub exhaustive_up_to: usize,
}

impl Default for PairConfig {
    fn default() -> Self {
        Self { exhaustive_up_to: 200 }
    }
}

/// Pairs `(a, b)`, `a < b`, in ascending order. The order of files is never trusted to be the order of a ring.
pub fn choose_pairs(frames: &FrameSet, features: &[Features], _config: &PairConfig) -> Vec<(usize, usize)> {
    let n = frames.len().min(features.len());
    (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b))).collect()
}
