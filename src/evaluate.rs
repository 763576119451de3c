//! Metrics of the held-out views, after the 8-bit round trip.

use crate::stage::write_json;
use anyhow::{Context, Result};
use image::{GrayImage, RgbImage};
use scene::{Progress, metrics};
use serde::{Deserialize, Serialize};
use splat::{Dataset, DatasetConfig, DeviceConfig, RenderOptions, Renderer, View};
use std::path::Path;
use std::time::Instant;

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
    /// Median frames a second over the held-out views, each rendered after a warm-up.
    pub frames_per_second: f64,
}

impl Evaluation {
    /// The figures in a few words.
    pub fn sentence(&self) -> String {
        if self.views.is_empty() {
            return "no held-out views".into();
        }
        let worst = self.views.iter().map(|v| v.metrics.psnr).fold(f64::INFINITY, f64::min);
        format!(
            "PSNR {:.2} dB (worst view {worst:.2}), SSIM {:.4} on {} held-out views, {:.0} frames/s",
            self.mean.psnr,
            self.mean.ssim,
            self.views.len(),
            self.frames_per_second
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
    config: &DatasetConfig,
    device: &DeviceConfig,
    progress: &Progress,
) -> Result<Evaluation> {
    let dataset = load_dataset(&out.join("undistorted"), config, progress)?;
    let gaussians = scene::io::ply::read_splat_ply(&out.join("splat.ply"))?;
    let held_out: Vec<&View> = dataset.views.iter().filter(|v| v.held_out).collect();
    let (mut renderer, device) = Renderer::on(device, &gaussians)?;
    let mut evaluation = Evaluation {
        protocol: protocol(config, &dataset, held_out.len()),
        renderer: device.choice,
        ..Evaluation::default()
    };
    progress.begin("evaluate", held_out.len());
    let mut frame_times = Vec::new();
    scene::io::replace_folder(&out.join("eval"), |folder| -> Result<()> {
        for (i, view) in held_out.iter().enumerate() {
            let picture = format!("{i:03}_{}.png", plain(&view.name));
            let (metrics, seconds) = compare_view(&mut renderer, view, &dataset, folder, &picture)?;
            frame_times.push(seconds);
            evaluation.views.push(ViewMetrics { name: view.name.clone(), picture, metrics });
            progress.tick_with(&format!("{:.2} dB", metrics.psnr))?;
        }
        evaluation.mean = mean(evaluation.views.iter().map(|v| &v.metrics));
        frame_times.sort_by(f64::total_cmp);
        evaluation.frames_per_second = frame_times.get(frame_times.len() / 2).map_or(0.0, |t| 1.0 / t);
        write_json(&folder.join("metrics.json"), &evaluation)
    })?;
    Ok(evaluation)
}

fn protocol(config: &DatasetConfig, dataset: &Dataset, views: usize) -> String {
    let ground = if dataset.is_transparent() { ", both over black where the mask is black" } else { "" };
    format!(
        "{views} of {} views held out of training (every {}th by sorted name, beginning with the first); PSNR and SSIM \
         (11×11 Gaussian window, σ 1.5) of 8-bit renders against the undistorted photos at full resolution{ground}.",
        dataset.views.len(),
        config.test_every
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
    folder: &Path,
    picture: &str,
) -> Result<(Metrics, f64)> {
    let options = RenderOptions::default();
    renderer.render(&view.camera, &view.pose, &options)?; // warm-up
    let begun = Instant::now();
    let output = renderer.render(&view.camera, &view.pose, &options)?;
    let seconds = begun.elapsed().as_secs_f64();
    let render = output.rgb.to_rgb8();
    let (photo, mask) = target(view, dataset.is_transparent())?;
    let metrics = Metrics {
        psnr: metrics::psnr(&render, &photo, None)?,
        ssim: metrics::ssim(&render, &photo, None)?,
        psnr_mask: mask.as_ref().and_then(|m| metrics::psnr(&render, &photo, Some(m)).ok()),
        ssim_mask: mask.as_ref().and_then(|m| metrics::ssim(&render, &photo, Some(m)).ok()),
    };
    for (kind, image) in [("renders", &render), ("photos", &photo)] {
        std::fs::create_dir_all(folder.join(kind))?;
        let path = folder.join(kind).join(picture);
        image.save(&path).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok((metrics, seconds))
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
    Metrics {
        psnr: average(all.clone().map(|m| m.psnr).collect()).unwrap_or(0.0),
        ssim: average(all.clone().map(|m| m.ssim).collect()).unwrap_or(0.0),
        psnr_mask: average(all.clone().filter_map(|m| m.psnr_mask).collect()),
        ssim_mask: average(all.filter_map(|m| m.ssim_mask).collect()),
    }
}
