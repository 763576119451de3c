//! A page that shows several runs beside each other.

use super::charts::{self, Series};
use super::decisions::Shown;
use super::html::{self, escape, figure};
use super::verdict::Light;
use super::views::PICTURE_SIZE;
use crate::compare::Cells;
use crate::compare::runs::Entry;
use crate::compare::tables::Table;
use crate::pipeline::SplatSummary;
use crate::stage::write_whole;
use anyhow::{Context, Result};
use serde::Deserialize;
use std::path::Path;

/// Most views of a case whose pictures are shown.
const MOST_PICTURES: usize = 6;

/// What is taken of a run's `run.json`.
#[derive(Deserialize, Default)]
struct Known {
    #[serde(default)]
    verdict: Vec<Light>,
    #[serde(default)]
    decisions: Vec<Shown>,
    splat: Option<SplatSummary>,
}

/// Writes the page: verdicts, tables, poses, decisions, curves, pictures.
pub fn write(file: &Path, entries: &[Entry], poses: &Cells, tables: &[Table]) -> Result<()> {
    anyhow::ensure!(!entries.is_empty(), "none of the runs was evaluated: run sat-recon on them first");
    let mut body = "<h1>Runs beside each other</h1>".to_owned();
    let runs = entries.iter().filter_map(|e| Some((e, e.run.as_deref()?)));
    let known: Vec<(String, Known)> =
        runs.map(|(e, run)| Ok((label(e), read(run)?))).collect::<Result<_>>()?;
    body.push_str("<div class=\"cards\">");
    for (label, known) in &known {
        body += &format!("<div><h3>{}</h3>{}</div>", escape(label), super::lights(&known.verdict));
    }
    body.push_str("</div>");
    tables.iter().for_each(|table| body += &table.html(escape));
    if tables.iter().any(|t| !t.published.is_empty()) {
        body.push_str(
            "<small>Published figures stand beside what was measured here and are never the best.</small>",
        );
    }
    body.push_str("<h2>Poses</h2>");
    let escaped: Vec<Vec<String>> = poses.1.iter().map(|r| r.iter().map(|c| escape(c)).collect()).collect();
    html::table(&mut body, &poses.0, &escaped);
    decisions(&mut body, &known);
    curves(&mut body, &known)?;
    pictures(&mut body, entries)?;
    write_whole(file, html::page("runs – sat-recon", &body).as_bytes())
}

fn label(entry: &Entry) -> String {
    format!("{}, {}", entry.method, entry.case)
}

fn read(run: &Path) -> Result<Known> {
    let path = run.join("run.json");
    let text = std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_slice(&text)
        .with_context(|| format!("{} is damaged; run sat-recon again", path.display()))
}

/// Topic by topic what each run chose; the evidence is in each run's own report.
fn decisions(html: &mut String, known: &[(String, Known)]) {
    let mut topics: Vec<&str> = Vec::new();
    known.iter().flat_map(|(_, k)| &k.decisions).for_each(|d| {
        if !topics.contains(&d.title.as_str()) {
            topics.push(&d.title);
        }
    });
    let row = |topic: &&str| {
        let choice = |(_, k): &(String, Known)| {
            let made = k.decisions.iter().filter(|d| d.title == **topic).map(|d| escape(&d.choice));
            let made: Vec<String> = made.collect();
            if made.is_empty() { "–".to_owned() } else { made.join("<br>") }
        };
        [escape(topic)].into_iter().chain(known.iter().map(choice)).collect::<Vec<String>>()
    };
    let rows: Vec<Vec<String>> = topics.iter().map(row).collect();
    if rows.is_empty() {
        return;
    }
    html.push_str("<h2>Decisions</h2>");
    let heads: Vec<&str> =
        ["topic"].into_iter().chain(known.iter().map(|(label, _)| label.as_str())).collect();
    html::table(html, &heads, &rows);
}

fn curves(html: &mut String, known: &[(String, Known)]) -> Result<()> {
    let of = |pick: fn(&splat::CurvePoint) -> f64| -> Vec<Series> {
        let one = |(label, k): &(String, Known)| {
            let points = k.splat.iter().flat_map(|s| &s.curve).map(|p| (p.seconds, pick(p))).collect();
            Series { name: label.clone(), points }
        };
        known.iter().map(one).filter(|s| !s.points.is_empty()).collect()
    };
    html.push_str("<h2>Training</h2><div class=\"row\">");
    for (name, caption, pick) in [
        (
            "PSNR, dB",
            "PSNR of the training views, at the resolution in use",
            (|p| f64::from(p.psnr)) as fn(&splat::CurvePoint) -> f64,
        ),
        ("gaussians", "Number of Gaussians", |p| p.gaussians as f64),
    ] {
        figure(html, &charts::series(["training time, s", name], &of(pick), false)?, caption);
    }
    html.push_str("</div>");
    Ok(())
}

/// By case: PSNR view by view, and pictures of each method against those of the first.
fn pictures(html: &mut String, entries: &[Entry]) -> Result<()> {
    let mut cases: Vec<&str> = Vec::new();
    entries.iter().for_each(|e| {
        if !cases.contains(&e.case.as_str()) {
            cases.push(&e.case);
        }
    });
    html.push_str(
        "<h2>Held-out views</h2><label><input type=checkbox class=\"difference\"> difference × 4</label>",
    );
    for case in cases {
        let of_case: Vec<&Entry> = entries.iter().filter(|e| e.case == case && !e.views.is_empty()).collect();
        let Some((first, others)) = of_case.split_first() else { continue };
        *html += &format!("<h3>{}</h3><div class=\"row\">", escape(case));
        let series = |e: &&Entry| {
            let points = e.views.iter().enumerate().map(|(i, v)| (i as f64, v.metrics.psnr)).collect();
            Series { name: e.method.clone(), points }
        };
        let all: Vec<Series> = of_case.iter().map(series).collect();
        figure(
            html,
            &charts::series(["held-out view", "PSNR, dB"], &all, false)?,
            "PSNR of each held-out view",
        );
        html.push_str("</div><div class=\"pairs\">");
        let step = first.views.len().div_ceil(MOST_PICTURES).max(1);
        for view in first.views.iter().step_by(step) {
            let left = html::picture(&view.render, PICTURE_SIZE)?;
            let mut shown = 0;
            for other in others {
                let Some(twin) = other.views.iter().find(|v| v.name == view.name) else { continue };
                let right = html::picture(&twin.render, PICTURE_SIZE)?;
                let caption =
                    format!("{}: {:.2} dB | {:.2} dB", view.name, view.metrics.psnr, twin.metrics.psnr);
                html::slider(html, (&first.method, &left), (&other.method, &right), &caption);
                shown += 1;
            }
            if shown == 0 {
                let photo = html::picture(&view.photo, PICTURE_SIZE)?;
                let caption = format!("{}: {:.2} dB", view.name, view.metrics.psnr);
                html::slider(html, ("photo", &photo), (&first.method, &left), &caption);
            }
        }
        html.push_str("</div>");
    }
    Ok(())
}
