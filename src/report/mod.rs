//! `report.html`: one file, no network, readable on a phone.

mod charts;
mod comparison;
pub mod decisions;
mod html;
mod poses;
pub mod verdict;
mod views;

pub use comparison::write as write_comparison;

use crate::pipeline::RunRecord;
use crate::stage::write_whole;
use anyhow::Result;
use html::escape;
use scene::Reconstruction;
use serde_json::Value;
use std::path::Path;
use verdict::{Level, Light};

/// Sets the record's decisions and verdict, from what the run knows and what lies in the folder.
pub fn judge(out: &Path, record: &mut RunRecord) -> Result<()> {
    record.decisions = decisions::shown(record);
    record.verdict = verdict::verdict(record, model(out, record)?.as_ref(), geometry(out, record).as_ref());
    Ok(())
}

/// Writes `OUT/report.html` of a run that was judged.
pub fn write(out: &Path, record: &RunRecord) -> Result<()> {
    let body = body(out, record, model(out, record)?.as_ref())?;
    let page = html::page(&format!("{} – sat-recon", title(record)), &body);
    write_whole(&out.join("report.html"), page.as_bytes())
}

/// The solved poses, if there are any.
fn model(out: &Path, record: &RunRecord) -> Result<Option<Reconstruction>> {
    let has_model = record.poses.as_ref().is_some_and(|p| p.no_model.is_none());
    Ok(has_model.then(|| scene::io::read_model(&out.join("sparse/0"))).transpose()?)
}

/// What the evaluation says of the shape, if it was measured.
fn geometry(out: &Path, record: &RunRecord) -> Option<Value> {
    record.evaluation.as_ref()?;
    let text = std::fs::read(out.join("eval/metrics.json")).ok()?;
    serde_json::from_slice::<Value>(&text).ok()?.get_mut("geometry").map(Value::take).filter(Value::is_object)
}

/// The input's name and that of the folder it lies in.
fn title(record: &RunRecord) -> String {
    let input = &record.config.input;
    let name = |path: Option<&Path>| Some(path?.file_name()?.to_string_lossy().into_owned());
    let names: Vec<String> = [name(input.parent()), name(Some(input))].into_iter().flatten().collect();
    names.join("/")
}

fn body(out: &Path, record: &RunRecord, model: Option<&Reconstruction>) -> Result<String> {
    let mut html = format!("<h1>{}</h1>", escape(&title(record)));
    html += &lights(&record.verdict);
    html += &decisions::section(record);
    frames(&mut html, out, record)?;
    if let Some(poses) = &record.poses {
        poses::section(&mut html, record, poses, model)?;
    }
    if let Some(splat) = &record.splat {
        views::training(&mut html, splat)?;
    }
    if let Some(evaluation) = &record.evaluation {
        views::held_out(&mut html, out, evaluation)?;
    }
    costs(&mut html, record);
    Ok(html)
}

/// The traffic light with its reasons.
fn lights(lights: &[Light]) -> String {
    let overall = verdict::overall(lights);
    let word = match overall {
        Level::Good => "All well",
        Level::Fair => "Usable, with doubts",
        Level::Bad => "Not to be relied on",
        Level::Unknown => "Not judged yet",
    };
    let item = |l: &Light| {
        let [what, reason] = [&l.what, &l.reason].map(|t| escape(t));
        format!("<li class=\"{}\"><b>{what}</b>: {reason}</li>", l.level.class())
    };
    let items: String = lights.iter().map(item).collect();
    format!("<div class=\"verdict {}\"><b>{word}</b><ul class=\"lights\">{items}</ul></div>", overall.class())
}

/// Longest side of the sheet of mattes, pixels.
const SHEET_SIZE: u32 = 1200;

fn frames(html: &mut String, out: &Path, record: &RunRecord) -> Result<()> {
    let Some(frames) = &record.frames else { return Ok(()) };
    *html += &format!("<h2>Frames</h2><p>{} frames used", frames.len());
    if let (Some(first), Some(last)) = (frames.frames.first(), frames.frames.last()) {
        let names = [&first.name, &last.name].map(|n| escape(n));
        *html += &format!(", {}×{}, from {} to {}", first.width, first.height, names[0], names[1]);
        if let (Some(a), Some(b)) = (first.time_s, last.time_s) {
            *html += &format!(" ({a:.2} s to {b:.2} s)");
        }
    }
    let masks = frames.frames.iter().filter(|f| f.mask.is_some()).count();
    *html += &format!("; {masks} with a matte.</p>");
    html::list(html, frames.notes.iter().map(|n| escape(n)));
    let sheet = out.join("mattes.png");
    if masks > 0 && sheet.is_file() {
        let picture = html::picture(&sheet, SHEET_SIZE)?;
        *html += &format!("<img class=\"mattes\" alt=\"mattes\" {picture}>");
    }
    Ok(())
}

fn costs(html: &mut String, record: &RunRecord) {
    html.push_str("<h2>Cost</h2>");
    let row = |(stage, cost): &(String, crate::stage::Cost)| {
        let numbers =
            [format!("{:.1}", cost.wall_s), format!("{:.1}", cost.cpu_s), format!("{:.0}", cost.peak_mib)];
        [escape(stage)].into_iter().chain(numbers).collect::<Vec<String>>()
    };
    let rows: Vec<Vec<String>> = record.costs.iter().map(row).collect();
    html::table(html, &["stage", "wall s", "CPU s", "peak MiB"], &rows);
    let libraries: String = record
        .libraries
        .iter()
        .map(|(name, version)| format!(", {} {}", escape(name), escape(version)))
        .collect();
    *html += &format!(
        "<p><small>sat-recon {}, seed {}{libraries}.</small></p>",
        record.version, record.config.seed
    );
}
