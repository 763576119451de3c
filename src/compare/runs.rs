//! Runs (and renders of other tools) as entries of the tables.

use super::tables::{Table, TableColumn};
use crate::evaluate::metrics::FIGURES;
use crate::record::{Evaluation, KnownConfig, KnownRun, Metrics, ViewMetrics};
use anyhow::{Context, Result, bail};
use image::RgbImage;
use scene::lpips::Lpips;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// A held-out view as one method shows it.
#[derive(Clone, Debug)]
pub(crate) struct EntryView {
    /// Image name.
    pub name: String,
    /// How near it comes to the photo.
    pub metrics: Metrics,
    /// The picture.
    pub render: PathBuf,
    /// The photo.
    pub photo: PathBuf,
}

impl EntryView {
    /// A held-out view of a run in its folder.
    fn of_run(view: &ViewMetrics, run: &Path) -> Result<Self> {
        let (render, photo) = (view.picture(run, "renders")?, view.picture(run, "photos")?);
        Ok(Self { name: view.name.clone(), metrics: view.metrics, render, photo })
    }
}

/// What one method gave on one case.
#[derive(Clone, Debug)]
pub(crate) struct Entry {
    /// Row.
    pub method: String,
    /// TableColumn group.
    pub case: String,
    /// Its run folder; `None` for renders of another tool.
    pub run: Option<PathBuf>,
    /// The held-out views.
    pub views: Vec<EntryView>,
    quality: Metrics,
    training: [Option<f64>; 4],
    rendering: [Option<f64>; 4],
}

/// `METHOD:CASE=PATH`, or a path alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Named {
    /// Method and case.
    pub label: Option<(String, String)>,
    /// A run folder, a model, or a folder of renders.
    pub path: PathBuf,
}

impl Named {
    /// Whether it is the folder of a run.
    fn is_run(&self) -> bool {
        self.path.join("run.json").is_file()
    }

    /// Splits the label off. A path that exists is a path, whatever it is called.
    pub(crate) fn parse(text: &str) -> Self {
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

/// Name, digits behind the point, whether more is better.
type Heading = (&'static str, usize, bool);

const TRAINING: [Heading; 4] =
    [("wall s", 1, false), ("CPU s", 1, false), ("peak MiB", 0, false), ("gaussians", 0, false)];
const RENDERING: [Heading; 4] =
    [("FPS", 1, true), ("median ms", 2, false), ("95 % ms", 2, false), ("peak MiB", 0, false)];

/// The entries of all that can be evaluated: runs with metrics first, then folders of renders,
/// which are compared with the photos of a run of the same case.
pub(crate) fn entries(inputs: &[Named], networks: &[Lpips]) -> Result<Vec<Entry>> {
    let mut all: Vec<Entry> = Vec::new();
    for named in inputs.iter().filter(|n| n.is_run()) {
        all.extend(of_run(named)?);
    }
    for named in inputs.iter().filter(|n| !n.is_run()) {
        let Some((method, case)) = &named.label else { continue };
        let Some(run) = all.iter().find(|e| e.case == *case && e.run.is_some()) else {
            bail!(
                "{}: no run of the case '{case}' was given to compare these renders with",
                named.path.display()
            );
        };
        all.push(of_renders(method, run, &named.path, networks)?);
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
    let run = KnownRun::read(&named.path)?;
    let evaluation: Evaluation = serde_json::from_value(read_json(&path)?)
        .with_context(|| format!("{} is damaged; run sat-recon eval again", path.display()))?;
    let views = evaluation.views.iter().map(|v| EntryView::of_run(v, &named.path));
    let views = views.collect::<Result<Vec<_>>>()?;
    let cost = run.cost("train");
    let training = [
        cost.map(|c| c.wall_s),
        cost.map(|c| c.cpu_s),
        cost.map(|c| c.peak_mib),
        run.splat.as_ref().map(|s| s.gaussians as f64),
    ];
    let r = &evaluation.rendering;
    let (method, case) = named.label.clone().unwrap_or_else(|| default_label(&run.config));
    Ok(Some(Entry {
        method,
        case,
        run: Some(named.path.clone()),
        views,
        quality: evaluation.mean,
        training,
        rendering: [r.frames_per_second, r.frame_ms_median, r.frame_ms_p95, r.peak_mib].map(Some),
    }))
}

/// The preset as the method, the name of the input as the case.
fn default_label(config: &KnownConfig) -> (String, String) {
    let quality = config.quality.map_or(String::new(), |q| format!(" {q:?}").to_lowercase());
    let case = config.input.file_stem().map_or(String::new(), |s| s.to_string_lossy().into_owned());
    (format!("sat-recon{quality}"), case)
}

/// Renders of another tool: pictures named like the views, of the size of the photos.
fn of_renders(method: &str, run: &Entry, folder: &Path, networks: &[Lpips]) -> Result<Entry> {
    let mut views = Vec::new();
    for view in &run.views {
        let stems = [Path::new(&view.name), &view.render].into_iter().filter_map(Path::file_stem);
        let names = stems.map(|s| s.to_string_lossy().into_owned());
        let file = names.flat_map(|n| ["png", "jpg", "jpeg"].map(|e| format!("{n}.{e}")));
        let Some(render) = file.map(|f| folder.join(f)).find(|f| f.is_file()) else {
            bail!("{} holds no render of the view {} (as .png or .jpg)", folder.display(), view.name);
        };
        let mask = run.run.as_deref().zip(view.photo.file_name()).map(|(r, n)| r.join("eval/masks").join(n));
        let mask = mask.filter(|m| m.is_file()).map(|m| scene::io::load_mask(&m)).transpose()?;
        let (picture, photo) = (over_black(&render)?, scene::io::load_rgb(&view.photo)?);
        let metrics = Metrics::judge(&picture, &photo, mask.as_ref(), networks)
            .with_context(|| render.display().to_string())?;
        views.push(EntryView { metrics, render, ..view.clone() });
    }
    let all: Vec<Metrics> = views.iter().map(|v| v.metrics).collect();
    Ok(Entry {
        method: method.into(),
        case: run.case.clone(),
        run: None,
        views,
        quality: Metrics::mean(&all),
        training: [None; 4],
        rendering: [None; 4],
    })
}

/// A render with an alpha channel lies over black, as our own do.
fn over_black(path: &Path) -> Result<RgbImage> {
    let mut picture = scene::io::load_image(path)?;
    if let Some(alpha) = &picture.alpha {
        for (pixel, a) in picture.rgb.pixels_mut().zip(alpha.as_raw()) {
            pixel.0 = pixel.0.map(|v| ((u32::from(v) * u32::from(*a) + 127) / 255) as u8);
        }
    }
    Ok(picture.rgb)
}

/// Quality, training cost and rendering cost with what earlier tables hold; tables without a number
/// are left out.
pub(crate) fn tables(entries: &[Entry], beside: &[Table]) -> Vec<Table> {
    let quality: Vec<Heading> = FIGURES.iter().map(|f| (f.name, f.digits, f.more_is_better)).collect();
    let all = [
        table("quality", &quality, entries, |e| FIGURES.iter().map(|f| (f.of)(&e.quality)).collect()),
        table("training cost", &TRAINING, entries, |e| e.training.to_vec()),
        table("rendering cost", &RENDERING, entries, |e| e.rendering.to_vec()),
    ];
    let merged = all.into_iter().map(|mut table| {
        for other in beside {
            if other.title == table.title {
                table.merge(other);
            }
        }
        table.without_empty_columns()
    });
    merged.filter(|t| !t.is_empty()).collect()
}

fn table(
    title: &str,
    headings: &[Heading],
    entries: &[Entry],
    values: fn(&Entry) -> Vec<Option<f64>>,
) -> Table {
    let methods = distinct(entries.iter().map(|e| &e.method));
    let cases = distinct(entries.iter().map(|e| &e.case));
    let columns: Vec<TableColumn> = headings
        .iter()
        .map(|&(name, digits, more_is_better)| TableColumn { name: name.to_owned(), digits, more_is_better })
        .collect();
    let mut table = Table::new(title, &methods, &cases, &columns);
    for entry in entries {
        let method = methods.iter().position(|m| *m == entry.method);
        let case = cases.iter().position(|c| *c == entry.case);
        if let (Some(m), Some(c)) = (method, case) {
            table.values[m][c] = values(entry);
        }
    }
    table
}

/// Each name once, in the order in which they come first.
fn distinct<'a>(names: impl Iterator<Item = &'a String>) -> Vec<String> {
    let mut all: Vec<String> = Vec::new();
    for name in names {
        if !all.contains(name) {
            all.push(name.clone());
        }
    }
    all
}

/// Tables that `--tables` wrote, or figures that were published.
pub fn read_tables(path: &Path) -> Result<Vec<Table>> {
    let tables: Vec<Table> = serde_json::from_value(read_json(path)?)
        .with_context(|| format!("{} holds no tables as --tables writes them", path.display()))?;
    for table in &tables {
        anyhow::ensure!(
            table.is_whole(),
            "{}: the table '{}' does not have a number for each of its methods, cases and columns",
            path.display(),
            table.title
        );
    }
    Ok(tables)
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
