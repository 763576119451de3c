//! What the evaluation measured.

use scene::geometry::GeometryErrors;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One held-out view.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct ViewMetrics {
    /// Image name.
    pub name: String,
    /// File name of its pictures in `eval/photos` and `eval/renders`.
    pub picture: String,
    /// Its metrics.
    pub metrics: Metrics,
}

/// What a part of the held-out views stay below.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Percentile {
    /// How many of the views, per cent.
    pub percent: u32,
    /// Each figure by itself.
    pub metrics: Metrics,
}

/// Views that training saw, judged like the held-out ones: how much better they are is what was
/// learnt by heart.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct TrainingViews {
    /// How many were judged.
    pub views: usize,
    /// Their mean (without LPIPS).
    pub mean: Metrics,
}

/// What `eval/metrics.json` holds.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
pub struct Evaluation {
    /// How it was measured, in a sentence.
    pub protocol: String,
    /// By view.
    pub views: Vec<ViewMetrics>,
    /// Mean over the views.
    pub mean: Metrics,
    /// Percentiles over the views.
    #[serde(default)]
    pub percentiles: Vec<Percentile>,
    /// Views of the training, judged alike.
    #[serde(default)]
    pub training: Option<TrainingViews>,
    /// What rendered, in words.
    #[serde(default)]
    pub renderer: String,
    /// Speed and memory of rendering the held-out views.
    #[serde(default)]
    pub rendering: RenderingCost,
    /// Shape, where there is a mesh or a matte to judge it by.
    #[serde(default)]
    pub geometry: Option<ShapeEvaluation>,
}

/// Image quality of one view, or means over views.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize, JsonSchema)]
pub struct Metrics {
    /// Peak signal-to-noise ratio, dB, full frame.
    pub psnr: f64,
    /// Structural similarity, full frame.
    pub ssim: f64,
    /// PSNR over the pixels inside the mask.
    pub psnr_mask: Option<f64>,
    /// SSIM over the windows centred inside the mask.
    pub ssim_mask: Option<f64>,
    /// LPIPS with AlexNet, full frame; `None` without weights.
    #[serde(default)]
    pub lpips_alex: Option<f64>,
    /// LPIPS with VGG-16, full frame.
    #[serde(default)]
    pub lpips_vgg: Option<f64>,
    /// LPIPS with AlexNet inside the mask.
    #[serde(default)]
    pub lpips_alex_mask: Option<f64>,
    /// LPIPS with VGG-16 inside the mask.
    #[serde(default)]
    pub lpips_vgg_mask: Option<f64>,
}

/// What rendering costs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RenderingCost {
    /// Frames a second: mean of the median five loops over the test set.
    pub frames_per_second: f64,
    /// Milliseconds a frame, median over all frames of all loops.
    pub frame_ms_median: f64,
    /// Milliseconds a frame that 95 % of them stay below.
    pub frame_ms_p95: f64,
    /// Milliseconds a frame that 99 % of them stay below.
    pub frame_ms_p99: f64,
    /// How often the test set was rendered.
    pub loops: usize,
    /// Peak resident memory with nothing but the splat loaded, MiB (0 where the system does not
    /// tell).
    pub peak_mib: f64,
}

/// How the shape was judged, and what came of it.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
pub struct ShapeEvaluation {
    /// How it was measured.
    pub protocol: String,
    /// The sparse cloud against the mesh.
    pub cloud: Option<GeometryErrors>,
    /// The surface at which the splat is half opaque, from the input views, against the mesh.
    pub surface: Option<GeometryErrors>,
    /// The cloud that `export --dense` writes, against the mesh.
    #[serde(default)]
    pub dense: Option<GeometryErrors>,
    /// The mesh that `export --mesh` writes, against the mesh.
    #[serde(default)]
    pub fused: Option<GeometryErrors>,
    /// Share of the splat's opacity outside the visual hull of the mattes, per cent.
    pub floaters_pct: Option<f64>,
}
