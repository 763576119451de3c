//! `compare`: models beside each other and beside a ground truth, COLMAP on the same frames, and
//! the tables of papers.

mod colmap;
mod page;
pub mod runs;
pub mod tables;

use tables::Cells;

use crate::args::CompareArgs;
use crate::evaluate::metrics::number;
use crate::outcome::Outcome;
use crate::record::KnownRun;
use crate::stage::{write_json, write_whole};
use crate::terminal::{Verbosity, print};
use anyhow::{Context, Result};
use scene::sim3::{AUC_THRESHOLDS_DEG, PoseErrors, compare_poses};
use scene::{FrameSet, Reconstruction};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

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
    /// Of solving the poses: CPU seconds and peak memory.
    cpu_s: Option<f64>,
    peak_mib: Option<f64>,
    /// Against the run whose frames COLMAP was given, after alignment.
    agreement: Option<Agreement>,
}

/// How far two models of the same images differ.
#[derive(Debug, Serialize)]
struct Agreement {
    /// Images with a pose in both.
    common: usize,
    rotation_median_deg: f64,
    rotation_max_deg: f64,
    /// Per cent of the extent of the run's camera centres.
    centre_median_pct: f64,
    centre_max_pct: f64,
}

/// Prints a line for each model, then the tables of the runs that were evaluated.
pub(crate) fn run(args: &CompareArgs, verbosity: Verbosity, json: bool) -> Result<Outcome> {
    let truth = args.truth.as_deref().map(read_truth).transpose()?;
    let colmap = args.colmap.then(colmap::installed).transpose()?;
    let mut rows = Vec::new();
    let named: Vec<runs::Named> = args.runs.iter().map(|text| runs::Named::parse(text)).collect();
    for runs::Named { label, path: run } in &named {
        let path = model_folder(run);
        if label.is_some() && !scene::io::has_model(&path) {
            continue; // renders of another tool
        }
        let model = scene::io::read_model(&path)?;
        let frames = frames_of(run)?;
        let asked = frames.as_ref().map(names);
        let mut ours = row(run.display().to_string(), &model, truth.as_ref(), asked.as_ref());
        (ours.cpu_s, ours.peak_mib) = cost(run).unzip();
        rows.push(ours);
        let Some(colmap) = &colmap else { continue };
        let models = colmap::run(colmap, run, frames.as_ref(), verbosity)?;
        rows.extend(beside(&models, &model, truth.as_ref(), asked.as_ref())?);
    }
    let networks = crate::evaluate::load_networks(&args.lpips_weights)?;
    let entries = runs::entries(&named, &networks)?;
    let beside: Vec<_> = args.beside.iter().map(|path| runs::read_tables(path)).collect::<Result<_>>()?;
    let tables = runs::tables(&entries, &beside.concat());
    if json {
        print(&serde_json::to_string_pretty(&rows)?)?;
    } else {
        print(&pose_table(&rows))?;
        tables.iter().try_for_each(|table| print(&format!("\n{}", table.markdown())))?;
    }
    if let Some(folder) = &args.tables {
        write_tables(folder, &tables)?;
    }
    if let Some(file) = &args.report {
        page::write(file, &entries, &pose_cells(&rows), &tables)?;
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

/// COLMAP's models of the frames of a run, the largest first; one empty line where it found none.
fn beside(
    models: &colmap::Models,
    ours: &Reconstruction,
    truth: Option<&Reconstruction>,
    asked: Option<&BTreeSet<String>>,
) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for folder in &models.folders {
        let model = scene::io::read_model(folder)?;
        let mut row = row(models.name.clone(), &model, truth, asked);
        row.agreement = agreement(&compare_poses(&model, ours));
        rows.push(row);
    }
    if rows.is_empty() {
        let name = format!("{}: no model", models.name);
        rows.push(row(name, &Reconstruction::default(), truth, asked));
    }
    rows.sort_by_key(|row| std::cmp::Reverse(row.registered));
    for (i, row) in rows.iter_mut().enumerate() {
        (row.cpu_s, row.peak_mib) = (Some(models.spent.cpu_s), Some(models.spent.peak_mib));
        if i > 0 {
            row.name = format!("{}, model {}", models.name, i + 1);
        }
    }
    Ok(rows)
}

fn agreement(errors: &PoseErrors) -> Option<Agreement> {
    let (rotation, centre) = (errors.rotation_deg.as_ref()?, errors.centre_pct.as_ref()?);
    Some(Agreement {
        common: errors.registered,
        rotation_median_deg: rotation.median,
        rotation_max_deg: rotation.max,
        centre_median_pct: centre.median,
        centre_max_pct: centre.max,
    })
}

/// CPU seconds and peak MiB of the stage that solved the poses of a run.
fn cost(run: &Path) -> Option<(f64, f64)> {
    let known = KnownRun::read(run).ok()?;
    if known.poses.as_ref().is_some_and(|p| p.imported) {
        return None;
    }
    known.cost("poses").map(|cost| (cost.cpu_s, cost.peak_mib))
}

/// The frames that a run was given.
fn frames_of(run: &Path) -> Result<Option<FrameSet>> {
    Ok(crate::stage::last::<FrameSet>(run, "frames")?.map(|finished| finished.value))
}

/// Their names without extension: those that were not registered count as failures.
fn names(frames: &FrameSet) -> BTreeSet<String> {
    frames.frames.iter().map(|f| stem(&f.name)).collect()
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
    let total = asked.map_or(model.images.len(), BTreeSet::len);
    let mut row = Row {
        name,
        registered: model.images.len(),
        total,
        points: model.points.len(),
        reprojection_px: model.mean_reprojection_error(),
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
        "CPU s",
        "peak MiB",
    ];
    (heads, rows.iter().map(cells_of_row).collect())
}

fn cells_of_row(row: &Row) -> Vec<String> {
    let auc = row.auc.as_ref().map_or("–".to_owned(), |auc| {
        let percents = AUC_THRESHOLDS_DEG.iter().map(|t| auc.get(&t.to_string()).copied().unwrap_or(0.0));
        percents.map(|percent| format!("{percent:.1}")).collect::<Vec<_>>().join(" / ")
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
        number(row.cpu_s, 1),
        number(row.peak_mib, 0),
    ]
}

fn pose_table(rows: &[Row]) -> String {
    let (heads, cells) = pose_cells(rows);
    let heading = [format!("| {} |", heads.join(" | ")), format!("|{}", "---|".repeat(heads.len()))];
    let lines = heading.into_iter().chain(cells.iter().map(|row| format!("| {} |", row.join(" | "))));
    lines.chain(rows.iter().filter_map(agreement_line)).collect::<Vec<_>>().join("\n")
}

/// How far a model lies from the run whose frames it was given.
fn agreement_line(row: &Row) -> Option<String> {
    let a = row.agreement.as_ref()?;
    Some(format!(
        "\n{} against ours, after alignment: {} common images, rotation median {:.3}° (max {:.3}°), centres median {:.3} % (max {:.3} %) of the extent.",
        row.name, a.common, a.rotation_median_deg, a.rotation_max_deg, a.centre_median_pct, a.centre_max_pct
    ))
}
