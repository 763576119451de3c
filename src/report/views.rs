//! The report's splat: curves, held-out views as photo against render, figures, shape.

use super::charts::{self, Series};
use super::html::{self, InlinePicture, figure};
use crate::record::{Evaluation, FieldSummary, ShapeEvaluation, SplatSummary};
use anyhow::Result;
use maud::{Markup, html};
use splat::CurvePoint;
use std::path::Path;

/// Longest side of a picture in the report, pixels. Source: chosen by hand, never measured.
pub(crate) const PICTURE_SIZE: u32 = 480;
/// Most views whose pictures are shown. Source: chosen by hand, never measured.
const MOST_PICTURES: usize = 24;

/// Size and curves of the training.
pub(super) fn training(splat: &SplatSummary) -> Result<Markup> {
    let figures = curves(
        &splat.curve,
        &[
            ("PSNR, dB", |p| f64::from(p.psnr), "PSNR of the training views, at the resolution in use"),
            ("loss", |p| f64::from(p.loss), "Loss of the training views"),
            ("Gaussians", |p| p.gaussians as f64, "Number of Gaussians"),
        ],
    )?;
    Ok(html! {
        h2 { "Splat" }
        p { (splat.gaussians) " Gaussians, SH degree " (splat.sh_degree) "." }
        div.row { @for figure in &figures { (figure) } }
    })
}

/// Size and curves of a field's training.
pub(super) fn field(field: &FieldSummary) -> Result<Markup> {
    let figures = curves(
        &field.curve,
        &[
            ("PSNR, dB", |p| f64::from(p.psnr), "PSNR of the rays of the training views"),
            ("loss", |p| f64::from(p.loss), "Loss of the rays of the training views"),
        ],
    )?;
    Ok(html! {
        h2 { "Field" }
        p { (field.method.name()) ", " (field.iterations) " steps, " (field.parameters) " parameters." }
        div.row { @for figure in &figures { (figure) } }
    })
}

/// What a curve shows: its quantity, how to read it off, and a caption.
type CurveReading = (&'static str, fn(&CurvePoint) -> f64, &'static str);

/// Charts against training time.
fn curves(points: &[CurvePoint], readings: &[CurveReading]) -> Result<Vec<Markup>> {
    let mut figures = Vec::new();
    for &(name, pick, caption) in readings {
        let curve = Series::of(points.iter().map(|p| (p.seconds, pick(p))));
        figures.push(figure(charts::series(["training time, s", name], &[curve], false)?, caption));
    }
    Ok(figures)
}

/// The held-out views: protocol, table, pictures, cost of rendering.
pub(super) fn held_out(out: &Path, evaluation: &Evaluation) -> Result<Markup> {
    let figures = evaluation.figures();
    let heads: Vec<&str> = ["view"].into_iter().chain(figures.iter().map(|f| f.name)).collect();
    let rows: Vec<Vec<String>> = evaluation
        .rows()
        .into_iter()
        .map(|(name, metrics)| {
            let cells = figures.iter().map(|f| f.shown(metrics));
            [name].into_iter().chain(cells).collect()
        })
        .collect();
    Ok(html! {
        h2 { "Held-out views" }
        p { (evaluation.protocol) }
        (html::table(&heads, &rows))
        p { (evaluation.rendering.sentence()) }
        @if let Some(geometry) = &evaluation.geometry { (shape(geometry)) }
        (pictures(out, evaluation)?)
    })
}

/// The shape: a table where there is a mesh, and a sentence.
fn shape(geometry: &ShapeEvaluation) -> Markup {
    let mut protocol = geometry.protocol.clone();
    if let Some(first) = protocol.get_mut(0..1) {
        first.make_ascii_uppercase();
    }
    let rows: Vec<Vec<String>> = geometry
        .rows()
        .into_iter()
        .map(|(what, cells)| [what.to_owned()].into_iter().chain(cells).collect())
        .collect();
    html! {
        h3 { "Shape" }
        p { (protocol) "." }
        @if geometry.cloud.is_some() || geometry.surface.is_some() {
            (html::table(&["", "sparse cloud", "splat", "dense cloud", "fused mesh"], &rows))
        }
        @if let Some(share) = geometry.floaters_pct {
            p { (format!("{share:.2} % of the opacity lies outside the silhouettes.")) }
        }
    }
}

/// Which views are shown: all, or as many spread evenly, with the worst among them.
fn chosen(evaluation: &Evaluation) -> Vec<usize> {
    let views = &evaluation.views;
    let worst = (0..views.len()).min_by(|&a, &b| views[a].metrics.psnr.total_cmp(&views[b].metrics.psnr));
    let step = views.len().div_ceil(MOST_PICTURES).max(1);
    let mut chosen: Vec<usize> = (0..views.len()).step_by(step).chain(worst).collect();
    chosen.sort_unstable();
    chosen.dedup();
    chosen
}

fn pictures(out: &Path, evaluation: &Evaluation) -> Result<Markup> {
    let chosen = chosen(evaluation);
    let (shown, all) = (chosen.len(), evaluation.views.len());
    let mut sliders = Vec::new();
    for view in chosen.into_iter().map(|i| &evaluation.views[i]) {
        let photo = InlinePicture::read(&view.picture(out, "photos")?, PICTURE_SIZE)?;
        let render = InlinePicture::read(&view.picture(out, "renders")?, PICTURE_SIZE)?;
        let m = &view.metrics;
        let inside = m.psnr_mask.map_or(String::new(), |v| format!("; {v:.2} dB inside the matte"));
        let caption = format!("{}: {:.2} dB, SSIM {:.4}{inside}", view.name, m.psnr, m.ssim);
        sliders.push(html::slider(("photo", &photo), ("render", &render), &caption));
    }
    Ok(html! {
        @if !sliders.is_empty() {
            p {
                @if shown < all { (shown) " of " (all) " views, the worst among them. " }
                "Drag the border between photo and render. "
                (difference_switch())
            }
            div.pairs { @for slider in &sliders { (slider) } }
        }
    })
}

/// The box that shows differences in place of pairs.
pub(crate) fn difference_switch() -> Markup {
    html! { label { input.difference type="checkbox"; " difference × 4" } }
}
