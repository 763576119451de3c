//! The report's splat: curves, held-out views as photo against render, figures, geometry.

use super::charts::{self, Series};
use super::html::{self, escape, figure};
use crate::evaluate::Evaluation;
use crate::pipeline::SplatSummary;
use anyhow::Result;
use std::path::Path;

/// Longest side of a picture in the report, pixels.
pub const PICTURE_SIZE: u32 = 480;
/// Most views whose pictures are shown.
const MOST_PICTURES: usize = 24;

/// Size and curves of the training.
pub fn training(html: &mut String, splat: &SplatSummary) -> Result<()> {
    *html += &format!("<h2>Splat</h2><p>{} gaussians, SH degree {}.</p>", splat.gaussians, splat.sh_degree);
    let curve =
        |pick: fn(&splat::CurvePoint) -> f64| Series::of(splat.curve.iter().map(|p| (p.seconds, pick(p))));
    html.push_str("<div class=\"row\">");
    for (name, pick, caption) in [
        (
            "PSNR, dB",
            (|p| f64::from(p.psnr)) as fn(&splat::CurvePoint) -> f64,
            "PSNR of the training views, at the resolution in use",
        ),
        ("loss", |p| f64::from(p.loss), "Loss of the training views"),
        ("gaussians", |p| p.gaussians as f64, "Number of Gaussians"),
    ] {
        figure(html, &charts::series(["training time, s", name], &[curve(pick)], false)?, caption);
    }
    html.push_str("</div>");
    Ok(())
}

/// The held-out views: protocol, table, pictures, cost of rendering.
pub fn held_out(html: &mut String, out: &Path, evaluation: &Evaluation) -> Result<()> {
    *html += &format!("<h2>Held-out views</h2><p>{}</p>", escape(&evaluation.protocol));
    let figures = evaluation.figures();
    let heads: Vec<&str> = ["view"].into_iter().chain(figures.iter().map(|f| f.name)).collect();
    let row = |(name, metrics): (String, &_)| {
        let cells = figures.iter().map(|f| f.shown(metrics));
        [escape(&name)].into_iter().chain(cells).collect::<Vec<String>>()
    };
    let rows: Vec<Vec<String>> = evaluation.rows().into_iter().map(row).collect();
    html::table(html, &heads, &rows);
    *html += &format!("<p>{}</p>", escape(&evaluation.rendering.sentence()));
    *html += &evaluation.geometry.as_ref().map_or(String::new(), |g| g.html());
    pictures(html, out, evaluation)
}

/// Which views are shown: all, or as many spread evenly, with the worst among them.
fn chosen(evaluation: &Evaluation) -> Vec<usize> {
    let views = &evaluation.views;
    let psnr = |i: &usize| views[*i].metrics.psnr;
    let worst = (0..views.len()).min_by(|a, b| psnr(a).total_cmp(&psnr(b)));
    let step = views.len().div_ceil(MOST_PICTURES).max(1);
    let mut chosen: Vec<usize> = (0..views.len()).step_by(step).chain(worst).collect();
    chosen.sort_unstable();
    chosen.dedup();
    chosen
}

fn pictures(html: &mut String, out: &Path, evaluation: &Evaluation) -> Result<()> {
    let chosen = chosen(evaluation);
    if chosen.is_empty() {
        return Ok(());
    }
    let all = if chosen.len() < evaluation.views.len() {
        format!("{} of {} views, the worst among them. ", chosen.len(), evaluation.views.len())
    } else {
        String::new()
    };
    *html += &format!(
        "<p>{all}Drag the border between photo and render. \
         <label><input type=checkbox class=\"difference\"> difference × 4</label></p><div class=\"pairs\">"
    );
    for view in chosen.into_iter().map(|i| &evaluation.views[i]) {
        let load = |kind: &str| html::picture(&view.picture(out, kind)?, PICTURE_SIZE);
        let m = &view.metrics;
        let inside = m.psnr_mask.map_or(String::new(), |v| format!("; {v:.2} dB inside the matte"));
        let caption = format!("{}: {:.2} dB, SSIM {:.4}{inside}", view.name, m.psnr, m.ssim);
        html::slider(html, ("photo", &load("photos")?), ("render", &load("renders")?), &caption);
    }
    html.push_str("</div>");
    Ok(())
}
