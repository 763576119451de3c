//! One training, measured.

use serde::{Deserialize, Serialize};

/// One training, measured: ours or another tool's.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Point {
    /// The tool.
    pub method: String,
    /// What it was told.
    pub setting: String,
    /// Wall time of training (images loaded, splat written), s.
    #[serde(default)]
    pub wall_s: Option<f64>,
    /// CPU time of training, user and system, s.
    #[serde(default)]
    pub cpu_s: Option<f64>,
    /// Gaussians at the end.
    #[serde(default)]
    pub gaussians: Option<usize>,
    /// Size of the splat as `.sog`, bytes.
    #[serde(default)]
    pub sog_bytes: Option<u64>,
    /// Size of the splat as `.spz`, bytes; not where the format cannot hold the scene's scale.
    #[serde(default)]
    pub spz_bytes: Option<u64>,
    /// Peak resident memory of training, MiB.
    #[serde(default)]
    pub peak_mib: Option<f64>,
    /// Mean over the held-out views, dB.
    pub psnr: f64,
    /// The worst held-out view, dB.
    #[serde(default)]
    pub psnr_worst: Option<f64>,
    /// Mean over the held-out views.
    #[serde(default)]
    pub ssim: Option<f64>,
    /// Mean over the held-out views (AlexNet, or VGG-16 where only that was given).
    #[serde(default)]
    pub lpips: Option<f64>,
}
