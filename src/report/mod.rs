//! `report.html`: one file, no network, readable on a phone.

mod advice;
pub(crate) mod charts;
mod decisions;
mod first;
pub(crate) mod html;
mod measures;
mod motion;
mod poses;
mod verdict;
pub(crate) mod views;

pub(crate) use advice::advice;
pub(crate) use measures::put_measures;
pub(crate) use verdict::overall;

use crate::record::RunRecord;
use crate::record::{Level, Light};
use crate::stage::write_whole;
use anyhow::Result;
use html::InlinePicture;
use maud::{Markup, html};
use scene::{FrameSet, Reconstruction};
use std::path::Path;

/// Sets the record's decisions and verdict from what the run knows and from the model in its
/// folder.
pub fn judge(out: &Path, record: &mut RunRecord) -> Result<()> {
    record.decisions = decisions::all(record);
    record.verdict = verdict::verdict(record, model(out, record)?.as_ref());
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

/// The input's name and that of the folder it lies in.
fn title(record: &RunRecord) -> String {
    let input = &record.config.input;
    let parts = [input.parent(), Some(input.as_path())].into_iter().flatten();
    let names: Vec<_> = parts.filter_map(Path::file_name).map(|n| n.to_string_lossy()).collect();
    names.join("/")
}

fn body(out: &Path, record: &RunRecord, model: Option<&Reconstruction>) -> Result<Markup> {
    let poses = record.poses.as_ref().map(|p| poses::section(record, p, model)).transpose()?;
    let moved = record.poses.as_ref().and_then(|p| p.motion.as_ref());
    let motion = moved.map(motion::section).transpose()?;
    let training = record.splat.as_ref().map(views::training).transpose()?;
    let field = record.field.as_ref().map(views::field).transpose()?;
    let held_out = record.evaluation.as_ref().map(|e| views::held_out(out, e)).transpose()?;
    let hero = record.evaluation.as_ref().map(|e| first::hero(out, e)).transpose()?;
    Ok(html! {
        h1 { (title(record)) }
        div.top {
            @if let Some(hero) = hero { (hero) }
            (lights(&record.verdict))
        }
        (first::next_steps(out, record))
        (decisions::section(record))
        (frames(out, record)?)
        @for section in [poses, motion, training, field, held_out].into_iter().flatten() { (section) }
        (measures::section(out))
        (costs(record))
    })
}

/// The verdict in words.
pub(crate) fn overall_in_words(overall: Level) -> &'static str {
    match overall {
        Level::Good => "All well",
        Level::Fair => "Usable, with doubts",
        Level::Bad => "Not reliable",
        Level::Unknown => "Not judged yet",
    }
}

/// The verdict with its reasons.
pub(crate) fn lights(lights: &[Light]) -> Markup {
    let overall = overall(lights);
    let word = overall_in_words(overall);
    html! {
        div class={ "verdict " (overall.class()) } {
            b { (word) }
            ul.lights {
                @for light in lights {
                    li class=(light.level.class()) {
                        b { (light.what) } ": " (light.reason)
                        @if let Some(advice) = advice(light) { br; small { (advice) } }
                    }
                }
            }
        }
    }
}

/// Longest side of the sheet of mattes, pixels. Source: chosen by hand, never measured.
const SHEET_SIZE: u32 = 1200;

fn frames(out: &Path, record: &RunRecord) -> Result<Markup> {
    let Some(frames) = &record.frames else { return Ok(Markup::default()) };
    let mattes = frames.frames.iter().filter(|f| f.mask.is_some()).count();
    let sheet = out.join("mattes.png");
    let picture =
        (mattes > 0 && sheet.is_file()).then(|| InlinePicture::read(&sheet, SHEET_SIZE)).transpose()?;
    Ok(html! {
        h2 { "Frames" }
        p { (frames_in_words(frames, mattes)) }
        (html::list(&frames.notes))
        @if let Some(picture) = picture { (picture.element(Some("mattes"), "mattes")) }
    })
}

fn frames_in_words(frames: &FrameSet, mattes: usize) -> String {
    let mut text = format!("{} frames", frames.len());
    if let (Some(first), Some(last)) = (frames.frames.first(), frames.frames.last()) {
        let (w, h) = (first.width, first.height);
        text += &format!(", {w}×{h} pixels, from {} to {}", first.name, last.name);
        if let (Some(a), Some(b)) = (first.time_s, last.time_s) {
            text += &format!(" ({a:.2} s to {b:.2} s)");
        }
    }
    text + &format!("; {mattes} with a matte.")
}

fn costs(record: &RunRecord) -> Markup {
    let rows: Vec<Vec<String>> = record
        .costs
        .iter()
        .map(|(stage, cost)| {
            let numbers = [cost.wall_s, cost.cpu_s].map(|s| format!("{s:.1}"));
            let peak = format!("{:.0}", cost.peak_mib);
            [stage.clone()].into_iter().chain(numbers).chain([peak]).collect()
        })
        .collect();
    html! {
        h2 { "Cost" }
        (html::table(&["stage", "wall s", "CPU s", "peak MiB"], &rows))
        p {
            small {
                "sat-recon " (record.version) ", seed " (record.config.seed)
                @for (name, version) in &record.libraries { ", " (name) " " (version) }
                "."
            }
        }
    }
}
