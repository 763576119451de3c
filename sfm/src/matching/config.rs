//! What the user can set about matching.

use scene::flag::between;
use serde::{Deserialize, Serialize};

/// Settings of descriptor matching.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize, Deserialize)]
#[serde(default)]
pub struct MatchConfig {
    /// A match must be closer than this share of the distance of the second-best (Lowe 2004,
    /// section 7.1).
    #[arg(long, value_parser = between::<f32>(0.0, 1.0), default_value_t = Self::default().match_ratio, help_heading = "Matching")]
    pub match_ratio: f32,
    /// Largest distance of matched descriptors (unit vectors: 0 is equal, 1.41 unrelated).
    #[arg(long, value_parser = between::<f32>(0.0, 2.0), default_value_t = Self::default().match_max_distance, help_heading = "Matching")]
    pub match_max_distance: f32,
    /// The same ratio along known epipolar lines, where fewer rivals remain.
    #[arg(long, value_parser = between::<f32>(0.0, 1.0), default_value_t = Self::default().guided_ratio, help_heading = "Matching")]
    pub guided_ratio: f32,
    /// Keeps matches that are the best from one side only.
    #[arg(long, default_value_t = Self::default().one_way_matches, help_heading = "Matching")]
    pub one_way_matches: bool,
}

impl Default for MatchConfig {
    fn default() -> Self {
        Self { match_ratio: 0.8, match_max_distance: 0.5, guided_ratio: 0.8, one_way_matches: false }
    }
}
