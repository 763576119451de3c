//! What the user can set about features.

use scene::flag::between;
use serde::{Deserialize, Serialize};

/// Whether the scale space begins with a doubled image (Lowe 2004, section 3.3: about four times
/// the keypoints).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Doubling {
    /// Doubled up to the size of --doubling-limit-mp.
    #[default]
    Auto,
    /// Always doubled (first octave −1).
    Always,
    /// Never doubled (first octave 0): about a quarter of the cost.
    Never,
}

/// Settings of the detector and of the descriptor.
#[derive(Clone, Debug, PartialEq, clap::Args, Serialize, Deserialize)]
#[serde(default)]
pub struct SiftConfig {
    /// Most features an image keeps; the strongest of every part of the image stay.
    #[arg(long, value_parser = between::<usize>(1, 1 << 20), default_value_t = Self::default().max_features, help_heading = "Features")]
    pub max_features: usize,
    /// Whether small details are searched in a doubled image.
    #[arg(long, value_enum, default_value_t = Self::default().doubling, help_heading = "Features")]
    pub doubling: Doubling,
    /// Largest image that `auto` doubles, megapixels.
    #[arg(long, value_parser = between::<f64>(0.0, 1e6), default_value_t = Self::default().doubling_limit_mp, help_heading = "Features")]
    pub doubling_limit_mp: f64,
    /// Longer sides are reduced to this before features are searched, pixels (positions stay in
    /// input pixels).
    #[arg(long, value_parser = between::<usize>(16, 65_535), default_value_t = Self::default().max_feature_size, help_heading = "Features")]
    pub max_feature_size: usize,
    /// Most octaves; fewer where the image is small.
    #[arg(long, value_parser = between::<usize>(1, 16), default_value_t = Self::default().octaves, help_heading = "Features")]
    pub octaves: usize,
    /// Scales an octave that are searched for extrema (Lowe: 3).
    #[arg(long, value_parser = between::<usize>(1, 16), default_value_t = Self::default().scales_per_octave, help_heading = "Features")]
    pub scales_per_octave: usize,
    /// Smallest difference-of-Gaussians response, as a share of the image's own range of
    /// brightness.
    #[arg(long, value_parser = between::<f32>(0.0, 1.0), default_value_t = Self::default().contrast_threshold, help_heading = "Features")]
    pub contrast_threshold: f32,
    /// Smallest response in standard deviations of what the image's own noise makes at that scale.
    #[arg(long, value_parser = between::<f32>(0.0, 1e6), default_value_t = Self::default().noise_threshold, help_heading = "Features")]
    pub noise_threshold: f32,
    /// Largest ratio of principal curvatures (Lowe 2004, section 4.1).
    #[arg(long, value_parser = between::<f32>(1.0, 1e6), default_value_t = Self::default().edge_threshold, help_heading = "Features")]
    pub edge_threshold: f32,
    /// Most orientations a keypoint gets.
    #[arg(long, value_parser = between::<usize>(1, 36), default_value_t = Self::default().max_orientations, help_heading = "Features")]
    pub max_orientations: usize,
    /// Blurs images before features are searched, pixels: what is lost in noise at full sharpness
    /// may match then.
    #[arg(long, value_parser = between::<f32>(0.0, 100.0), default_value_t = Self::default().pre_blur, help_heading = "Features")]
    pub pre_blur: f32,
    /// Leaves every feature upright (for cameras that do not roll).
    #[arg(long, default_value_t = Self::default().upright, help_heading = "Features")]
    pub upright: bool,
}

impl Default for SiftConfig {
    fn default() -> Self {
        Self {
            max_features: 4096,
            doubling: Doubling::Auto,
            doubling_limit_mp: 3.0,
            max_feature_size: 3200,
            octaves: 6,
            scales_per_octave: 3,
            contrast_threshold: 0.005,
            noise_threshold: 4.0,
            edge_threshold: 10.0,
            max_orientations: 2,
            pre_blur: 0.0,
            upright: false,
        }
    }
}

impl SiftConfig {
    /// Whether an image of that size is doubled.
    pub fn doubles(&self, width: usize, height: usize) -> bool {
        match self.doubling {
            Doubling::Always => true,
            Doubling::Never => false,
            Doubling::Auto => (width * height) as f64 <= self.doubling_limit_mp * 1e6,
        }
    }
}
