//! The summary of many runs: `summary.html`, `summary.csv`, `summary.json`.

use super::list::{Capture, LIST};
use crate::args::CollectArgs;
use crate::outcome::Outcome;
use crate::record::{KnownRun, Level};
use crate::report::html;
use crate::report::overall;
use crate::stage::{write_json, write_whole};
use crate::terminal::{Verbosity, print, say};
use anyhow::{Context, Result, bail};
use maud::{Markup, html};
use serde::Serialize;
use std::path::Path;

/// A capture in the summary.
#[derive(Clone, Debug, Serialize)]
pub(super) struct CaptureRow {
    /// Name of its folder.
    name: String,
    /// Its video or photos.
    input: String,
    /// "done", "no model", or "failed".
    state: &'static str,
    /// The verdict's worst light.
    light: Level,
    /// Images with a pose, and of how many.
    registered: usize,
    total: usize,
    /// Gaussians of the splat.
    gaussians: usize,
    /// Mean PSNR of the held-out views, dB; inside the mattes where there are any.
    psnr: Option<f64>,
    /// Processor time of all stages, seconds, and the largest memory, MiB.
    cpu_s: f64,
    peak_mib: f64,
    /// Why it failed, or what the worst light says.
    reason: String,
}

impl CaptureRow {
    /// Of a capture in the output folder. `code`: how its process ended, where that is known.
    pub(super) fn of(output: &Path, capture: &Capture, code: Option<i32>) -> Self {
        let folder = output.join(&capture.name);
        let mut row = Self {
            name: capture.name.clone(),
            input: capture.input.display().to_string(),
            state: "failed",
            light: Level::Bad,
            registered: 0,
            total: 0,
            gaussians: 0,
            psnr: None,
            cpu_s: 0.0,
            peak_mib: 0.0,
            reason: last_error(&output.join(format!("{}.log", capture.name))),
        };
        let known = match KnownRun::read(&folder) {
            Ok(known) if code != Some(1) && row.reason.is_empty() => known,
            _ => {
                if row.reason.is_empty() {
                    "it has not ended".clone_into(&mut row.reason);
                }
                return row;
            }
        };
        row.state = "done";
        row.light = overall(&known.verdict);
        if let Some(worst) = known.verdict.iter().find(|l| l.level == row.light && l.level > Level::Good) {
            row.reason = format!("{}: {}", worst.what, worst.reason);
        }
        if let Some(poses) = &known.poses {
            (row.registered, row.total) = (poses.registered, poses.total);
            if poses.no_model.is_some() {
                row.state = "no model";
            }
        }
        row.gaussians = known.splat.as_ref().map_or(0, |s| s.gaussians);
        let judged = known.evaluation.as_ref().filter(|e| !e.views.is_empty());
        row.psnr = judged.map(|e| e.mean.psnr_mask.unwrap_or(e.mean.psnr));
        row.cpu_s = known.costs.iter().fold(0.0, |sum, (_, c)| sum + c.cpu_s);
        row.peak_mib = known.costs.iter().map(|(_, c)| c.peak_mib).fold(0.0, f64::max);
        row
    }

    /// The row in a line of a terminal.
    pub(super) fn sentence(&self) -> String {
        let quality = self.psnr.map_or(String::new(), |p| format!(", {p:.2} dB"));
        let poses = format!("{} of {} images{quality}, {:.0} CPU s", self.registered, self.total, self.cpu_s);
        let reason = if self.reason.is_empty() { String::new() } else { format!("; {}", self.reason) };
        match self.state {
            "failed" => format!("{}: failed{reason}", self.name),
            state => format!("{}: {state}, {poses}{reason}", self.name),
        }
    }

    /// Cells of the table.
    fn cells(&self) -> [String; 10] {
        [
            self.name.clone(),
            self.state.to_owned(),
            format!("{:?}", self.light).to_lowercase(),
            self.registered.to_string(),
            self.total.to_string(),
            self.gaussians.to_string(),
            self.psnr.map_or(String::new(), |p| format!("{p:.2}")),
            format!("{:.1}", self.cpu_s),
            format!("{:.0}", self.peak_mib),
            self.reason.clone(),
        ]
    }
}

/// Heads of the table.
const HEADS: [&str; 10] = [
    "capture",
    "state",
    "light",
    "registered",
    "images",
    "gaussians",
    "PSNR, dB",
    "CPU s",
    "peak MiB",
    "reason",
];

/// The last complaint in the log of a run; nothing where it ended well.
fn last_error(log: &Path) -> String {
    let text = std::fs::read(log).map(|b| String::from_utf8_lossy(&b).into_owned()).unwrap_or_default();
    let error = text.lines().rev().find_map(|l| l.strip_prefix("error: "));
    error.unwrap_or_default().to_owned()
}

/// `collect`: writes the summary of a folder of runs again.
pub(crate) fn run(args: &CollectArgs, verbosity: Verbosity, json: bool) -> Result<Outcome> {
    write(&args.output, verbosity, json)
}

/// Writes the summary. A failure of any capture is a partial result.
pub(super) fn write(output: &Path, verbosity: Verbosity, json: bool) -> Result<Outcome> {
    let captures = listed(output)?;
    let rows: Vec<CaptureRow> = captures.iter().map(|c| CaptureRow::of(output, c, None)).collect();
    write_json(&output.join("summary.json"), &rows)?;
    let line = |cells: &[String]| cells.iter().map(|c| quoted(c)).collect::<Vec<_>>().join(",") + "\n";
    let mut csv = line(&HEADS.map(str::to_owned));
    rows.iter().for_each(|r| csv += &line(&r.cells()));
    write_whole(&output.join("summary.csv"), csv.as_bytes())?;
    let page = html::page("captures – sat-recon", &body(&rows));
    write_whole(&output.join("summary.html"), page.as_bytes())?;
    if json {
        print(&serde_json::to_string_pretty(&rows)?)?;
    }
    let failed: Vec<&CaptureRow> = rows.iter().filter(|r| r.state != "done").collect();
    if verbosity > Verbosity::Quiet {
        say(&format!("{} of {} captures done", rows.len() - failed.len(), rows.len()));
        failed.iter().for_each(|r| say(&format!("  {}", r.sentence())));
        say(&format!("open {}", output.join("summary.html").display()));
    }
    Ok(if failed.is_empty() { Outcome::Done } else { Outcome::Partial })
}

/// The captures that the batch, or the cluster's workflow, was given; else the folders that hold
/// runs.
fn listed(output: &Path) -> Result<Vec<Capture>> {
    let list = output.join(LIST);
    if list.is_file() {
        let text = std::fs::read(&list).with_context(|| format!("cannot read {}", list.display()))?;
        return serde_json::from_slice(&text).with_context(|| format!("{} is damaged", list.display()));
    }
    let mut found = Vec::new();
    for entry in std::fs::read_dir(output).with_context(|| format!("cannot list {}", output.display()))? {
        let folder = entry?.path();
        if let (Ok(known), Some(name)) = (KnownRun::read(&folder), folder.file_name()) {
            found.push(Capture { name: name.to_string_lossy().into_owned(), input: known.config.input });
        }
    }
    if found.is_empty() {
        bail!("{} holds no runs", output.display());
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(found)
}

fn quoted(cell: &str) -> String {
    match cell.contains([',', '"', '\n']) {
        true => format!("\"{}\"", cell.replace('"', "\"\"")),
        false => cell.to_owned(),
    }
}

fn body(rows: &[CaptureRow]) -> Markup {
    let done = rows.iter().filter(|r| r.state == "done").count();
    html! {
        h1 { (done) " of " (rows.len()) " captures" }
        div.scroll {
            table {
                tr { @for head in HEADS { th { (head) } } }
                @for row in rows {
                    tr {
                        @for (i, cell) in row.cells().iter().enumerate() {
                            td {
                                @if i == 0 && row.state != "failed" {
                                    a href={ (row.name) "/report.html" } { (cell) }
                                } @else if i == 2 {
                                    span class={ "verdict " (row.light.class()) } { (cell) }
                                } @else { (cell) }
                            }
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failures_are_named_with_their_reason_and_cells_are_quoted() {
        let out = std::env::temp_dir().join(format!("sat-recon-collect-{}", std::process::id()));
        std::fs::create_dir_all(out.join("good")).unwrap();
        let record = r#"{"poses": {"registered": 8, "total": 9}, "costs": [],
            "verdict": [{"what": "loop", "level": "fair", "reason": "open, by 90°"}]}"#;
        std::fs::write(out.join("good/run.json"), record).unwrap();
        std::fs::write(out.join("bad.log"), "1/6 frames\nerror: x.mp4: the file is empty\n").unwrap();
        let capture = |name: &str| Capture { name: name.into(), input: format!("/in/{name}.mp4").into() };
        write_json(&out.join(LIST), &[capture("bad"), capture("good"), capture("late")]).unwrap();
        assert_eq!(write(&out, Verbosity::Quiet, false).unwrap(), Outcome::Partial);
        let csv = std::fs::read_to_string(out.join("summary.csv")).unwrap();
        let lines: Vec<&str> = csv.lines().collect();
        assert_eq!(lines[1], "bad,failed,bad,0,0,0,,0.0,0,x.mp4: the file is empty");
        assert_eq!(lines[2], "good,done,fair,8,9,0,,0.0,0,\"loop: open, by 90°\"");
        assert!(lines[3].starts_with("late,failed") && lines[3].ends_with("it has not ended"));
        let page = std::fs::read_to_string(out.join("summary.html")).unwrap();
        assert!(page.contains("good/report.html") && !page.contains("bad/report.html"));
        std::fs::remove_dir_all(out).unwrap();
    }
}
