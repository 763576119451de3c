//! What `make bench-gpu` measures, as JSON on standard output: `bench_gpu [--backend gpu] [--gpu
//! NAME] [--synthetic N:WxH ...] [--dataset DIR ...] [--roof] [--export FOLDER]`.
//!
//! Synthetic scenes: time of a picture and of a training step, by kernel, with the bytes that each
//! kernel has to move and the operations it has to do. Data sets (`images/` with `sparse/0`, or a
//! `transforms.json`): training, held-out PSNR over time, pictures a second. `--roof`: what the
//! adapter moves and computes at best. `--export`: a data set for another trainer.

#[path = "bench_gpu/export.rs"]
mod export;

use clap::Parser;
use glam::{DVec3, Quat, Vec3};
use rand::Rng;
use scene::{Camera, CameraModel, Gaussians, Pose, Progress, metrics};
use serde_json::{Value, json};
use splat::NormalisedFrame;
use splat::backend::{Backend, KernelTimes, LearningRates, StepInput, Target};
use splat::model::Model;
use splat::statistics::Statistics;
use splat::{Dataset, DatasetConfig, RenderOptions, Renderer, TrainConfig, TrainResult, train};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::time::Instant;

#[derive(Parser)]
struct Cli {
    /// Synthetic scenes, Gaussians:WIDTHxHEIGHT
    #[arg(long, num_args = 1..)]
    synthetic: Vec<String>,
    /// Data sets to train on
    #[arg(long, num_args = 1..)]
    dataset: Vec<PathBuf>,
    /// Train on each data set with each of these numbers of steps (default: --iterations)
    #[arg(long, num_args = 1..)]
    curve: Vec<u32>,
    /// Write the data sets there for another trainer, and train nothing
    #[arg(long)]
    export: Option<PathBuf>,
    /// Measure what the adapter moves and computes at best
    #[arg(long)]
    roof: bool,
    /// Score no more held-out views than this
    #[arg(long, default_value_t = usize::MAX, hide_default_value = true)]
    score: usize,
    /// Repetitions of each picture and step
    #[arg(long, default_value_t = 50)]
    repeat: usize,
    #[command(flatten)]
    train: TrainConfig,
}

type Result<T> = std::result::Result<T, Box<dyn Error>>;

fn main() -> Result<()> {
    let cli = Cli::parse();
    if let Some(folder) = &cli.export {
        for dataset in &cli.dataset {
            export::export(&load(dataset)?, &cli.train, &folder.join(name_of(dataset)))?;
        }
        return Ok(());
    }
    let (backend, decision) = splat::device::open(&cli.train.device)?;
    drop(backend);
    let adapter = cli.train.device.gpu.as_deref();
    let roof = if cli.roof { Some(splat::profile::measure_adapter(adapter)?) } else { None };
    let synthetic: Vec<Value> = cli.synthetic.iter().map(|s| synthetic(&cli, s)).collect::<Result<_>>()?;
    let mut datasets = Vec::new();
    for folder in &cli.dataset {
        let dataset = load(folder)?;
        let all = if cli.curve.is_empty() { vec![cli.train.iterations] } else { cli.curve.clone() };
        for iterations in all {
            let config = TrainConfig { iterations, ..cli.train.clone() };
            datasets.push(trained(&cli, &name_of(folder), &dataset, &config)?);
        }
    }
    let record = json!({
        "backend": decision.sentences().choice,
        "why": decision.sentences().evidence,
        "adapters": splat::adapters(),
        "roof": roof,
        "synthetic": synthetic,
        "datasets": datasets,
    });
    println!("{}", serde_json::to_string_pretty(&record)?);
    Ok(())
}

fn name_of(folder: &Path) -> String {
    folder.file_name().map_or_else(|| "data".to_owned(), |n| n.to_string_lossy().into_owned())
}

/// Gaussians in a ball, sized so that each covers about as much of the picture as in trained
/// scenes.
fn ball(n: usize) -> Gaussians {
    let mut rng = scene::rng::rng(1, "bench", 0);
    let mut unit = || rng.random_range(-1.0f32..1.0);
    let size = (0.6 * (n as f32).powf(-1.0 / 3.0)).ln();
    let mut g = Gaussians { sh_degree: 3, ..Gaussians::default() };
    for _ in 0..n {
        let direction = Vec3::new(unit(), unit(), unit()).normalize_or(Vec3::X);
        g.means.push(direction * unit().abs().cbrt());
        g.log_scales.push(Vec3::new(size + unit(), size + unit(), size + unit()));
        g.rotations.push(Quat::from_xyzw(unit(), unit(), unit(), unit()).normalize());
        g.opacity_logits.push(2.0 * unit());
        g.sh.extend((0..48).map(|k| if k < 3 { unit() } else { 0.1 * unit() }));
    }
    g
}

fn synthetic(cli: &Cli, text: &str) -> Result<Value> {
    let (n, size) = text.split_once(':').ok_or("a synthetic scene is N:WIDTHxHEIGHT")?;
    let (w, h) = size.split_once('x').ok_or("a synthetic scene is N:WIDTHxHEIGHT")?;
    let (n, w, h): (usize, u32, u32) = (n.parse()?, w.parse()?, h.parse()?);
    let camera = Camera::centred(1, CameraModel::Pinhole, w, h, f64::from(h));
    let pose = Pose::look_at(DVec3::new(2.5, 0.4, 0.3), DVec3::ZERO, DVec3::Z);
    timed(cli, &ball(n), &camera, &pose)
}

/// Time of a picture and of a training step that leaves the Gaussians (world frame) where they are.
fn timed(cli: &Cli, gaussians: &Gaussians, camera: &Camera, pose: &Pose) -> Result<Value> {
    let view = NormalisedFrame { centre: DVec3::ZERO, scale: 1.0 }.view(camera, pose);
    let (mut backend, _) = splat::device::open(&cli.train.device)?;
    backend.upload(Model::from_gaussians(gaussians), Statistics::default())?;
    let options = RenderOptions::default();
    let picture = backend.render(&view, &options)?;
    let rgb: Vec<u8> = picture.rgb.to_rgb8().into_raw();
    let forward = repeat(cli.repeat, backend.as_mut(), &mut |b| Ok(b.render_only(&view, &options)?))?;
    let input = StepInput {
        view: &view,
        target: Target { rgb: &rgb, mask: None, transparent: false, photo: Some(0) },
        options,
        // Nothing moves far, so that every step does the same work.
        rates: LearningRates { mean: 1e-9, ..LearningRates::default() },
        lambda_dssim: 0.2,
    };
    let step = repeat(cli.repeat, backend.as_mut(), &mut |b| Ok(b.advance(&input).map(|_| ())?))?;
    let seen = backend.step(&input)?;
    let n = gaussians.len() as f64;
    let (visible, pairs, pixels) =
        (seen.visible as f64, seen.pairs as f64, (view.width * view.height) as f64);
    Ok(json!({
        "gaussians": gaussians.len(), "size": [view.width, view.height], "visible": seen.visible,
        "pairs": seen.pairs, "forward": forward, "step": step, "memory_mib": mib(&backend.memory()),
        "bytes": bytes(visible, pairs, n, pixels), "flop": operations(visible, pairs),
        "remarks": backend.remarks(),
    }))
}

/// Bytes that each kernel has to read and write at least, whatever the cache does.
fn bytes(visible: f64, pairs: f64, n: f64, pixels: f64) -> Value {
    let parameters = 4.0 * (11.0 + 48.0);
    json!({
        "project": n * (44.0 + 12.0) + visible * (4.0 * 48.0 + 48.0),
        // Eight passes by depth, four by tile: keys and values are read and written; then boxes,
        // pairs, owners.
        "sort": visible * (8.0 * 20.0 + 3.0 * 40.0) + pairs * (4.0 * 20.0 + 28.0),
        "forward": pairs * (8.0 + 48.0) + pixels * 20.0,
        "loss": pixels * (16.0 + 4.0 + 36.0) + pixels * (16.0 + 4.0 + 36.0 + 16.0),
        "backward": pairs * (8.0 + 48.0 + 40.0) + pixels * 16.0,
        "optimise": pairs * 40.0 + visible * (8.0 + parameters * 6.0 + 8.0 * 2.0),
    })
}

/// Operations (an addition or a multiplication is one) of each kernel where a pair reaches all of
/// its tile's 256 pixels, which is more than what early ends leave: pixels finish, and only the
/// pairs looked at count.
fn operations(visible: f64, pairs: f64) -> Value {
    json!({
        "project": visible * 500.0,
        "forward": pairs * 256.0 * 22.0,
        "backward": pairs * 256.0 * (32.0 + 26.0),
        "optimise": visible * 1500.0,
    })
}

/// Wall milliseconds of a call in a row of calls that ends when all are done, and milliseconds by
/// kernel.
fn repeat(
    count: usize,
    backend: &mut dyn Backend,
    call: &mut dyn FnMut(&mut dyn Backend) -> Result<()>,
) -> Result<Value> {
    for _ in 0..count.min(20) {
        call(backend)?; // warm-up
    }
    backend.settle()?;
    let start = backend.times();
    let clock = Instant::now();
    for _ in 0..count {
        call(backend)?;
    }
    backend.settle()?;
    let spent = clock.elapsed().as_secs_f64() * 1e3 / count as f64;
    let ms = |pick: fn(&KernelTimes) -> f64| (pick(&backend.times()) - pick(&start)) * 1e3 / count as f64;
    Ok(json!({
        "ms": spent,
        "kernels_ms": {
            "project": ms(|t| t.project), "sort": ms(|t| t.sort), "forward": ms(|t| t.forward),
            "loss": ms(|t| t.loss), "backward": ms(|t| t.backward), "optimise": ms(|t| t.optimise),
        },
    }))
}

fn mib(buffers: &[(&str, u64)]) -> f64 {
    buffers.iter().map(|b| b.1 as f64).sum::<f64>() / f64::from(1 << 20)
}

fn load(folder: &Path) -> Result<Dataset> {
    let (model, images) = match scene::io::find_model(folder) {
        Some(path) => (scene::io::read_model(&path)?, folder.join("images")),
        None => {
            let file = scene::io::read_transforms(&folder.join("transforms.json"))?;
            (file.reconstruction, folder.to_path_buf())
        }
    };
    Ok(Dataset::load(&images, None, &model, &DatasetConfig::default(), &Progress::silent())?)
}

/// Trains, and scores the held-out views as they are shown: 8 bits, over black, full resolution.
fn trained(cli: &Cli, name: &str, dataset: &Dataset, config: &TrainConfig) -> Result<Value> {
    let clock = Instant::now();
    let begun = scene::clock::cpu_seconds();
    let result = train(dataset, config, None, &Progress::silent())?;
    let (wall, cpu) = (clock.elapsed().as_secs_f64(), scene::clock::cpu_seconds() - begun);
    let (psnr, picture_ms) = scored(dataset, config, &result, cli.score)?;
    let first = dataset.views.first().ok_or("no view")?;
    let scene = timed(cli, &result.gaussians, &first.camera, &first.pose)?;
    let curve: Vec<Value> = result
        .curve
        .iter()
        .map(|p| json!({"iteration": p.iteration, "seconds": p.seconds, "psnr": p.psnr, "gaussians": p.gaussians}))
        .collect();
    let mean = psnr.iter().sum::<f64>() / psnr.len().max(1) as f64;
    Ok(json!({
        "name": name, "iterations": result.iterations, "gaussians": result.gaussians.len(),
        "seconds": wall, "cpu_seconds": cpu, "psnr_held_out": mean,
        "psnr_worst": psnr.iter().copied().fold(f64::INFINITY, f64::min),
        "picture_ms": picture_ms, "kernels_s": result.timings, "curve": curve, "decisions": result.decisions,
        "scene": scene,
    }))
}

fn scored(
    dataset: &Dataset,
    config: &TrainConfig,
    result: &TrainResult,
    views: usize,
) -> Result<(Vec<f64>, Option<f64>)> {
    let (mut renderer, _) = Renderer::on(&config.device, &result.gaussians, Vec::new())?;
    let (mut psnr, mut spent) = (Vec::new(), Vec::new());
    for view in dataset.views.iter().filter(|v| v.held_out).take(views) {
        let mut render = || renderer.render(&view.camera, &view.pose, &result.render);
        render()?; // warm-up
        let clock = Instant::now();
        let picture = render()?.rgb.to_rgb8();
        spent.push(clock.elapsed().as_secs_f64() * 1e3);
        let pixels = &view.levels[0];
        let over_black = |(i, &v): (usize, &u8)| {
            let m = pixels.mask.as_ref().map_or(255, |m| u32::from(m[i / 3]));
            ((u32::from(v) * m + 127) / 255) as u8
        };
        let photo = pixels.rgb.iter().enumerate().map(over_black).collect();
        let photo = image::RgbImage::from_raw(pixels.width as u32, pixels.height as u32, photo);
        psnr.push(metrics::psnr(&picture, &photo.ok_or("a picture of another size")?, None)?);
    }
    spent.sort_by(f64::total_cmp);
    Ok((psnr, spent.get(spent.len() / 2).copied()))
}
