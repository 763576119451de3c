//! A page that shows several runs beside each other.

use super::runs::{Entry, EntryView};
use super::tables::{Cells, Table};
use crate::record::KnownRun;
use crate::report::charts::{self, Series};
use crate::report::html::{self, InlinePicture, figure};
use crate::report::views::{PICTURE_SIZE, difference_switch};
use crate::stage::write_whole;
use anyhow::Result;
use maud::{Markup, html};
use scene::decision::{Sentences, Subject};
use splat::CurvePoint;
use std::collections::BTreeSet;
use std::path::Path;

/// Most views of a case whose pictures are shown. Source: chosen by hand, never measured.
const MOST_PICTURES: usize = 6;

/// A run with the label of its entry.
type Labelled = (String, KnownRun);

/// Writes the page: verdicts, tables, poses, decisions, curves, pictures.
pub(super) fn write(file: &Path, entries: &[Entry], poses: &Cells, tables: &[Table]) -> Result<()> {
    anyhow::ensure!(!entries.is_empty(), "none of the runs was evaluated: run sat-recon on them first");
    html::refuse_foreign(file)?;
    let mut known: Vec<Labelled> = Vec::new();
    for entry in entries {
        if let Some(run) = &entry.run {
            known.push((format!("{}, {}", entry.method, entry.case), KnownRun::read(run)?));
        }
    }
    let (curves, pictures) = (curves(&known)?, pictures(entries)?);
    let body = html! {
        h1 { "Comparison of runs" }
        div.cards {
            @for (label, run) in &known { div { h3 { (label) } (crate::report::lights(&run.verdict)) } }
        }
        @for table in tables { (table_of(table)) }
        @if tables.iter().any(|t| !t.published.is_empty()) {
            small { "Published figures are shown next to those measured here and are never marked as the best." }
        }
        h2 { "Poses" }
        (html::table(&poses.0, &poses.1))
        (decisions(&known))
        (curves)
        (pictures)
    };
    write_whole(file, html::page("runs – sat-recon", &body).as_bytes())
}

/// A table with a group of columns for each case; the best of each column in bold.
fn table_of(table: &Table) -> Markup {
    html! {
        h3 { (table.title) }
        div.scroll {
            table {
                tr {
                    th {}
                    @for case in &table.cases { th.n colspan=(table.columns.len()) { (case) } }
                }
                tr {
                    th { "method" }
                    @for column in table.cases.iter().flat_map(|_| &table.columns) { th.n { (column.name) } }
                }
                @for (m, method) in table.methods.iter().enumerate() {
                    tr {
                        td { (method) }
                        @for (cell, is_best) in table.cells(m) {
                            td.n { @if is_best { b { (cell) } } @else { (cell) } }
                        }
                    }
                }
            }
        }
    }
}

/// What each run chose, a row for each subject; the evidence is in each run's own report.
fn decisions(known: &[Labelled]) -> Markup {
    let subjects: BTreeSet<Subject> =
        known.iter().flat_map(|(_, run)| &run.decisions).map(|d| d.subject).collect();
    html! {
        @if !subjects.is_empty() {
            h2 { "Decisions" }
            div.scroll {
                table {
                    tr { th { "subject" } @for (label, _) in known { th.n { (label) } } }
                    @for subject in subjects {
                        tr {
                            td { (subject.title()) }
                            @for (_, run) in known { td.n { (choices(run, subject)) } }
                        }
                    }
                }
            }
        }
    }
}

fn choices(run: &KnownRun, subject: Subject) -> Markup {
    let made = run.decisions.iter().filter(|d| d.subject == subject);
    let made: Vec<Sentences> = made.map(|d| d.sentences()).collect();
    html! {
        @if made.is_empty() { "–" }
        @for (i, words) in made.iter().enumerate() {
            @if i > 0 { br; }
            (words.choice)
        }
    }
}

fn curves(known: &[Labelled]) -> Result<Markup> {
    let curves: [(&str, &str, fn(&CurvePoint) -> f64); 2] = [
        ("PSNR, dB", "PSNR of the training views, at the resolution in use", |p| f64::from(p.psnr)),
        ("Gaussians", "Number of Gaussians", |p| p.gaussians as f64),
    ];
    let mut figures = Vec::new();
    for (name, caption, pick) in curves {
        let all: Vec<Series> = known
            .iter()
            .map(|(label, run)| {
                let curve = run.splat.iter().flat_map(|s| &s.curve);
                Series { name: label.clone(), points: curve.map(|p| (p.seconds, pick(p))).collect() }
            })
            .filter(|series| !series.points.is_empty())
            .collect();
        figures.push(figure(charts::series(["training time, s", name], &all, false)?, caption));
    }
    Ok(html! {
        h2 { "Training" }
        div.row { @for figure in &figures { (figure) } }
    })
}

/// By case: PSNR view by view, and pictures of each method against those of the first.
fn pictures(entries: &[Entry]) -> Result<Markup> {
    let mut cases: Vec<&str> = Vec::new();
    for entry in entries {
        if !cases.contains(&entry.case.as_str()) {
            cases.push(&entry.case);
        }
    }
    let mut sections = Vec::new();
    for case in cases {
        let of_case: Vec<&Entry> = entries.iter().filter(|e| e.case == case && !e.views.is_empty()).collect();
        if !of_case.is_empty() {
            sections.push(case_section(case, &of_case)?);
        }
    }
    Ok(html! {
        h2 { "Held-out views" }
        (difference_switch())
        @for section in &sections { (section) }
    })
}

fn case_section(case: &str, entries: &[&Entry]) -> Result<Markup> {
    let all: Vec<Series> = entries
        .iter()
        .map(|e| {
            let points = e.views.iter().enumerate().map(|(i, v)| (i as f64, v.metrics.psnr)).collect();
            Series { name: e.method.clone(), points }
        })
        .collect();
    let chart = charts::series(["held-out view", "PSNR, dB"], &all, false)?;
    let (first, others) = (entries[0], &entries[1..]);
    let step = first.views.len().div_ceil(MOST_PICTURES).max(1);
    let mut sliders = Vec::new();
    for view in first.views.iter().step_by(step) {
        sliders.extend(view_sliders(first, view, others)?);
    }
    Ok(html! {
        h3 { (case) }
        div.row { (figure(chart, "PSNR of each held-out view")) }
        div.pairs { @for slider in &sliders { (slider) } }
    })
}

/// A view of the first entry against that of each other; against the photo where no other has it.
fn view_sliders(first: &Entry, view: &EntryView, others: &[&Entry]) -> Result<Vec<Markup>> {
    let left = InlinePicture::read(&view.render, PICTURE_SIZE)?;
    let mut sliders = Vec::new();
    for other in others {
        let Some(twin) = other.views.iter().find(|v| v.name == view.name) else { continue };
        let right = InlinePicture::read(&twin.render, PICTURE_SIZE)?;
        let caption = format!("{}: {:.2} dB | {:.2} dB", view.name, view.metrics.psnr, twin.metrics.psnr);
        sliders.push(html::slider((&first.method, &left), (&other.method, &right), &caption));
    }
    if sliders.is_empty() {
        let photo = InlinePicture::read(&view.photo, PICTURE_SIZE)?;
        let caption = format!("{}: {:.2} dB", view.name, view.metrics.psnr);
        sliders.push(html::slider(("photo", &photo), (&first.method, &left), &caption));
    }
    Ok(sliders)
}
