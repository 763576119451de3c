//! What a training step and a rendered frame cost, by stage: `cargo run --release -p splat
//! --example step_cost -- DATASET_DIR [--gaussians N] [--width W --height H]`. Trains briefly so
//! that the Gaussians lie as in training, then repeats full-resolution steps that move nothing. CPU
//! ms are of all threads of the process (Linux). Beside each stage stands the share of what the
//! machine could do: the stage's own arithmetic (or its bytes) at the rate of a loop that does
//! nothing else (`splat::profile::CoreLimits`).

use clap::Parser;
use scene::clock::cpu_seconds;
use scene::{Camera, CameraModel, Progress};
use splat::backend::{KernelTimes, LearningRates, StepInput, Target};
use splat::model::Model;
use splat::profile::{CoreLimits, ProfiledProcessor};
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
    let config =
        TrainConfig { iterations: cli.warm_up, max_gaussians: cli.gaussians, ..TrainConfig::default() };
    let result = train(&dataset, &config, None, &Progress::silent())?;
    let normalised = Model::from_gaussians(&dataset.normalisation.normalise(result.gaussians.clone()));
    println!(
        "{} gaussians of SH degree {}, {} views of {} x {}",
        normalised.len,
        normalised.sh_degree,
        dataset.views.len(),
        dataset.views[0].view.width,
        dataset.views[0].view.height
    );
    let machine = CoreLimits::measure();
    println!(
        "one core: {:.1} G multiply-adds of f32 a second, {:.1} GB copied (read and written) a second",
        machine.multiply_adds / 1e9,
        machine.bytes / 1e9
    );
    let (w, h) = (cli.width, cli.height);
    let mut limits = Vec::new();
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let cost = pool.install(|| steps(&cli, &dataset, &normalised))?;
        if threads == 1 {
            let (n, visible, pairs) = (normalised.len, cost.visible, cost.pairs);
            println!(
                "\n| {n} Gaussians ({visible:.0} visible, {pairs:.0} pairs), CPU ms | project | sort, bin | forward | loss | backward | optimise | step | frame {w} × {h} |"
            );
            println!("|---|---|---|---|---|---|---|---|---|");
            limits = cost.limits(normalised.len, &machine);
        }
        let stages = cost.stages.map(|ms| format!("{ms:.2}")).join(" | ");
        let frame = pool.install(|| frames(&cli, &dataset, &result.gaussians))?;
        println!("| {threads} threads | {stages} | {:.1} | {frame} |", cost.stages.iter().sum::<f64>());
    }
    println!("| share of the limit, 1 thread | {} | | |", limits.join(" | "));
    Ok(())
}

/// Vector operations (loads and stores apart) that forward and backward spend on a Gaussian and a
/// pixel, counted in `cpu/rasterise.rs`: exponent and tests (8), 2^x (10), alpha and transmittance
/// (8), colour (3), the new state (3); backward: the same without colour, and the sums (4), what is
/// behind (4), α dL/dα (7), its moments (4).
const FORWARD_OPERATIONS: f64 = 32.0;
const BACKWARD_OPERATIONS: f64 = 48.0;
/// Vector operations that the loss spends on a pixel, counted in `cpu/loss.rs` for four lines at
/// once: of each channel the moments down (66) and across (44), the similarity (25), its
/// derivatives down (42) and across (33), the gradient (12).
const LOSS_OPERATIONS: f64 = 3.0 * 222.0;
/// Bytes of a pixel that the loss reads and writes beyond the second-level cache: three planes each
/// of picture and target twice, three planes of the gradient.
const LOSS_BYTES: f64 = 4.0 * (2.0 * 6.0 + 3.0);
/// Bytes of a Gaussian and pass of the radix sort (key, place read, place written) for three
/// passes, and of a pair (tile, place, twice its list).
const SORT_BYTES: f64 = 3.0 * 12.0;
const BIN_BYTES: f64 = 16.0;
/// Bytes of a Gaussian that project reads (geometry, colour) and writes (a record and a key).
const PROJECT_BYTES: f64 = 4.0 * (11.0 + 48.0) + 68.0;
/// Bytes of a visible Gaussian that optimise reads and writes: parameters, two moments of all but
/// the colours, one of each channel's, clock, statistics.
const OPTIMISE_BYTES: f64 = 2.0 * 4.0 * (3.0 * 11.0 + 48.0 + 3.0 + 3.0);
/// Bytes of a pair that backward writes and optimise reads.
const SUM_BYTES: f64 = 40.0;

/// What a step costs, means over the steps.
struct Cost {
    /// CPU ms of each stage.
    stages: [f64; 6],
    pairs: f64,
    visible: f64,
    /// Gaussians times pixels that were evaluated.
    touched: f64,
    pixels: f64,
}

impl Cost {
    /// The share of each stage's time that its arithmetic, or its bytes, would take alone.
    fn limits(&self, gaussians: usize, machine: &CoreLimits) -> Vec<String> {
        let arithmetic = [
            FORWARD_OPERATIONS * self.touched,
            LOSS_OPERATIONS * self.pixels,
            BACKWARD_OPERATIONS * self.touched,
        ]
        .map(|operations| 1e5 * operations / machine.multiply_adds);
        let bytes = [
            PROJECT_BYTES * gaussians as f64,
            SORT_BYTES * self.visible + BIN_BYTES * self.pairs,
            LOSS_BYTES * self.pixels,
            OPTIMISE_BYTES * self.visible + SUM_BYTES * self.pairs,
        ]
        .map(|bytes| 1e5 * bytes / machine.bytes);
        let [project, sort, forward, loss, backward, optimise] = self.stages;
        vec![
            format!("{:.0} % of the bandwidth", bytes[0] / project),
            format!("{:.0} % of the bandwidth", bytes[1] / sort),
            format!("{:.0} % of the arithmetic", arithmetic[0] / forward),
            format!(
                "{:.0} % of the arithmetic, {:.0} % of the bandwidth",
                arithmetic[1] / loss,
                bytes[2] / loss
            ),
            format!("{:.0} % of the arithmetic", arithmetic[2] / backward),
            format!("{:.0} % of the bandwidth", bytes[3] / optimise),
        ]
    }
}

fn steps(cli: &Cli, dataset: &Dataset, model: &Model) -> Result<Cost> {
    let mut backend = ProfiledProcessor::new(model.clone(), cpu_seconds)?;
    let views: Vec<usize> = (0..dataset.views.len()).filter(|&v| !dataset.views[v].held_out).collect();
    let (mut pairs, mut visible, mut touched, mut pixels_seen) = (0, 0, 0, 0);
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
        })?;
        if k >= 3 {
            pairs += out.pairs;
            visible += out.visible;
            touched += backend.gaussian_pixels();
            pixels_seen += pixels.width * pixels.height;
        }
    }
    let n = cli.steps as f64;
    Ok(Cost {
        stages: difference(&backend.times(), &start).map(|seconds| seconds * 1e3 / n),
        pairs: pairs as f64 / n,
        visible: visible as f64 / n,
        touched: touched as f64 / n,
        pixels: pixels_seen as f64 / n,
    })
}

/// CPU ms of a frame, and frames a second.
fn frames(cli: &Cli, dataset: &Dataset, gaussians: &scene::Gaussians) -> Result<String> {
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
    Ok(format!("{cpu:.1} ({:.0} a second)", 1.0 / median(walls)))
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
