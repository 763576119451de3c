//! Metrics of the held-out views, after the 8-bit round trip.

pub mod geometry;
pub mod speed;

use crate::stage::write_json;
use anyhow::{Context, Result};
use geometry::{Geometry, MeshConfig};
use image::{GrayImage, RgbImage};
use scene::lpips::{Backbone, Lpips};
use scene::{Progress, metrics};
use serde::{Deserialize, Serialize};
use speed::RenderingCost;
use splat::{Dataset, DatasetConfig, DeviceConfig, RenderOptions, Renderer, View};
use std::path::{Path, PathBuf};

/// How the held-out views are judged.
#[derive(clap::Args, Clone, Debug, Serialize, Deserialize)]
pub struct EvalConfig {
    /// Weights for LPIPS, a .safetensors file of AlexNet's or VGG-16's made by tools/lpips_weights.py; may be given for each
    #[arg(long, value_name = "FILE", help_heading = "Evaluation")]
    pub lpips_weights: Vec<PathBuf>,
    /// How often the held-out views are rendered to measure frames per second
    #[arg(long, default_value_t = 15, value_parser = clap::value_parser!(u32).range(1..=1000), help_heading = "Evaluation")]
    pub fps_loops: u32,
    /// The true shape.
    #[command(flatten)]
    #[serde(default)]
    pub mesh: MeshConfig,
}

/// Image quality of one view, or means over views.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
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

/// One held-out view.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ViewMetrics {
    /// Image name.
    pub name: String,
    /// File name of its pictures in `eval/photos` and `eval/renders`.
    pub picture: String,
    /// Its metrics.
    pub metrics: Metrics,
}

/// What `eval/metrics.json` holds.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Evaluation {
    /// How it was measured, in a sentence.
    pub protocol: String,
    /// By view.
    pub views: Vec<ViewMetrics>,
    /// Mean over the views.
    pub mean: Metrics,
    /// What rendered, in words.
    #[serde(default)]
    pub renderer: String,
    /// Speed and memory of rendering the held-out views.
    #[serde(default)]
    pub rendering: RenderingCost,
    /// Shape, where there is a mesh or a matte to judge it by.
    #[serde(default)]
    pub geometry: Option<Geometry>,
}

impl Evaluation {
    /// The figures in a few words.
    pub fn sentence(&self) -> String {
        if self.views.is_empty() {
            return "no held-out views".into();
        }
        let shape = self.geometry.as_ref().map_or(String::new(), |g| format!("; {}", g.sentence()));
        let worst = self.views.iter().map(|v| v.metrics.psnr).fold(f64::INFINITY, f64::min);
        format!(
            "PSNR {:.2} dB (worst view {worst:.2}), SSIM {:.4} on {} held-out views, {:.0} frames/s{shape}",
            self.mean.psnr,
            self.mean.ssim,
            self.views.len(),
            self.rendering.frames_per_second
        )
    }
}

/// The training set of a run: PINHOLE images, their masks if there are any, and the model.
pub fn load_dataset(training_set: &Path, config: &DatasetConfig, progress: &Progress) -> Result<Dataset> {
    let model = scene::io::read_model(&training_set.join("sparse/0"))?;
    let masks = training_set.join("masks");
    let masks = masks.is_dir().then_some(masks);
    Ok(Dataset::load(&training_set.join("images"), masks.as_deref(), &model, config, progress)?)
}

/// Renders the held-out views, compares them with the photos, writes `OUT/eval`.
pub fn evaluate(
    out: &Path,
    dataset: &DatasetConfig,
    config: &EvalConfig,
    device: &DeviceConfig,
    progress: &Progress,
) -> Result<Evaluation> {
    let networks: Vec<Lpips> =
        config.lpips_weights.iter().map(|path| Ok(Lpips::load(path)?)).collect::<Result<_>>()?;
    let gaussians = scene::io::ply::read_splat_ply(&out.join("splat.ply"))?;
    let (mut renderer, chosen) = Renderer::on(device, &gaussians)?;
    let cameras = speed::held_out_cameras(&out.join("undistorted"), dataset)?;
    let rendering = speed::measure(&mut renderer, &cameras, config.fps_loops, progress)?;
    let mesh = &config.mesh;
    let config = dataset;
    let dataset = load_dataset(&out.join("undistorted"), config, progress)?;
    let geometry = geometry::measure(out, mesh, &dataset, &gaussians, progress)?;
    let held_out: Vec<&View> = dataset.views.iter().filter(|v| v.held_out).collect();
    let protocol = protocol(config, &dataset, held_out.len(), &rendering, &networks);
    let mut evaluation =
        Evaluation { protocol, rendering, geometry, renderer: chosen.choice, ..Evaluation::default() };
    progress.begin("evaluate", held_out.len());
    scene::io::replace_folder(&out.join("eval"), |folder| -> Result<()> {
        for (i, view) in held_out.iter().enumerate() {
            let picture = format!("{i:03}_{}.png", plain(&view.name));
            let metrics = compare_view(&mut renderer, view, &dataset, &networks, folder, &picture)?;
            evaluation.views.push(ViewMetrics { name: view.name.clone(), picture, metrics });
            progress.tick_with(&format!("{:.2} dB", metrics.psnr))?;
        }
        evaluation.mean = mean(evaluation.views.iter().map(|v| &v.metrics));
        write_json(&folder.join("metrics.json"), &evaluation)
    })?;
    Ok(evaluation)
}

fn protocol(
    config: &DatasetConfig,
    dataset: &Dataset,
    views: usize,
    rendering: &RenderingCost,
    networks: &[Lpips],
) -> String {
    let lpips = if networks.is_empty() {
        "LPIPS not measured (no --lpips-weights given)".to_owned()
    } else {
        let names: Vec<&str> = networks.iter().map(|n| n.backbone.name()).collect();
        format!("LPIPS 0.1 ({}) at full resolution, no resize", names.join(", "))
    };
    let ground = if dataset.is_transparent() { ", both over black where the mask is black" } else { "" };
    format!(
        "{views} of {} views held out of training (every {}th by sorted name, beginning with the first); PSNR and SSIM \
         (11×11 Gaussian window, σ 1.5) of 8-bit renders against the undistorted photos at full resolution{ground}; {lpips}. \
         Frames per second: the held-out views rendered {} times after a warm-up, mean of the median five.",
        dataset.views.len(),
        config.test_every,
        rendering.loops
    )
}

fn plain(name: &str) -> String {
    let stem = Path::new(name).file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    stem.chars().map(|c| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect()
}

fn compare_view(
    renderer: &mut Renderer,
    view: &View,
    dataset: &Dataset,
    networks: &[Lpips],
    folder: &Path,
    picture: &str,
) -> Result<Metrics> {
    let output = renderer.render(&view.camera, &view.pose, &RenderOptions::default())?;
    let render = output.rgb.to_rgb8();
    let (photo, mask) = target(view, dataset.is_transparent())?;
    let mut metrics = Metrics {
        psnr: metrics::psnr(&render, &photo, None)?,
        ssim: metrics::ssim(&render, &photo, None)?,
        psnr_mask: mask.as_ref().and_then(|m| metrics::psnr(&render, &photo, Some(m)).ok()),
        ssim_mask: mask.as_ref().and_then(|m| metrics::ssim(&render, &photo, Some(m)).ok()),
        ..Metrics::default()
    };
    for network in networks {
        let full = Some(network.distance(&render, &photo, None)?);
        let inside = mask.as_ref().and_then(|m| network.distance(&render, &photo, Some(m)).ok());
        match network.backbone {
            Backbone::Alex => (metrics.lpips_alex, metrics.lpips_alex_mask) = (full, inside),
            Backbone::Vgg => (metrics.lpips_vgg, metrics.lpips_vgg_mask) = (full, inside),
        }
    }
    for (kind, image) in [("renders", &render), ("photos", &photo)] {
        std::fs::create_dir_all(folder.join(kind))?;
        let path = folder.join(kind).join(picture);
        image.save(&path).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(metrics)
}

/// The photo as it is compared, and its mask.
fn target(view: &View, transparent: bool) -> Result<(RgbImage, Option<GrayImage>)> {
    let pixels = view.levels.first().context("a view without pixels")?;
    let (w, h) = (pixels.width as u32, pixels.height as u32);
    let mask = pixels.mask.clone().and_then(|m| GrayImage::from_raw(w, h, m));
    let mut rgb = pixels.rgb.clone();
    if let (true, Some(mask)) = (transparent, &mask) {
        for (pixel, &m) in rgb.chunks_exact_mut(3).zip(mask.as_raw()) {
            pixel.iter_mut().for_each(|v| *v = ((u32::from(*v) * u32::from(m) + 127) / 255) as u8);
        }
    }
    Ok((RgbImage::from_raw(w, h, rgb).context("a view without pixels")?, mask))
}

fn mean<'a>(all: impl Iterator<Item = &'a Metrics> + Clone) -> Metrics {
    let average =
        |values: Vec<f64>| (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64);
    let optional = |pick: fn(&Metrics) -> Option<f64>| average(all.clone().filter_map(pick).collect());
    Metrics {
        psnr: optional(|m| Some(m.psnr)).unwrap_or(0.0),
        ssim: optional(|m| Some(m.ssim)).unwrap_or(0.0),
        psnr_mask: optional(|m| m.psnr_mask),
        ssim_mask: optional(|m| m.ssim_mask),
        lpips_alex: optional(|m| m.lpips_alex),
        lpips_vgg: optional(|m| m.lpips_vgg),
        lpips_alex_mask: optional(|m| m.lpips_alex_mask),
        lpips_vgg_mask: optional(|m| m.lpips_vgg_mask),
    }
}
