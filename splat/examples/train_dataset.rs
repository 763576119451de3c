//! Trains on a data set and measures the held-out views: `cargo run --release -p splat --example
//! train_dataset -- DATASET_DIR OUT [flags]`. DATASET_DIR: `images/` with `sparse/0`, or a
//! `transforms.json`. Writes splat.ply, metrics.json and photo | render | difference for every
//! held-out view.

use clap::Parser;
use image::{Rgb, RgbImage};
use scene::progress::ProgressSink;
use scene::{Progress, Reconstruction};
use splat::{Dataset, DatasetConfig, Quality, RenderOptions, Renderer, TrainConfig, train};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

#[derive(Parser)]
struct Cli {
    dataset: PathBuf,
    out: PathBuf,
    #[arg(long)]
    masks: Option<PathBuf>,
    #[arg(long, value_enum)]
    quality: Option<Quality>,
    /// Behind transparent pixels when judged, grey value in [0, 1]
    #[arg(long, default_value_t = 0.0)]
    ground: f32,
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[arg(long)]
    checkpoint: Option<PathBuf>,
    #[arg(long)]
    no_pictures: bool,
    #[command(flatten)]
    data: DatasetConfig,
    #[command(flatten)]
    train: TrainConfig,
}

struct Plain;

impl ProgressSink for Plain {
    fn begin(&self, what: &str, total: u64) {
        eprintln!("{what}: {total}");
    }
    fn update(&self, done: u64, detail: &str) {
        if done.is_multiple_of(500) && !detail.is_empty() {
            eprintln!("  {done}: {detail}");
        }
    }
    fn note(&self, message: &str) {
        eprintln!("  {message}");
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments: Vec<String> = std::env::args().collect();
    if let Some(quality) = Cli::try_parse().ok().and_then(|c| c.quality) {
        let flags = quality.flags().iter().flat_map(|(f, v)| [format!("--{f}"), (*v).to_owned()]);
        let typed = arguments.clone();
        arguments.extend(
            flags.collect::<Vec<_>>().chunks(2).filter(|f| !typed.contains(&f[0])).flatten().cloned(),
        );
    }
    let mut cli = Cli::parse_from(arguments);
    cli.train.seed = cli.seed;
    static NEVER: AtomicBool = AtomicBool::new(false);
    let progress = Progress::new(Box::new(Plain), &NEVER);
    let model = read(&cli.dataset)?;
    let images =
        if cli.dataset.join("sparse").is_dir() { cli.dataset.join("images") } else { cli.dataset.clone() };
    let clock = Instant::now();
    let dataset = Dataset::load(&images, cli.masks.as_deref(), &model, &cli.data, &progress)?;
    println!(
        "{} views, {} points, loaded in {:.2} s",
        dataset.views.len(),
        dataset.points.len(),
        clock.elapsed().as_secs_f64()
    );
    let (clock, cpu) = (Instant::now(), cpu_seconds());
    let result = train(&dataset, &cli.train, cli.checkpoint.as_deref(), &progress)?;
    let (wall, cpu) = (clock.elapsed().as_secs_f64(), cpu_seconds() - cpu);
    for point in result.curve.iter().step_by((result.curve.len() / 12).max(1)) {
        println!(
            "  {:6} {:7.2} s  loss {:.4}  {:.2} dB  {} gaussians",
            point.iteration, point.seconds, point.loss, point.psnr, point.gaussians
        );
    }
    for told in result.decisions.iter().map(|d| d.sentences()) {
        println!("  {told} ({})", told.evidence.join("; "));
    }
    let t = &result.timings;
    let steps = f64::from(result.iterations) / 1e3;
    println!(
        "ms a step: project {:.2} sort {:.2} forward {:.2} loss {:.2} backward {:.2} optimise {:.2}",
        t.project / steps,
        t.sort / steps,
        t.forward / steps,
        t.loss / steps,
        t.backward / steps,
        t.optimise / steps
    );
    std::fs::create_dir_all(&cli.out)?;
    scene::io::write_splat_ply(&cli.out.join("splat.ply"), &result.gaussians)?;
    let scores = evaluate(&cli, &dataset, &result.gaussians, &result.render)?;
    let mean = |k: usize| scores.iter().map(|s| s[k]).sum::<f64>() / scores.len().max(1) as f64;
    let least = scores.iter().map(|s| s[0]).fold(f64::INFINITY, f64::min);
    println!(
        "RESULT psnr {:.3} ssim {:.4} min {:.2} | {} gaussians {} steps | wall {:.1} s cpu {:.1} s | peak {} MiB",
        mean(0),
        mean(1),
        least,
        result.gaussians.len(),
        result.iterations,
        wall,
        cpu,
        peak_mib()
    );
    Ok(())
}

fn read(folder: &Path) -> Result<Reconstruction, Box<dyn Error>> {
    match scene::io::find_model(folder) {
        Some(path) => Ok(scene::io::read_model(&path)?),
        None => Ok(scene::io::read_transforms(&folder.join("transforms.json"))?.reconstruction),
    }
}

fn evaluate(
    cli: &Cli,
    dataset: &Dataset,
    gaussians: &scene::Gaussians,
    options: &RenderOptions,
) -> Result<Vec<[f64; 2]>, Box<dyn Error>> {
    let mut renderer = Renderer::new(gaussians)?;
    let options = RenderOptions { background: [cli.ground; 3], ..*options };
    let (mut scores, mut spent) = (Vec::new(), 0.0);
    for view in dataset.views.iter().filter(|v| v.held_out) {
        let clock = Instant::now();
        let rendered = renderer.render(&view.camera, &view.pose, &options)?;
        spent += clock.elapsed().as_secs_f64();
        let rendered = rendered.rgb.to_rgb8();
        let pixels = &view.levels[0];
        let (w, h) = rendered.dimensions();
        let photo = RgbImage::from_fn(w, h, |x, y| {
            let i = (y * w + x) as usize;
            let a = pixels.mask.as_ref().map_or(1.0, |m| f32::from(m[i]) / 255.0);
            let byte = |c: usize| f32::from(pixels.rgb[i * 3 + c]) * a + 255.0 * cli.ground * (1.0 - a);
            Rgb([0, 1, 2].map(|c| byte(c).round() as u8))
        });
        let score =
            [scene::metrics::psnr(&photo, &rendered, None)?, scene::metrics::ssim(&photo, &rendered, None)?];
        println!("  {} {:.2} dB {:.4}", view.name, score[0], score[1]);
        scores.push(score);
        if !cli.no_pictures {
            let name = Path::new(&view.name).file_stem().unwrap_or_default().to_string_lossy().into_owned();
            side_by_side(&photo, &rendered).save(cli.out.join(format!("{name}.png")))?;
        }
    }
    println!("render {:.1} ms a view", 1e3 * spent / scores.len().max(1) as f64);
    Ok(scores)
}

fn side_by_side(photo: &RgbImage, render: &RgbImage) -> RgbImage {
    let (w, h) = photo.dimensions();
    RgbImage::from_fn(w * 3, h, |x, y| match x / w {
        0 => *photo.get_pixel(x, y),
        1 => *render.get_pixel(x - w, y),
        _ => {
            let (a, b) = (photo.get_pixel(x - 2 * w, y), render.get_pixel(x - 2 * w, y));
            Rgb([0, 1, 2].map(|c| a[c].abs_diff(b[c]).saturating_mul(3)))
        }
    })
}

/// User and system time of this process, seconds.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or("").split_whitespace().collect();
    let ticks = |k: usize| fields.get(k).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

fn peak_mib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|l| l.starts_with("VmHWM")).unwrap_or("");
    line.split_whitespace().nth(1).and_then(|v| v.parse::<u64>().ok()).unwrap_or(0) / 1024
}
