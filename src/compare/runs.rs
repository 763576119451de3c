//! Runs (and renders of other tools) as entries of the tables.

use super::tables::{Column, Table};
use crate::evaluate::{Evaluation, Metrics};
use anyhow::{Context, Result, bail};
use scene::metrics;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// What one method gave on one case.
#[derive(Clone, Debug)]
pub struct Entry {
    method: String,
    case: String,
    quality: Metrics,
    training: [Option<f64>; 4],
    rendering: [Option<f64>; 4],
}

/// `METHOD:CASE=PATH`, or a path alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Named {
    /// Method and case.
    pub label: Option<(String, String)>,
    /// A run folder, a model, or a folder of renders.
    pub path: PathBuf,
}

impl Named {
    /// Splits the label off. A path that exists is a path, whatever it is called.
    pub fn parse(text: &str) -> Self {
        let plain = Self { label: None, path: PathBuf::from(text) };
        if plain.path.exists() {
            return plain;
        }
        let split = text.split_once('=').and_then(|(label, path)| Some((label.split_once(':')?, path)));
        match split {
            Some(((method, case), path)) if !method.is_empty() && !case.is_empty() => {
                Self { label: Some((method.to_owned(), case.to_owned())), path: PathBuf::from(path) }
            }
            _ => plain,
        }
    }
}

const fn column(name: &'static str, digits: usize, more_is_better: bool) -> Column {
    Column { name, digits, more_is_better }
}

const QUALITY: [Column; 8] = [
    column("PSNR", 2, true),
    column("SSIM", 4, true),
    column("LPIPS alex", 4, false),
    column("LPIPS vgg", 4, false),
    column("PSNR in mask", 2, true),
    column("SSIM in mask", 4, true),
    column("LPIPS alex in mask", 4, false),
    column("LPIPS vgg in mask", 4, false),
];
const TRAINING: [Column; 4] = [
    column("wall s", 1, false),
    column("CPU s", 1, false),
    column("peak MiB", 0, false),
    column("gaussians", 0, false),
];
const RENDERING: [Column; 4] = [
    column("FPS", 1, true),
    column("median ms", 2, false),
    column("95 % ms", 2, false),
    column("peak MiB", 0, false),
];

/// The entries of all that can be evaluated: runs with metrics first, then folders of renders, which are compared
/// with the photos of a run of the same case.
pub fn entries(inputs: &[Named]) -> Result<Vec<Entry>> {
    let is_run = |n: &&Named| n.path.join("run.json").is_file();
    let runs: Vec<&Named> = inputs.iter().filter(is_run).collect();
    let mut found: Vec<(Entry, &Path)> = Vec::new();
    for named in &runs {
        if let Some(entry) = of_run(named)? {
            found.push((entry, &named.path));
        }
    }
    let mut all: Vec<Entry> = found.iter().map(|(e, _)| e.clone()).collect();
    for named in inputs.iter().filter(|n| !is_run(n)) {
        let Some((method, case)) = &named.label else { continue };
        let Some((_, run)) = found.iter().find(|(e, _)| e.case == *case) else {
            bail!(
                "{}: no run of the case '{case}' was given to compare these renders with",
                named.path.display()
            );
        };
        all.push(of_renders(method, case, &named.path, run)?);
    }
    Ok(all)
}

fn read_json(path: &Path) -> Result<Value> {
    let text = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_slice(&text)
        .with_context(|| format!("{} is damaged; run sat-recon again", path.display()))
}

fn of_run(named: &Named) -> Result<Option<Entry>> {
    let path = named.path.join("eval/metrics.json");
    if !path.is_file() {
        return Ok(None);
    }
    let run = read_json(&named.path.join("run.json"))?;
    let evaluation: Evaluation = serde_json::from_value(read_json(&path)?)
        .with_context(|| format!("{} is damaged; run sat-recon eval again", path.display()))?;
    for view in &evaluation.views {
        let render = named.path.join("eval/renders").join(&view.picture);
        anyhow::ensure!(render.is_file(), "{} is missing; run sat-recon eval again", render.display());
    }
    let text = |path: &str| run.pointer(path).and_then(Value::as_str).unwrap_or("").to_owned();
    let number = |v: Option<&Value>| v.and_then(Value::as_f64);
    let costs = run["costs"].as_array().and_then(|c| c.iter().find(|c| c[0] == "train")).map(|c| &c[1]);
    let training = [
        number(costs.map(|c| &c["wall_s"])),
        number(costs.map(|c| &c["cpu_s"])),
        number(costs.map(|c| &c["peak_mib"])),
        number(run.pointer("/splat/gaussians")),
    ];
    let r = &evaluation.rendering;
    let stem = |p: String| Path::new(&p).file_stem().map_or(p.clone(), |s| s.to_string_lossy().into_owned());
    let (method, case) = named
        .label
        .clone()
        .unwrap_or_else(|| (format!("sat-recon {}", text("/config/quality")), stem(text("/config/input"))));
    Ok(Some(Entry {
        method,
        case,
        quality: evaluation.mean,
        training,
        rendering: [r.frames_per_second, r.frame_ms_median, r.frame_ms_p95, r.peak_mib].map(Some),
    }))
}

/// Renders of another tool: pictures named like the views, of the size of the photos.
fn of_renders(method: &str, case: &str, folder: &Path, run: &Path) -> Result<Entry> {
    let evaluation: Evaluation = serde_json::from_value(read_json(&run.join("eval/metrics.json"))?)?;
    let (mut psnr, mut ssim) = (Vec::new(), Vec::new());
    for view in &evaluation.views {
        let stem = |name: &str| Path::new(name).file_stem().map(|s| s.to_string_lossy().into_owned());
        let names = [stem(&view.name), stem(&view.picture)];
        let file = names.into_iter().flatten().flat_map(|n| [format!("{n}.png"), format!("{n}.jpg")]);
        let Some(file) = file.map(|f| folder.join(f)).find(|f| f.is_file()) else {
            bail!("{} holds no render of the view {}", folder.display(), view.name);
        };
        let (render, photo) =
            (scene::io::load_rgb(&file)?, scene::io::load_rgb(&run.join("eval/photos").join(&view.picture))?);
        psnr.push(metrics::psnr(&render, &photo, None).with_context(|| file.display().to_string())?);
        ssim.push(metrics::ssim(&render, &photo, None).with_context(|| file.display().to_string())?);
    }
    let mean = |v: Vec<f64>| v.iter().sum::<f64>() / v.len().max(1) as f64;
    let quality = Metrics { psnr: mean(psnr), ssim: mean(ssim), ..Metrics::default() };
    Ok(Entry { method: method.into(), case: case.into(), quality, training: [None; 4], rendering: [None; 4] })
}

/// Quality, training cost and rendering cost; tables without a number are left out.
pub fn tables(entries: &[Entry]) -> Vec<Table> {
    let names = |pick: fn(&Entry) -> &String| {
        let mut names: Vec<String> = Vec::new();
        entries.iter().for_each(|e| {
            if !names.contains(pick(e)) {
                names.push(pick(e).clone());
            }
        });
        names
    };
    let (methods, cases) = (names(|e| &e.method), names(|e| &e.case));
    let build = |title, columns: &[Column], values: &dyn Fn(&Entry) -> Vec<Option<f64>>| {
        let mut table = Table::new(title, &methods, &cases, columns);
        for entry in entries {
            let place = |all: &[String], name: &String| all.iter().position(|n| n == name);
            if let (Some(m), Some(c)) = (place(&methods, &entry.method), place(&cases, &entry.case)) {
                table.values[m][c] = values(entry);
            }
        }
        table.without_empty_columns()
    };
    let quality = |e: &Entry| {
        let q = &e.quality;
        let (psnr, ssim) = (Some(q.psnr), Some(q.ssim));
        vec![
            psnr,
            ssim,
            q.lpips_alex,
            q.lpips_vgg,
            q.psnr_mask,
            q.ssim_mask,
            q.lpips_alex_mask,
            q.lpips_vgg_mask,
        ]
    };
    let all = [
        build("quality", &QUALITY, &quality),
        build("training cost", &TRAINING, &|e| e.training.to_vec()),
        build("rendering cost", &RENDERING, &|e| e.rendering.to_vec()),
    ];
    all.into_iter().filter(|t| !t.is_empty()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_label_is_split_off_and_a_plain_path_stays_one() {
        let named = Named::parse("nerf:case 3=some/renders");
        assert_eq!(named.label, Some(("nerf".into(), "case 3".into())));
        assert_eq!(named.path, Path::new("some/renders"));
        assert_eq!(Named::parse("out/demo").label, None);
        assert_eq!(Named::parse("=x").path, Path::new("=x"));
    }
}
