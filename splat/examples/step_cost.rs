//! What a training step and a rendered frame cost, by stage:
//! `cargo run --release -p splat --example step_cost -- DATASET_DIR [--gaussians N] [--width W --height H]`.
//! Trains briefly so that the Gaussians lie as in training, then repeats full-resolution steps that move nothing.
//! CPU ms are of all threads of the process (Linux).

use clap::Parser;
use scene::{Camera, CameraModel, Progress};
use splat::backend::{Backend, KernelTimes, LearningRates, StepInput, Target};
use splat::clock::cpu_seconds;
use splat::cpu::CpuBackend;
use splat::model::Model;
use splat::{AlphaMode, Dataset, DatasetConfig, RenderOptions, Renderer, TrainConfig, train};
use std::path::PathBuf;
use std::time::Instant;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error + Send + Sync>>;

#[derive(Parser)]
struct Cli {
    dataset: PathBuf,
    /// Gaussians (as many as the sparse cloud has, grown or thinned to this)
    #[arg(long, default_value_t = 15_000)]
    gaussians: usize,
    /// Training steps before anything is measured
    #[arg(long, default_value_t = 600)]
    warm_up: u32,
    /// Steps and frames measured
    #[arg(long, default_value_t = 86)]
    steps: usize,
    /// Width of the rendered frames
    #[arg(long, default_value_t = 640)]
    width: u32,
    /// Height of the rendered frames
    #[arg(long, default_value_t = 480)]
    height: u32,
}

fn main() -> Result<()> {
    let cli = Cli::parse();
    let model = match scene::io::find_model(&cli.dataset) {
        Some(path) => scene::io::read_model(&path)?,
        None => scene::io::read_transforms(&cli.dataset.join("transforms.json"))?.reconstruction,
    };
    let images =
        Some(cli.dataset.join("images")).filter(|p| p.is_dir() && cli.dataset.join("sparse").is_dir());
    let images = images.unwrap_or(cli.dataset.clone());
    let dataset = Dataset::load(&images, None, &model, &DatasetConfig::default(), &Progress::silent())?;
    let mut config =
        TrainConfig { iterations: cli.warm_up, max_gaussians: cli.gaussians, ..TrainConfig::default() };
    config.recipe.prune_redundant = false;
    config.recipe.prune_redundant = false;
    let result = train(&dataset, &config, None, &Progress::silent())?;
    let normalised = Model::from_gaussians(&dataset.normalisation.to_normalised(result.gaussians.clone()));
    println!(
        "{} gaussians of SH degree {}, {} views of {} x {}",
        normalised.len,
        normalised.sh_degree,
        dataset.views.len(),
        dataset.views[0].view.width,
        dataset.views[0].view.height
    );
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        pool.install(|| steps(&cli, &dataset, &normalised, threads))?;
    }
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        pool.install(|| frames(&cli, &dataset, &result.gaussians, threads))?;
    }
    Ok(())
}

fn steps(cli: &Cli, dataset: &Dataset, model: &Model, threads: usize) -> Result<()> {
    let mut backend = CpuBackend::default();
    backend.upload(model.clone());
    backend.set_clock(cpu_seconds);
    let views = dataset.training_views();
    let (mut pairs, mut visible) = (0, 0);
    let mut start = KernelTimes::default();
    for k in 0..cli.steps + 3 {
        let view = &dataset.views[views[k % views.len()]];
        let pixels = &view.levels[0];
        if k == 3 {
            start = backend.times();
        }
        let out = backend.step(&StepInput {
            view: &view.view,
            target: Target {
                rgb: &pixels.rgb,
                mask: pixels.mask.as_deref(),
                transparent: dataset.alpha == AlphaMode::Transparent,
                photo: None,
            },
            options: RenderOptions::default(),
            rates: LearningRates::default(),
            lambda_dssim: 0.2,
            opacity_penalty: 0.0,
            scale_penalty: 0.0,
        })?;
        if k >= 3 {
            pairs += out.pairs;
            visible += out.visible;
        }
    }
    let n = cli.steps as f64;
    let m = difference(&backend.times(), &start).map(|seconds| seconds * 1e3 / n);
    println!(
        "step, {threads} threads: {:.1} CPU ms (project {:.2} sort {:.2} forward {:.2} loss {:.2} backward {:.2} optimise {:.2}), {} pairs, {} visible",
        m.iter().sum::<f64>(),
        m[0],
        m[1],
        m[2],
        m[3],
        m[4],
        m[5],
        pairs / cli.steps,
        visible / cli.steps
    );
    Ok(())
}

fn frames(cli: &Cli, dataset: &Dataset, gaussians: &scene::Gaussians, threads: usize) -> Result<()> {
    let mut renderer = Renderer::new(gaussians)?;
    let (mut walls, mut cpu) = (Vec::new(), 0.0);
    for k in 0..cli.steps + 3 {
        if k == 3 {
            cpu = cpu_seconds();
        }
        let view = &dataset.views[k % dataset.views.len()];
        // The narrower side keeps its angle.
        let scale = (f64::from(cli.width) / view.view.width as f64)
            .max(f64::from(cli.height) / view.view.height as f64);
        let focal = scale * f64::from(view.view.focal[0]);
        let camera = Camera::centred(1, CameraModel::Pinhole, cli.width, cli.height, focal);
        let clock = Instant::now();
        std::hint::black_box(renderer.render(&camera, &view.pose, &RenderOptions::default())?);
        if k >= 3 {
            walls.push(clock.elapsed().as_secs_f64());
        }
    }
    let cpu = 1e3 * (cpu_seconds() - cpu) / cli.steps as f64;
    let wall = median(walls);
    println!(
        "frame {} x {}, {threads} threads: {cpu:.1} CPU ms, {:.1} ms wall, {:.0} frames a second",
        cli.width,
        cli.height,
        1e3 * wall,
        1.0 / wall
    );
    Ok(())
}

fn difference(now: &KernelTimes, then: &KernelTimes) -> [f64; 6] {
    [
        now.project - then.project,
        now.sort - then.sort,
        now.forward - then.forward,
        now.loss - then.loss,
        now.backward - then.backward,
        now.optimise - then.optimise,
    ]
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
