//! What each choice of the trainer is worth: the same data set trained within the same time with
//! one choice changed. `cargo run --release -p splat --example ablation -- DATASET_DIR --budget
//! 20s,60s [--only TEXT]` prints a table of PSNR on the held-out views (8-bit renders, transparent
//! pixels over black).

use clap::Parser;
use glam::{Mat3, Quat, Vec3};
use image::{Rgb, RgbImage};
use rand::Rng as _;
use scene::Progress;
use splat::{
    Dataset, DatasetConfig, PoseRefinement, RenderOptions, Renderer, TrainConfig, TrainResult, train,
};
use std::path::PathBuf;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error + Send + Sync>>;

#[derive(Parser)]
struct Cli {
    dataset: PathBuf,
    /// Time of each training, one column each
    #[arg(long, value_delimiter = ',', value_parser = splat::config::parse_duration, default_value = "20s")]
    budget: Vec<f64>,
    /// Instead of a time: so many steps, one column each
    #[arg(long, value_delimiter = ',')]
    steps: Vec<u32>,
    /// Only rows whose name contains this
    #[arg(long, default_value = "")]
    only: String,
    /// Masks beside the photos, where they are not in them
    #[arg(long)]
    masks: Option<PathBuf>,
    /// Train at half the resolution: held-out views are then seen from twice as near as anything
    /// that was trained on
    #[arg(long)]
    zoom: bool,
    /// Poses of the training views off by so many degrees, as a solver leaves them: what they look
    /// at stays in the middle
    #[arg(long, default_value_t = 0.0)]
    wrong_poses: f64,
    #[command(flatten)]
    data: DatasetConfig,
}

/// Name of the row, what it changes.
type Row = (&'static str, fn(&mut TrainConfig));

fn rows() -> Vec<Row> {
    vec![
        ("as it is", |_| {}),
        ("full resolution throughout", |c| c.coarse_levels = 0),
        ("spherical harmonics of degree 0", |c| c.sh_degree = 0),
        ("poses never refined", |c| c.refine_poses = PoseRefinement::Off),
        ("poses refined in any case", |c| c.refine_poses = PoseRefinement::On),
        ("L1 alone", |c| c.lambda_dssim = 0.0),
        ("a quarter of D-SSIM's weight", |c| c.lambda_dssim *= 0.25),
        ("opacity scaled with the low-pass", |c| c.antialias = true),
        ("scales held to the views' sampling", |c| c.smoothing = true),
        ("both (Mip-Splatting)", |c| (c.smoothing, c.antialias) = (true, true)),
    ]
}

/// Moves the training views by turns of `degrees` about each axis (uniform, that standard
/// deviation); they shift along to keep what they look at, but for a third of that.
fn misplace(dataset: &mut Dataset, degrees: f64) {
    for (k, view) in dataset.views.iter_mut().enumerate().filter(|(_, v)| !v.held_out) {
        let mut rng = scene::rng::rng(0, "wrong poses", k as u64);
        let mut off = || (degrees.to_radians() * 3.0f64.sqrt() * rng.random_range(-1.0..1.0)) as f32;
        let turn = Vec3::new(off(), off(), off());
        let distance = view.view.translation.z;
        let shift = 0.3 * Vec3::new(off(), off(), off()) + distance * Vec3::new(-turn.y, turn.x, 0.0);
        let turn = Mat3::from_quat(Quat::from_scaled_axis(turn));
        view.view.translation = turn * view.view.translation + shift;
        view.view.rotation = turn * view.view.rotation;
    }
}

/// The same views without their full resolution.
fn halved(dataset: &Dataset) -> Dataset {
    let mut coarse = dataset.clone();
    for view in coarse.views.iter_mut().filter(|v| v.levels.len() > 1) {
        view.view = view.view.at_level(1);
        view.levels.remove(0);
    }
    coarse
}

fn main() -> Result<()> {
    let cli = Cli::parse();
    let model = match scene::io::find_model(&cli.dataset) {
        Some(path) => scene::io::read_model(&path)?,
        None => scene::io::read_transforms(&cli.dataset.join("transforms.json"))?.reconstruction,
    };
    let images = Some(cli.dataset.join("images")).filter(|_| cli.dataset.join("sparse").is_dir());
    let images = images.unwrap_or(cli.dataset.clone());
    let dataset = Dataset::load(&images, cli.masks.as_deref(), &model, &cli.data, &Progress::silent())?;
    let mut seen = if cli.zoom { halved(&dataset) } else { dataset.clone() };
    if cli.wrong_poses > 0.0 {
        misplace(&mut seen, cli.wrong_poses);
    }
    let columns: Vec<Column> = match &cli.steps[..] {
        [] => cli.budget.iter().map(|&b| Column::Seconds(b)).collect(),
        steps => steps.iter().map(|&n| Column::Steps(n)).collect(),
    };
    println!("| | {} |", columns.iter().map(Column::name).collect::<Vec<_>>().join(" | "));
    println!("|---|{}", "---|".repeat(columns.len()));
    for (name, change) in rows().into_iter().filter(|r| r.0.contains(&cli.only)) {
        print!("| {name} |");
        for column in &columns {
            let mut config = column.config();
            change(&mut config);
            let cpu = scene::clock::cpu_seconds();
            let result = train(&seen, &config, None, &Progress::silent())?;
            let cpu = scene::clock::cpu_seconds() - cpu;
            for told in result.decisions.iter().map(|d| d.sentences()) {
                eprintln!("{name}: {told} ({})", told.evidence.join("; "));
            }
            let score = score(&dataset, &result)?;
            print!(
                " {:.2} dB {:.4} (worst {:.2}; {} steps, {:.1} k, {cpu:.0} s) |",
                score.psnr,
                score.ssim,
                score.least,
                result.iterations,
                result.gaussians.len() as f64 / 1e3
            );
            use std::io::Write;
            std::io::stdout().flush()?;
        }
        println!();
    }
    Ok(())
}

/// How long each row is trained.
enum Column {
    Seconds(f64),
    Steps(u32),
}

impl Column {
    fn name(&self) -> String {
        match self {
            Self::Seconds(s) => format!("{s} s"),
            Self::Steps(n) => format!("{n} steps"),
        }
    }

    fn config(&self) -> TrainConfig {
        let mut config = TrainConfig { max_gaussians: 400_000, ..TrainConfig::default() };
        match self {
            Self::Seconds(s) => config.time_limit = Some(*s),
            Self::Steps(n) => config.iterations = *n,
        }
        config
    }
}

/// Over the held-out views.
struct Score {
    psnr: f64,
    ssim: f64,
    least: f64,
}

fn score(dataset: &Dataset, result: &TrainResult) -> Result<Score> {
    let mut renderer = Renderer::new(&result.gaussians)?;
    let mut scores = Vec::new();
    for view in dataset.views.iter().filter(|v| v.held_out) {
        let options = RenderOptions { background: [0.0; 3], ..result.render };
        let rendered = renderer.render(&view.camera, &view.pose, &options)?.rgb.to_rgb8();
        let pixels = &view.levels[0];
        let photo = RgbImage::from_fn(rendered.width(), rendered.height(), |x, y| {
            let i = y as usize * pixels.width + x as usize;
            let a = pixels.mask.as_ref().map_or(1.0, |m| f32::from(m[i]) / 255.0);
            Rgb([0, 1, 2].map(|c| (f32::from(pixels.rgb[i * 3 + c]) * a).round() as u8))
        });
        scores.push([
            scene::metrics::psnr(&photo, &rendered, None)?,
            scene::metrics::ssim(&photo, &rendered, None)?,
        ]);
    }
    let mean = |k: usize| scores.iter().map(|s| s[k]).sum::<f64>() / scores.len().max(1) as f64;
    Ok(Score {
        psnr: mean(0),
        ssim: mean(1),
        least: scores.iter().map(|s| s[0]).fold(f64::INFINITY, f64::min),
    })
}
