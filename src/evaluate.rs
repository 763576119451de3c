//! Metrics of the held-out views, after the 8-bit round trip.

pub mod geometry;
pub mod metrics;
pub mod speed;
mod table;

use crate::args::EvalConfig;
use crate::pictures::Pictures;
use crate::record::RenderingCost;
use crate::record::{Evaluation, Metrics, Percentile, TrainingViews, ViewMetrics};
use crate::stage::write_json;
use anyhow::{Context, Result};
use image::{GrayImage, RgbImage};
use scene::Progress;
use scene::lpips::Lpips;
use splat::{Dataset, DatasetConfig, DeviceConfig, View};
use std::path::{Path, PathBuf};

impl ViewMetrics {
    /// Its picture of a kind (`photos`, `renders`) in a run folder. Names in files stay inside
    /// their folder.
    pub fn picture(&self, run: &Path, kind: &str) -> Result<PathBuf> {
        let path = run.join("eval").join(kind).join(scene::io::safe_name(&self.picture)?);
        anyhow::ensure!(path.is_file(), "{} is missing; run sat-recon eval again", path.display());
        Ok(path)
    }
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

/// The same for training, which never looks at the photos that are held out: of those only the
/// coarsest level stays in memory.
pub fn load_to_train(training_set: &Path, config: &DatasetConfig, progress: &Progress) -> Result<Dataset> {
    let mut dataset = load_dataset(training_set, config, progress)?;
    for view in dataset.views.iter_mut().filter(|v| v.held_out) {
        let last = view.levels.pop();
        view.levels = last.into_iter().collect();
    }
    Ok(dataset)
}

/// The same for training a splat, which makes coarser levels when it needs them.
pub fn load_to_train_splat(
    training_set: &Path,
    config: &DatasetConfig,
    progress: &Progress,
) -> Result<Dataset> {
    let mut dataset = load_to_train(training_set, config, progress)?;
    dataset.views.iter_mut().for_each(|view| view.levels.truncate(1));
    Ok(dataset)
}

/// The networks of the weights that were given.
pub fn load_networks(weights: &[PathBuf]) -> Result<Vec<Lpips>> {
    weights.iter().map(|path| Ok(Lpips::load(path)?)).collect()
}

/// Renders the held-out views, compares them with the photos, writes `eval` into the folder `new`.
pub fn evaluate(
    out: &Path,
    new: &Path,
    dataset: &DatasetConfig,
    config: &EvalConfig,
    device: &DeviceConfig,
    progress: &Progress,
) -> Result<Evaluation> {
    let networks = load_networks(&config.lpips_weights)?;
    let (mut pictures, renderer) = Pictures::open(out, device)?;
    let cameras = speed::held_out_cameras(&out.join("undistorted"), dataset)?;
    let rendering = speed::measure(&mut pictures, &cameras, config.fps_loops, progress)?;
    let mesh = &config.mesh;
    let config = dataset;
    let dataset = load_dataset(&out.join("undistorted"), config, progress)?;
    let geometry = match &pictures {
        Pictures::Splat(renderer, gaussians) => {
            geometry::measure(out, mesh, &dataset, (gaussians, renderer.antialias), progress)?
        }
        Pictures::Parts(..) | Pictures::Field(..) => None,
    };
    let held_out: Vec<&View> = dataset.views.iter().filter(|v| v.held_out).collect();
    let frame_ms = rendering.frame_ms_median;
    let protocol = protocol(config, &dataset, held_out.len(), &rendering, &networks);
    let mut evaluation = Evaluation { protocol, rendering, geometry, renderer, ..Evaluation::default() };
    progress.begin("evaluate", held_out.len());
    scene::io::replace_folder(&new.join("eval"), |folder| -> Result<()> {
        for (i, view) in held_out.iter().enumerate() {
            let picture = format!("{i:03}_{}.png", plain(&view.name));
            let compared = Compared::of(&mut pictures, view, &dataset)?;
            let metrics = compared.judge(&networks)?;
            compared
                .write(folder, &picture)
                .with_context(|| format!("cannot write {picture} into {}", folder.display()))?;
            evaluation.views.push(ViewMetrics { name: view.name.clone(), picture, metrics });
            progress.tick_with(&format!("{:.2} dB", metrics.psnr))?;
        }
        let all: Vec<Metrics> = evaluation.views.iter().map(|v| v.metrics).collect();
        evaluation.mean = Metrics::mean(&all);
        if !all.is_empty() {
            let percentiles =
                PERCENTS.map(|p| Percentile { percent: p, metrics: Metrics::percentile(&all, p) });
            evaluation.percentiles = percentiles.to_vec();
        }
        evaluation.training = training_views(&mut pictures, &dataset, all.len(), frame_ms, progress)?;
        write_json(&folder.join("metrics.json"), &evaluation)
    })?;
    Ok(evaluation)
}

/// Percentiles that are reported, per cent of the views. Source: chosen by hand, never measured.
const PERCENTS: [u32; 3] = [5, 50, 95];

/// Judges training views, as many as are held out, spread evenly; fewer where that would take
/// longer than [`speed::LONGEST`].
fn training_views(
    pictures: &mut Pictures,
    dataset: &Dataset,
    most: usize,
    frame_ms: f64,
    progress: &Progress,
) -> Result<Option<TrainingViews>> {
    let training = dataset.training_views();
    let quick = (1e3 * speed::LONGEST.as_secs_f64() / frame_ms.max(1.0)) as usize;
    let (most, mut all) = (most.min(quick.max(1)), Vec::new());
    for &index in training.iter().step_by(training.len().div_ceil(most.max(1)).max(1)) {
        progress.check()?;
        all.push(Compared::of(pictures, &dataset.views[index], dataset)?.judge(&[])?);
    }
    Ok((most > 0 && !all.is_empty()).then(|| TrainingViews { views: all.len(), mean: Metrics::mean(&all) }))
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
        format!(
            "LPIPS 0.1 ({}; trained linear layers, no resize; inside the mask each layer is averaged over the mask)",
            names.join(", ")
        )
    };
    let split = match config.every() {
        Some(every) => format!("every {every}th by sorted name, beginning with the first"),
        None => match config.test_sector {
            Some(degrees) => format!("all from within {degrees}° around the first"),
            None => "by the data set's own split".to_owned(),
        },
    };
    let ground = if dataset.is_transparent() { ", both over black where the mask is black" } else { "" };
    format!(
        "{views} of {} views held out of training ({split}); PSNR and SSIM \
         (11×11 Gaussian window, σ 1.5, per channel, windows inside the image) of 8-bit renders against the undistorted \
         photos at full resolution, no resize{ground}; inside the mask: pixels, and windows centred on pixels, that it keeps; \
         {lpips}. Frames per second: the held-out views rendered {} times after a warm-up, mean of the median five.",
        dataset.views.len(),
        rendering.loops
    )
}

fn plain(name: &str) -> String {
    let stem = Path::new(name).file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    stem.chars().map(|c| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect()
}

/// A photo as it is compared, its mask, and its render.
struct Compared {
    render: RgbImage,
    photo: RgbImage,
    mask: Option<GrayImage>,
}

impl Compared {
    fn of(pictures: &mut Pictures, view: &View, dataset: &Dataset) -> Result<Self> {
        let output = pictures.render(&view.camera, &view.pose, pictures.time_of(&view.name), [0.0; 3])?;
        let (photo, mask) = target(view, dataset.is_transparent())?;
        Ok(Self { render: output.rgb.to_rgb8(), photo, mask })
    }

    fn judge(&self, networks: &[Lpips]) -> Result<Metrics> {
        Metrics::judge(&self.render, &self.photo, self.mask.as_ref(), networks)
    }

    /// Into `renders`, `photos` and, where there is one, `masks`.
    fn write(&self, folder: &Path, picture: &str) -> Result<()> {
        self.render.save(inside(folder, "renders", picture)?)?;
        self.photo.save(inside(folder, "photos", picture)?)?;
        if let Some(mask) = &self.mask {
            mask.save(inside(folder, "masks", picture)?)?;
        }
        Ok(())
    }
}

/// Where a picture of a kind goes; its folder is made.
fn inside(folder: &Path, kind: &str, picture: &str) -> Result<PathBuf> {
    let folder = folder.join(kind);
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    Ok(folder.join(picture))
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
