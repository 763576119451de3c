//! How a training step grows: `cargo run --release -p splat --example growth [-- --steps 6 --most
//! 3000000]`. CPU ms a step and memory against Gaussians (640 × 480), pixels (100,000 Gaussians)
//! and views (320 × 240), and the exponent p of `cost ∝ size^p` fitted to the upper half of each
//! column (1: proportional; 0: does not grow). The scene is a ball of spheres' shells whose
//! Gaussians cover the same area whatever their number. CPU ms are of all threads (Linux); memory
//! is what the process holds beyond what it held before the row, at its peak.

use clap::Parser;
use glam::{DVec3, Quat, Vec3};
use rand::Rng as _;
use scene::clock::cpu_seconds;
use scene::{Camera, CameraModel, Gaussians, Pose, Progress};
use splat::backend::{LearningRates, StepInput, Target};
use splat::model::Model;
use splat::profile::ProfiledProcessor;
use splat::{AlphaMode, Dataset, RenderOptions, TrainConfig, View, train};
use splat::{NormalisedFrame, Pixels, pyramid};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error + Send + Sync>>;

#[derive(Parser)]
struct Cli {
    /// Steps measured for each row
    #[arg(long, default_value_t = 6)]
    steps: usize,
    /// Most Gaussians
    #[arg(long, default_value_t = 3_000_000)]
    most: usize,
    /// Most views
    #[arg(long, default_value_t = 1000)]
    views: usize,
}

/// Cost of a row: size, CPU ms a step, MiB.
type Row = (f64, f64, f64);

fn main() -> Result<()> {
    let cli = Cli::parse();
    println!(
        "| gaussians | pairs | CPU ms a step | project | sort | forward | loss | backward | optimise | MiB |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let counts = [10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000];
    let rows = counts.iter().filter(|&&n| n <= cli.most).map(|&n| step(&cli, n, 640, 480, n));
    print_fit("gaussians", &rows.collect::<Result<Vec<_>>>()?);
    println!(
        "\n| pixels | pairs | CPU ms a step | project | sort | forward | loss | backward | optimise | MiB |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let sizes = [(160, 120), (320, 240), (640, 480), (960, 720), (1920, 1080)];
    let rows = sizes.iter().map(|&(w, h)| step(&cli, 100_000.min(cli.most), w, h, w * h));
    print_fit("pixels", &rows.collect::<Result<Vec<_>>>()?);
    println!("\n| views | CPU ms a step | MiB |\n|---|---|---|");
    let counts = [10, 30, 100, 300, 1000];
    let rows = counts.iter().filter(|&&n| n <= cli.views).map(|&n| views(n));
    print_fit("views", &rows.collect::<Result<Vec<_>>>()?);
    Ok(())
}

/// Full steps on `n` Gaussians and pictures of w × h; `size` is what the row is about.
fn step(cli: &Cli, n: usize, w: usize, h: usize, size: usize) -> Result<Row> {
    let before = memory("VmRSS:");
    reset_peak();
    let mut backend = ProfiledProcessor::new(Model::from_gaussians(&shells(n)), cpu_seconds)?;
    let rgb: Vec<u8> = (0..w * h * 3).map(|i| (i * 37 % 251) as u8).collect();
    let (mut start, mut pairs) = (backend.times(), 0);
    for k in 0..cli.steps + 1 {
        if k == 1 {
            start = backend.times();
        }
        let view = camera(k, w as u32, h as u32);
        let out = backend.step(&StepInput {
            view: &NormalisedFrame { centre: DVec3::ZERO, scale: 1.0 }.view(&view.0, &view.1),
            target: Target { rgb: &rgb, mask: None, transparent: false, photo: None },
            options: RenderOptions::default(),
            rates: LearningRates::default(),
            lambda_dssim: 0.2,
        })?;
        pairs = out.pairs;
    }
    let (now, each) = (backend.times(), 1e3 / cli.steps as f64);
    let by_stage = [
        now.project - start.project,
        now.sort - start.sort,
        now.forward - start.forward,
        now.loss - start.loss,
        now.backward - start.backward,
        now.optimise - start.optimise,
    ]
    .map(|s| s * each);
    let (sum, mib) = (by_stage.iter().sum::<f64>(), memory("VmHWM:") - before);
    let stages = by_stage.map(|v| format!("{v:.1}")).join(" | ");
    println!("| {size} | {pairs} | {sum:.1} | {stages} | {mib:.0} |");
    Ok((size as f64, sum, mib))
}

/// A short training on `n` views.
fn views(n: usize) -> Result<Row> {
    const STEPS: u32 = 150;
    let before = memory("VmRSS:");
    reset_peak();
    let normalisation = NormalisedFrame { centre: DVec3::ZERO, scale: 1.0 };
    let view = |k: usize| {
        let (camera, pose) = camera(k, 320, 240);
        let rgb = (0..320 * 240 * 3).map(|i| ((i + k) * 37 % 251) as u8).collect();
        let levels = pyramid(Pixels { width: 320, height: 240, rgb, mask: None });
        let view = normalisation.view(&camera, &pose);
        View { name: format!("{k:05}"), camera, pose, view, levels, held_out: false }
    };
    let points = shells(10_000).means.into_iter().map(|m| (m, [128; 3])).collect();
    let views = (0..n).map(view).collect();
    let dataset = Dataset { views, points, normalisation, alpha: AlphaMode::Transparent, articulation: None };
    let cpu = cpu_seconds();
    let config = TrainConfig { iterations: STEPS, max_gaussians: 10_000, ..TrainConfig::default() };
    train(&dataset, &config, None, &Progress::silent())?;
    let row = (n as f64, 1e3 * (cpu_seconds() - cpu) / f64::from(STEPS), memory("VmHWM:") - before);
    println!("| {n} | {:.1} | {:.0} |", row.1, row.2);
    Ok(row)
}

/// Gaussians on ten shells within the unit ball, of the size at which neighbours touch.
fn shells(n: usize) -> Gaussians {
    let mut rng = scene::rng::rng(1, "growth", 0);
    let mut direction = || Vec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0f32..1.0)));
    let means: Vec<Vec3> =
        (0..n).map(|i| direction().normalize_or(Vec3::X) * (0.1 + 0.1 * (i % 10) as f32)).collect();
    let size = (1.5 / (n as f32 / 10.0).sqrt()).ln();
    Gaussians {
        log_scales: vec![Vec3::new(size, size - 0.4, size - 1.5); n],
        rotations: means.iter().map(|m| Quat::from_rotation_arc(Vec3::Z, m.normalize_or(Vec3::Z))).collect(),
        opacity_logits: vec![0.0; n],
        sh: (0..n * 48).map(|i| ((i * 29 % 101) as f32 / 101.0 - 0.5) * 0.1).collect(),
        sh_degree: 3,
        means,
    }
}

fn camera(k: usize, w: u32, h: u32) -> (Camera, Pose) {
    let angle = 2.4 * k as f64;
    let eye = 3.0 * DVec3::new(angle.cos(), angle.sin(), 0.4).normalize();
    (
        Camera::centred(1, CameraModel::Pinhole, w, h, 1.2 * f64::from(h)),
        Pose::look_at(eye, DVec3::ZERO, DVec3::Z),
    )
}

/// Exponents of the upper half of the rows, by least squares of the logarithms.
fn print_fit(what: &str, rows: &[Row]) {
    let upper = &rows[rows.len() / 2..];
    let slope = |pick: fn(&Row) -> f64| {
        let points: Vec<(f64, f64)> = upper.iter().map(|r| (r.0.ln(), pick(r).max(1e-9).ln())).collect();
        let n = points.len() as f64;
        let (mx, my) =
            (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
        let (sxy, sxx) =
            points.iter().fold((0.0, 0.0), |s, p| (s.0 + (p.0 - mx) * (p.1 - my), s.1 + (p.0 - mx).powi(2)));
        sxy / sxx
    };
    println!("time ∝ {what}^{:.2}, memory ∝ {what}^{:.2}", slope(|r| r.1), slope(|r| r.2));
}

/// A figure of /proc/self/status, MiB (0 where there is none).
fn memory(key: &str) -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|l| l.starts_with(key)).unwrap_or("");
    line.split_whitespace().nth(1).and_then(|v| v.parse::<f64>().ok()).unwrap_or(0.0) / 1024.0
}

fn reset_peak() {
    let _ = std::fs::write("/proc/self/clear_refs", "5"); // not on every kernel: then the peak is the process's
}
