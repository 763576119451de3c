//! What `make bench-gpu` measures, as JSON on standard output:
//! `cargo run --release -p splat --example bench_gpu -- [--backend gpu] [--gpu NAME] [--synthetic N:WxH ...] [--dataset DIR ...]`.
//!
//! Synthetic scenes: time of a picture and of a training step, by kernel, with the bytes that each kernel has to move.
//! Data sets (`images/` with `sparse/0`, or a `transforms.json`): training, held-out PSNR, pictures a second.

use clap::Parser;
use glam::{DVec3, Quat, Vec3};
use rand::Rng;
use scene::{Camera, CameraModel, Gaussians, Pose, Progress, metrics};
use serde_json::{Value, json};
use splat::backend::{Backend, KernelTimes, LearningRates, StepInput, Target};
use splat::cpu::optimise::Statistics;
use splat::dataset::Normalisation;
use splat::model::Model;
use splat::{Dataset, DatasetConfig, RenderOptions, Renderer, TrainConfig, train};
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
    /// Repetitions of each picture and step
    #[arg(long, default_value_t = 50)]
    repeat: usize,
    #[command(flatten)]
    train: TrainConfig,
}

type Result<T> = std::result::Result<T, Box<dyn Error>>;

fn main() -> Result<()> {
    let cli = Cli::parse();
    let (backend, decision) = splat::device::open(&cli.train.device)?;
    drop(backend);
    let synthetic: Vec<Value> = cli.synthetic.iter().map(|s| synthetic(&cli, s)).collect::<Result<_>>()?;
    let datasets: Vec<Value> = cli.dataset.iter().map(|d| dataset(&cli, d)).collect::<Result<_>>()?;
    let record = json!({
        "backend": decision.choice,
        "why": decision.evidence,
        "adapters": splat::adapters(),
        "synthetic": synthetic,
        "datasets": datasets,
    });
    println!("{}", serde_json::to_string_pretty(&record)?);
    Ok(())
}

/// Gaussians in a ball, sized so that each covers about as much of the picture as in trained scenes.
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
    let view = Normalisation { centre: DVec3::ZERO, scale: 1.0 }.view(&camera, &pose);
    let (mut backend, _) = splat::device::open(&cli.train.device)?;
    backend.upload(Model::from_gaussians(&ball(n)), Statistics::default())?;
    let options = RenderOptions::default();
    let picture = backend.render(&view, &options)?;
    let rgb: Vec<u8> = picture.rgb.to_rgb8().into_raw();
    let target = Target { rgb: &rgb, mask: None, transparent: false };
    let forward = repeat(cli.repeat, backend.as_mut(), &mut |b| {
        b.render_only(&view, &options).map(|_| ()).map_err(Into::into)
    })?;
    let input = StepInput {
        view: &view,
        target,
        options,
        // Nothing moves far, so that every step does the same work.
        rates: LearningRates { mean: 1e-9, ..LearningRates::default() },
        lambda_dssim: 0.2,
        opacity_penalty: 0.0,
        scale_penalty: 0.0,
    };
    let mut seen = Default::default();
    let step = repeat(cli.repeat, backend.as_mut(), &mut |b| {
        seen = b.step(&input)?;
        Ok(())
    })?;
    Ok(json!({
        "gaussians": n, "size": [w, h], "visible": seen.visible, "pairs": seen.pairs,
        "forward": forward, "step": step, "memory_mib": mib(&backend.memory()),
        "bytes": floors(seen.visible as f64, seen.pairs as f64, n as f64, f64::from(w * h)),
    }))
}

/// Bytes that each kernel has to read and write at least, whatever the cache does.
fn floors(visible: f64, pairs: f64, n: f64, pixels: f64) -> Value {
    let parameters = 4.0 * (11.0 + 48.0);
    json!({
        "project": n * 44.0 + visible * (4.0 * 48.0 + 48.0),
        "sort": visible * 8.0 * 2.0 * 8.0 + pairs * 8.0 * 2.0 * 4.0,
        "forward": pairs * 52.0 + pixels * 20.0,
        "loss": pixels * (16.0 + 4.0 + 12.0 + 2.0 * 36.0),
        "backward": pairs * (52.0 + 40.0) + pixels * 28.0,
        "optimise": pairs * 40.0 + visible * parameters * 6.0,
    })
}

/// Median wall milliseconds of a call, and milliseconds by kernel.
fn repeat(
    count: usize,
    backend: &mut dyn Backend,
    call: &mut dyn FnMut(&mut dyn Backend) -> Result<()>,
) -> Result<Value> {
    for _ in 0..3.min(count) {
        call(backend)?; // warm-up
    }
    let start = backend.times();
    let mut spent = Vec::new();
    for _ in 0..count {
        let clock = Instant::now();
        call(backend)?;
        spent.push(clock.elapsed().as_secs_f64() * 1e3);
    }
    spent.sort_by(f64::total_cmp);
    let ms = |pick: fn(&KernelTimes) -> f64| (pick(&backend.times()) - pick(&start)) * 1e3 / count as f64;
    Ok(json!({
        "ms": spent[count / 2],
        "kernels_ms": {
            "project": ms(|t| t.project), "sort": ms(|t| t.sort), "forward": ms(|t| t.forward),
            "loss": ms(|t| t.loss), "backward": ms(|t| t.backward), "optimise": ms(|t| t.optimise),
        },
    }))
}

fn mib(buffers: &[(&str, u64)]) -> f64 {
    buffers.iter().map(|b| b.1 as f64).sum::<f64>() / f64::from(1 << 20)
}

fn dataset(cli: &Cli, folder: &Path) -> Result<Value> {
    let progress = Progress::silent();
    let (model, images) = match scene::io::find_model(folder) {
        Some(path) => (scene::io::read_model(&path)?, folder.join("images")),
        None => {
            let file = scene::io::read_transforms(&folder.join("transforms.json"))?;
            (file.reconstruction, folder.to_path_buf())
        }
    };
    let dataset = Dataset::load(&images, None, &model, &DatasetConfig::default(), &progress)?;
    let result = train(&dataset, &cli.train, None, &progress)?;
    let (mut renderer, _) = Renderer::on(&cli.train.device, &result.gaussians)?;
    let (mut psnr, mut spent) = (Vec::new(), Vec::new());
    for view in dataset.views.iter().filter(|v| v.held_out) {
        let mut render = || renderer.render(&view.camera, &view.pose, &result.render);
        render()?; // warm-up
        let clock = Instant::now();
        let picture = render()?.rgb.to_rgb8();
        spent.push(clock.elapsed().as_secs_f64() * 1e3);
        let pixels = &view.levels[0];
        let ground = |(i, &v): (usize, &u8)| {
            let m = pixels.mask.as_ref().map_or(255, |m| u32::from(m[i / 3]));
            ((u32::from(v) * m + 127) / 255) as u8
        };
        let photo = pixels.rgb.iter().enumerate().map(ground).collect();
        let photo = image::RgbImage::from_raw(pixels.width as u32, pixels.height as u32, photo);
        psnr.push(metrics::psnr(&picture, &photo.ok_or("a picture of another size")?, None)?);
    }
    spent.sort_by(f64::total_cmp);
    let curve: Vec<Value> = result
        .curve
        .iter()
        .map(|p| json!({"iteration": p.iteration, "seconds": p.seconds, "psnr": p.psnr, "gaussians": p.gaussians}))
        .collect();
    Ok(json!({
        "name": folder.file_name().map(|n| n.to_string_lossy().into_owned()),
        "iterations": result.iterations, "gaussians": result.gaussians.len(),
        "seconds": result.curve.last().map(|p| p.seconds),
        "psnr_held_out": psnr.iter().sum::<f64>() / psnr.len().max(1) as f64,
        "picture_ms": spent.get(spent.len() / 2), "kernels_s": result.timings, "curve": curve,
    }))
}
