//! `compare`: models beside each other and beside a ground truth, COLMAP on the same frames, and the tables of papers.

pub mod runs;
pub mod tables;

use crate::Outcome;
use crate::cli::CompareArgs;
use crate::stage::{write_json, write_whole};
use crate::terminal::Verbosity;
use anyhow::{Context, Result, bail};
use scene::Reconstruction;
use scene::sim3::{AUC_THRESHOLDS_DEG, PoseErrors, compare_poses};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// One line of the table.
#[derive(Debug, Default, Serialize)]
struct Row {
    name: String,
    registered: usize,
    total: usize,
    points: usize,
    reprojection_px: f64,
    auc: Option<BTreeMap<String, f64>>,
    rotation_median_deg: Option<f64>,
    rotation_max_deg: Option<f64>,
    centre_median_pct: Option<f64>,
    centre_max_pct: Option<f64>,
    focal_err_pct: Option<f64>,
}

/// Prints a line for each model, then the tables of the runs that were evaluated.
pub fn run(args: &CompareArgs, verbosity: Verbosity, json: bool) -> Result<Outcome> {
    let truth = args.truth.as_deref().map(read_truth).transpose()?;
    let mut rows = Vec::new();
    let named: Vec<runs::Named> = args.runs.iter().map(|text| runs::Named::parse(text)).collect();
    for runs::Named { label, path: run } in &named {
        let path = model_folder(run);
        if label.is_some() && !scene::io::has_model(&path) {
            continue; // renders of another tool
        }
        let model = scene::io::read_model(&path)?;
        let asked = frame_names(run);
        rows.push(row(run.display().to_string(), &model, truth.as_ref(), asked.as_ref()));
        if args.colmap {
            for (i, folder) in run_colmap(run, verbosity)?.iter().enumerate() {
                let model = scene::io::read_model(folder)?;
                rows.push(row(
                    format!("COLMAP model {i} of {}", run.display()),
                    &model,
                    truth.as_ref(),
                    asked.as_ref(),
                ));
            }
        }
    }
    let networks = crate::evaluate::load_networks(&args.lpips_weights)?;
    let entries = runs::entries(&named, &networks)?;
    let beside: Vec<_> = args.beside.iter().map(|path| runs::read_tables(path)).collect::<Result<_>>()?;
    let tables = runs::tables(&entries, &beside.concat());
    if json {
        println!("{}", serde_json::to_string_pretty(&rows)?);
    } else {
        println!("{}", pose_table(&rows));
        tables.iter().for_each(|table| println!("\n{}", table.markdown()));
    }
    if let Some(folder) = &args.tables {
        write_tables(folder, &tables)?;
    }
    if let Some(file) = &args.report {
        crate::report::write_comparison(file, &entries, &pose_cells(&rows), &tables)?;
    }
    Ok(Outcome::Done)
}

/// The tables as `tables.{md,csv,tex,json}`.
fn write_tables(folder: &Path, tables: &[tables::Table]) -> Result<()> {
    anyhow::ensure!(!tables.is_empty(), "none of the runs was evaluated: run sat-recon eval on them first");
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let all = |form: fn(&tables::Table) -> String| tables.iter().map(form).collect::<Vec<_>>().join("\n");
    for (name, text) in [
        ("tables.md", all(tables::Table::markdown)),
        ("tables.csv", all(tables::Table::csv)),
        ("tables.tex", all(tables::Table::latex)),
    ] {
        write_whole(&folder.join(name), text.as_bytes())?;
    }
    write_json(&folder.join("tables.json"), &tables)
}

/// A ground truth in any of its formats.
fn read_truth(path: &Path) -> Result<Reconstruction> {
    let is_json = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"));
    if is_json {
        Ok(scene::io::read_transforms(path)?.reconstruction)
    } else {
        Ok(scene::io::read_truth(path)?)
    }
}

fn model_folder(run: &Path) -> PathBuf {
    let inner = run.join("sparse/0");
    if inner.is_dir() { inner } else { run.to_path_buf() }
}

/// The frames that a run was given, without extension: those it did not register count as failures.
fn frame_names(run: &Path) -> Option<BTreeSet<String>> {
    let frames: crate::stage::Finished<scene::FrameSet> =
        serde_json::from_slice(&std::fs::read(run.join(".stages/frames.json")).ok()?).ok()?;
    Some(frames.value.frames.iter().map(|f| stem(&f.name)).collect())
}

fn stem(name: &str) -> String {
    Path::new(name).file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default()
}

fn row(
    name: String,
    model: &Reconstruction,
    truth: Option<&Reconstruction>,
    asked: Option<&BTreeSet<String>>,
) -> Row {
    let errors = model.reprojection_errors();
    let total = asked.map_or(model.images.len(), BTreeSet::len);
    let mut row = Row {
        name,
        registered: model.images.len(),
        total,
        points: model.points.len(),
        reprojection_px: errors.iter().sum::<f64>() / errors.len().max(1) as f64,
        ..Row::default()
    };
    if let Some(truth) = truth {
        let mut truth = truth.clone();
        if let Some(asked) = asked {
            truth.images.retain(|_, image| asked.contains(&stem(&image.name)));
        }
        fill(&mut row, &compare_poses(model, &truth));
    }
    row
}

fn fill(row: &mut Row, errors: &PoseErrors) {
    row.registered = errors.registered;
    row.total = errors.total;
    row.auc = errors.auc.map(|auc| AUC_THRESHOLDS_DEG.iter().map(f64::to_string).zip(auc).collect());
    row.rotation_median_deg = errors.rotation_deg.as_ref().map(|s| s.median);
    row.rotation_max_deg = errors.rotation_deg.as_ref().map(|s| s.max);
    row.centre_median_pct = errors.centre_pct.as_ref().map(|s| s.median);
    row.centre_max_pct = errors.centre_pct.as_ref().map(|s| s.max);
    row.focal_err_pct = errors.focal_err_pct;
}

/// Heading and rows of the table of poses.
pub type Cells = (Vec<&'static str>, Vec<Vec<String>>);

fn pose_cells(rows: &[Row]) -> Cells {
    let heads = vec![
        "model",
        "registered",
        "points",
        "px",
        "AUC@1 / 3 / 5 / 10",
        "rotation median / max",
        "centre median / max, %",
        "focal, %",
    ];
    let number = |v: Option<f64>, digits: usize| v.map_or("–".to_owned(), |v| format!("{v:.digits$}"));
    let cells = |row: &Row| {
        let auc = row.auc.as_ref().map_or("–".to_owned(), |auc| {
            let at = |t: &f64| format!("{:.1}", auc.get(&t.to_string()).copied().unwrap_or(0.0));
            AUC_THRESHOLDS_DEG.iter().map(at).collect::<Vec<_>>().join(" / ")
        });
        let degrees = [row.rotation_median_deg, row.rotation_max_deg].map(|v| number(v, 3));
        let centres = [row.centre_median_pct, row.centre_max_pct].map(|v| number(v, 3));
        vec![
            row.name.clone(),
            format!("{} of {}", row.registered, row.total),
            row.points.to_string(),
            format!("{:.2}", row.reprojection_px),
            auc,
            format!("{}° / {}°", degrees[0], degrees[1]),
            centres.join(" / "),
            number(row.focal_err_pct, 2),
        ]
    };
    (heads, rows.iter().map(cells).collect())
}

fn pose_table(rows: &[Row]) -> String {
    let (heads, rows) = pose_cells(rows);
    let line = |cells: &[String]| format!("| {} |", cells.join(" | "));
    let heading = [format!("| {} |", heads.join(" | ")), format!("|{}", "---|".repeat(heads.len()))];
    heading.into_iter().chain(rows.iter().map(|r| line(r))).collect::<Vec<_>>().join("\n")
}

/// Runs the installed COLMAP with its defaults (one camera, no GPU) on the frames of a run; its models.
fn run_colmap(run: &Path, verbosity: Verbosity) -> Result<Vec<PathBuf>> {
    let images = run.join("images");
    if !images.is_dir() {
        bail!("{} has no images/ for COLMAP to run on; name an output folder of sat-recon", run.display());
    }
    let folder = run.join(".stages/colmap");
    if folder.exists() {
        std::fs::remove_dir_all(&folder).with_context(|| format!("cannot clear {}", folder.display()))?;
    }
    let sparse = folder.join("sparse");
    std::fs::create_dir_all(&sparse).with_context(|| format!("cannot make {}", sparse.display()))?;
    let database = folder.join("database.db");
    let steps: [(&str, Vec<(&str, &Path)>, Vec<&str>); 3] = [
        (
            "feature_extractor",
            vec![("--image_path", &images)],
            vec!["--ImageReader.single_camera", "1", "--SiftExtraction.use_gpu", "0"],
        ),
        ("exhaustive_matcher", vec![], vec!["--SiftMatching.use_gpu", "0"]),
        ("mapper", vec![("--image_path", &images), ("--output_path", &sparse)], vec![]),
    ];
    for (step, paths, flags) in steps {
        if verbosity > Verbosity::Quiet {
            eprintln!("colmap {step}");
        }
        let mut command = Command::new("colmap");
        command
            .arg(step)
            .arg("--database_path")
            .arg(&database)
            .args(flags)
            .env("QT_QPA_PLATFORM", "offscreen");
        for (flag, path) in paths {
            command.arg(flag).arg(path);
        }
        let status = command.stdout(Stdio::null()).stderr(Stdio::null()).status();
        let status = status.context("colmap is not installed (Debian: apt-get install colmap)")?;
        anyhow::ensure!(status.success(), "colmap {step} failed on {}", images.display());
    }
    let mut models: Vec<PathBuf> = std::fs::read_dir(&sparse)?.filter_map(|e| Some(e.ok()?.path())).collect();
    models.sort();
    Ok(models)
}
