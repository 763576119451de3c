//! `bench`: quality against time. The same input trained at several presets and time limits; a
//! table, JSON and charts of PSNR, SSIM (and LPIPS) against wall time, CPU time, Gaussians and
//! memory, what is known of other tools beside.

mod charts;
mod peers;
mod point;

pub(crate) use point::Point;

use crate::args::BenchArgs;
use crate::config;
use crate::evaluate::metrics::number;
use crate::input::Input;
use crate::outcome::Outcome;
use crate::pipeline::{Pipeline, Until};
use crate::record::RunRecord;
use crate::stage::{Done, StageSpec, Stages, describe_input, fingerprint, write_json, write_whole};
use crate::terminal::{Verbosity, print, say};
use anyhow::{Context, Result, bail};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// The build that measures: points of another one are measured again.
const PROGRAM: [&str; 4] =
    [env!("CARGO_PKG_VERSION"), env!("FRAMES_SOURCES"), env!("SFM_SOURCES"), env!("SPLAT_SOURCES")];

/// What `bench.json` holds.
#[derive(Debug, Serialize)]
struct Sweep {
    version: &'static str,
    input: PathBuf,
    cores: usize,
    flags: Vec<String>,
    protocol: String,
    points: Vec<Point>,
    peers: Vec<Point>,
    peers_source: Option<String>,
}

/// A preset, or a time limit.
enum Setting {
    Quality(splat::Quality),
    Limit(f64),
}

impl Setting {
    /// The flags that say it. A limit has the preset `best` for what is not time: it bounds nothing
    /// else.
    fn flags(&self) -> Vec<String> {
        match self {
            Self::Quality(quality) => vec![format!("--quality={}", name(*quality))],
            Self::Limit(seconds) => vec!["--quality=best".into(), format!("--time-limit={seconds}")],
        }
    }

    fn name(&self) -> String {
        match self {
            Self::Quality(quality) => name(*quality),
            Self::Limit(seconds) => format!("{seconds} s"),
        }
    }
}

fn name(quality: splat::Quality) -> String {
    format!("{quality:?}").to_lowercase()
}

/// Measures all points (those that an earlier call measured are kept), writes `bench.json` and
/// `bench.svg`.
pub(crate) fn run(args: &BenchArgs, global: &crate::args::Global, verbosity: Verbosity) -> Result<Outcome> {
    let presets = args.qualities.iter().filter(|_| !args.only_times);
    let mut settings: Vec<Setting> = presets.map(|q| Setting::Quality(*q)).collect();
    settings.extend(args.times.iter().map(|t| Setting::Limit(*t)));
    if settings.is_empty() {
        bail!("nothing to measure: --only-times needs --times");
    }
    let out = args.output.clone().unwrap_or_else(|| default_output(&args.input));
    // Nothing is made for an input that is not there.
    Input::detect(&args.input, true)?;
    let known_peers = peers::of(&args.input, args.peers.as_deref())?;
    let stages = Stages::open(&out)?;
    let mut sweep = Sweep {
        version: env!("CARGO_PKG_VERSION"),
        input: args.input.clone(),
        cores: std::thread::available_parallelism().map_or(1, usize::from),
        flags: args.flags.clone(),
        protocol: String::new(),
        points: Vec::new(),
        peers: Vec::new(),
        peers_source: None,
    };
    if let Some((peers, source)) = known_peers {
        (sweep.peers, sweep.peers_source) = (peers, Some(source));
    }
    for setting in &settings {
        let told: Vec<String> = setting.flags().into_iter().chain(args.flags.iter().cloned()).collect();
        let print = fingerprint(&("bench", 3, PROGRAM, &told, describe_input(&args.input)?))?;
        let stage = format!("bench-{}", setting.name().replace(' ', ""));
        let stage = StageSpec { name: &stage, fingerprint: &print, owns: &[] };
        let Done { finished, ran, .. } =
            stages.run(&stage, |_| measure(&args.input, &stages, &setting.name(), &told, verbosity))?;
        if verbosity > Verbosity::Quiet {
            say(&format!("{} ({})", row(&finished.value.0), if ran { "measured" } else { "as before" }));
        }
        sweep.points.push(finished.value.0);
        sweep.protocol = finished.value.1;
        write_json(&out.join("bench.json"), &sweep)?;
    }
    write_whole(&out.join("bench.svg"), charts::draw(&sweep.points, &sweep.peers)?.as_bytes())?;
    if global.json {
        print(&serde_json::to_string_pretty(&sweep)?)?;
    } else {
        print_table(&sweep)?;
    }
    if verbosity > Verbosity::Quiet {
        say(&format!("in {}: bench.svg, bench.json", out.display()));
    }
    Ok(Outcome::Done)
}

/// Trains with the flags and evaluates, into the folder that all points share: frames and poses are
/// made once.
fn measure(
    input: &Path,
    stages: &Stages,
    setting: &str,
    flags: &[String],
    verbosity: Verbosity,
) -> Result<(Point, String)> {
    let mut argv =
        vec!["sat-recon".to_owned(), "eval".into(), utf8(input)?, "-o".into(), utf8(stages.out())?];
    argv.extend(flags.iter().cloned());
    let parsed = match config::parse(argv)? {
        Ok(parsed) => parsed,
        Err(usage) => bail!("{usage}"),
    };
    let crate::args::Command::Eval(args) = parsed.cli.command else { bail!("only flags may follow --") };
    let pipeline = Pipeline::within(stages.clone(), *args, parsed.recorded, verbosity, false)?;
    let (outcome, record) = pipeline.run_recorded(Until::Eval)?;
    if outcome == Outcome::NoModel {
        bail!("no poses were found, so that there is nothing to train on");
    }
    let (mut point, protocol) = point(setting, &record)?;
    // Radiance fields have none.
    if let Ok(splat) = scene::io::read_splat(&stages.out().join("splat.ply")) {
        point.sog_bytes = packed(&splat, stages.out(), "sog");
        point.spz_bytes = packed(&splat, stages.out(), "spz");
    }
    Ok((point, protocol))
}

/// The size of a splat in a format; none where the format cannot hold it.
fn packed(splat: &scene::Gaussians, folder: &Path, extension: &str) -> Option<u64> {
    let file = folder.join(format!("bench.{extension}"));
    scene::io::write_splat(&file, splat).ok()?;
    let bytes = std::fs::metadata(&file).ok().map(|m| m.len());
    let _ = std::fs::remove_file(file);
    bytes
}

fn utf8(path: &Path) -> Result<String> {
    path.to_str().map(str::to_owned).context("the path is not UTF-8")
}

fn point(setting: &str, record: &RunRecord) -> Result<(Point, String)> {
    let (Some(splat), Some(evaluation)) = (&record.splat, &record.evaluation) else {
        bail!("the run ended before it was evaluated");
    };
    if evaluation.views.is_empty() {
        bail!("no views are held out; --test-every must not be 0");
    }
    let cost = record.costs.iter().find(|(stage, _)| stage == "train").map(|(_, cost)| cost);
    let mean = &evaluation.mean;
    let worst = evaluation.views.iter().map(|v| v.metrics.psnr).fold(f64::INFINITY, f64::min);
    let point = Point {
        method: "sat-recon".into(),
        setting: setting.to_owned(),
        wall_s: cost.map(|c| c.wall_s),
        cpu_s: cost.map(|c| c.cpu_s),
        gaussians: Some(splat.gaussians),
        sog_bytes: None,
        spz_bytes: None,
        peak_mib: cost.map(|c| c.peak_mib).filter(|&mib| mib > 0.0),
        psnr: mean.psnr,
        psnr_worst: Some(worst),
        ssim: Some(mean.ssim),
        lpips: mean.lpips_alex.or(mean.lpips_vgg),
    };
    Ok((point, evaluation.protocol.clone()))
}

fn row(p: &Point) -> String {
    format!(
        "| {} | {} | {} | {} | {} | {} | {:.2} | {} | {} | {} |",
        p.method,
        p.setting,
        number(p.wall_s, 1),
        number(p.cpu_s, 1),
        p.gaussians.map_or("–".to_owned(), |n| n.to_string()),
        number(p.peak_mib, 0),
        p.psnr,
        number(p.psnr_worst, 2),
        number(p.ssim, 4),
        number(p.lpips, 4)
    )
}

fn print_table(sweep: &Sweep) -> Result<()> {
    print("| tool | setting | wall s | CPU s | gaussians | peak MiB | PSNR | worst view | SSIM | LPIPS |")?;
    print("|---|---|---|---|---|---|---|---|---|---|")?;
    sweep.points.iter().chain(&sweep.peers).try_for_each(|p| print(&row(p)))
}

fn default_output(input: &Path) -> PathBuf {
    let absolute = std::path::absolute(input).unwrap_or_else(|_| input.to_path_buf());
    let stem = absolute.file_stem().map_or_else(|| "scene".into(), |s| s.to_string_lossy().into_owned());
    PathBuf::from(format!("{stem}_bench"))
}
