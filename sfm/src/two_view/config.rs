//! What a user can set about verification.

use scene::flag::between;
use serde::{Deserialize, Serialize};

/// How pairs are verified.
#[derive(clap::Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TwoViewConfig {
    /// Largest epipolar or transfer error of an inlier match, pixels.
    #[arg(long, value_parser = between::<f64>(0.01, 1e4), default_value_t = Self::default().max_error_px, help_heading = "Verification")]
    pub max_error_px: f64,
    /// Pairs with fewer inlier matches are dropped.
    #[arg(long, value_parser = between::<usize>(0, 1_000_000), default_value_t = Self::default().min_inliers, help_heading = "Verification")]
    pub min_inliers: usize,
    /// Pairs of which a smaller part of the matches agrees are not searched for to the end.
    #[arg(long, value_parser = between::<f64>(0.0, 1.0), default_value_t = Self::default().min_inlier_ratio, help_heading = "Verification")]
    pub min_inlier_ratio: f64,
    /// Probability of finding a model where there is one.
    #[arg(long, value_parser = between::<f64>(0.0, 1.0), default_value_t = Self::default().verify_confidence, help_heading = "Verification")]
    pub verify_confidence: f64,
    /// Most samples drawn for a model.
    #[arg(long, value_parser = between::<usize>(1, 1_000_000_000), default_value_t = Self::default().max_samples, help_heading = "Verification")]
    pub max_samples: usize,
    /// Matches that move by less than this between the images may be a watermark, pixels.
    #[arg(long, value_parser = between::<f64>(0.0, 1e4), default_value_t = Self::default().static_px, help_heading = "Verification")]
    pub static_px: f64,
    /// Pairs whose agreement random matches would reach more often than 10 to this power are
    /// dropped.
    #[arg(long, value_parser = between::<f64>(-1e6, 1e6), default_value_t = Self::default().max_log10_false_alarms, allow_hyphen_values = true, help_heading = "Verification")]
    pub max_log10_false_alarms: f64,
}

impl TwoViewConfig {
    /// The error that right matches are taken to have, pixels: the largest is four of it. Robust
    /// losses bend there, and partners along an epipolar line are sought so far from it.
    pub(crate) fn sigma_px(&self) -> f64 {
        self.max_error_px / 4.0
    }
}

impl Default for TwoViewConfig {
    fn default() -> Self {
        Self {
            max_error_px: 4.0,
            min_inliers: 15,
            min_inlier_ratio: 0.25,
            verify_confidence: 0.9999,
            max_samples: 3000,
            static_px: 1.5,
            max_log10_false_alarms: -2.0,
        }
    }
}
