//! `report.html`: one file, no network, readable on a phone.

mod charts;

use crate::evaluate::{Evaluation, Metrics};
use crate::pipeline::{PoseSummary, RunRecord, SplatSummary};
use crate::stage::write_whole;
use anyhow::Result;
use base64::Engine as _;
use image::RgbImage;
use std::fmt::Write as _;
use std::path::Path;

/// Writes `OUT/report.html` from what the run knows and what lies in the folder.
pub fn write(out: &Path, record: &RunRecord) -> Result<()> {
    let mut html = String::new();
    let name = record.config.input.file_name().map_or_else(|| "scene".into(), |n| n.to_string_lossy());
    let name = escape(&name);
    write!(
        html,
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>{name} – sat-recon</title><style>{}</style><body><h1>{name}</h1>",
        include_str!("style.css")
    )?;
    verdict(&mut html, record)?;
    frames(&mut html, record)?;
    if let Some(poses) = &record.poses {
        self::poses(&mut html, out, poses)?;
    }
    if let Some(splat) = &record.splat {
        self::splat(&mut html, splat)?;
    }
    if let Some(evaluation) = &record.evaluation {
        self::evaluation(&mut html, out, evaluation)?;
    }
    costs(&mut html, record)?;
    html.push_str("</body></html>");
    write_whole(&out.join("report.html"), html.as_bytes())
}

/// Text that may come from file names, made safe for HTML.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

fn verdict(html: &mut String, record: &RunRecord) -> Result<()> {
    let mut reasons = Vec::new();
    let mut class = "good";
    match &record.poses {
        Some(PoseSummary { no_model: Some(reason), .. }) => {
            class = "bad";
            reasons.push(format!("no model: {}", escape(reason)));
        }
        Some(poses) => {
            if poses.registered < poses.total {
                class = "fair";
            }
            reasons.push(format!("{} of {} frames have a pose", poses.registered, poses.total));
            reasons.push(format!("mean reprojection error {:.2} px", poses.mean_error_px));
        }
        None => reasons.push("poses not solved yet".into()),
    }
    if let Some(evaluation) = &record.evaluation {
        reasons.push(escape(&evaluation.sentence()));
        if evaluation.mean.psnr < 20.0 {
            class = "bad";
        } else if evaluation.mean.psnr < 25.0 && class == "good" {
            class = "fair";
        }
    }
    write!(html, "<p class=\"verdict {class}\">{}.</p>", reasons.join(" · "))?;
    Ok(())
}

fn frames(html: &mut String, record: &RunRecord) -> Result<()> {
    let Some(frames) = &record.frames else { return Ok(()) };
    write!(html, "<h2>Frames</h2><p>{} frames used", frames.len())?;
    if let (Some(first), Some(last)) = (frames.frames.first(), frames.frames.last()) {
        write!(
            html,
            ", {}×{}, from {} to {}",
            first.width,
            first.height,
            escape(&first.name),
            escape(&last.name)
        )?;
        if let (Some(a), Some(b)) = (first.time_s, last.time_s) {
            write!(html, " ({a:.2} s to {b:.2} s)")?;
        }
    }
    let masks = frames.frames.iter().filter(|f| f.mask.is_some()).count();
    write!(html, "; {masks} with a mask.</p>")?;
    list(html, frames.notes.iter().map(|n| escape(n)))?;
    Ok(())
}

fn list(html: &mut String, items: impl Iterator<Item = String>) -> Result<()> {
    let items: Vec<String> = items.map(|i| format!("<li>{i}</li>")).collect();
    if !items.is_empty() {
        write!(html, "<ul>{}</ul>", items.concat())?;
    }
    Ok(())
}

/// Evidence longer than this is folded away.
const LONG_EVIDENCE: usize = 200;

fn decisions(html: &mut String, decisions: &[[String; 3]]) -> Result<()> {
    let item = |d: &[String; 3]| {
        let [what, chosen, evidence] = [&d[0], &d[1], &d[2]].map(|t| escape(t));
        if evidence.len() <= LONG_EVIDENCE {
            return format!("{what}: <b>{chosen}</b> – {evidence}");
        }
        let figures = evidence.split("; ").map(|part| format!("<li>{part}</li>")).collect::<String>();
        format!("{what}: <b>{chosen}</b><details><summary>evidence</summary><ul>{figures}</ul></details>")
    };
    list(html, decisions.iter().map(item))
}

fn figure(html: &mut String, svg: &str, caption: &str) -> Result<()> {
    write!(html, "<figure>{svg}<figcaption>{caption}</figcaption></figure>")?;
    Ok(())
}

fn poses(html: &mut String, out: &Path, poses: &PoseSummary) -> Result<()> {
    html.push_str("<h2>Poses</h2>");
    if poses.no_model.is_none() {
        write!(html, "<p>{} of {} images, {} points.</p>", poses.registered, poses.total, poses.points)?;
    }
    decisions(html, &poses.decisions)?;
    list(
        html,
        poses.missing.iter().map(|(name, why)| format!("no pose for {}: {}", escape(name), escape(why))),
    )?;
    list(html, poses.weak.iter().map(|(name, why)| format!("{} is weak: {}", escape(name), escape(why))))?;
    if poses.no_model.is_some() {
        return Ok(());
    }
    let model = scene::io::read_model(&out.join("sparse/0"))?;
    html.push_str("<div class=\"row\">");
    figure(html, &charts::camera_map(&model, true)?, "Cameras and points along the ring's axis")?;
    figure(html, &charts::camera_map(&model, false)?, "The same from the side")?;
    let errors = model.reprojection_errors();
    if !errors.is_empty() {
        figure(
            html,
            &charts::error_histogram(&errors)?,
            "Reprojection error (the last bar holds all above)",
        )?;
    }
    html.push_str("</div><div class=\"scroll\"><table><tr><th>camera<th>model<th>size<th>parameters</tr>");
    for camera in model.cameras.values() {
        let params: Vec<String> = camera.params.iter().map(|p| format!("{p:.5}")).collect();
        write!(
            html,
            "<tr><td>{}<td>{}<td>{}×{}<td>{}</tr>",
            camera.id,
            camera.model.name(),
            camera.width,
            camera.height,
            params.join(", ")
        )?;
    }
    html.push_str("</table></div>");
    Ok(())
}

fn splat(html: &mut String, splat: &SplatSummary) -> Result<()> {
    write!(html, "<h2>Splat</h2><p>{} gaussians, SH degree {}.</p>", splat.gaussians, splat.sh_degree)?;
    decisions(html, &splat.decisions)?;
    html.push_str("<div class=\"row\">");
    figure(
        html,
        &charts::training_curve(&splat.curve, "loss", |p| f64::from(p.loss))?,
        "Loss of the training views",
    )?;
    figure(
        html,
        &charts::training_curve(&splat.curve, "PSNR, dB", |p| f64::from(p.psnr))?,
        "PSNR of the training views",
    )?;
    html.push_str("</div>");
    Ok(())
}

fn evaluation(html: &mut String, out: &Path, evaluation: &Evaluation) -> Result<()> {
    write!(html, "<h2>Held-out views</h2><p>{}</p>", escape(&evaluation.protocol))?;
    let columns = [
        ("PSNR", 2, (|m| Some(m.psnr)) as fn(&Metrics) -> Option<f64>),
        ("SSIM", 4, |m| Some(m.ssim)),
        ("PSNR in mask", 2, |m| m.psnr_mask),
        ("SSIM in mask", 4, |m| m.ssim_mask),
        ("LPIPS alex", 4, |m| m.lpips_alex),
        ("LPIPS vgg", 4, |m| m.lpips_vgg),
    ];
    let shown: Vec<_> = columns.iter().filter(|(_, _, pick)| pick(&evaluation.mean).is_some()).collect();
    html.push_str("<div class=\"scroll\"><table><tr><th>view");
    for (name, ..) in &shown {
        write!(html, "<th class=n>{name}")?;
    }
    html.push_str("</tr>");
    let views = evaluation.views.iter().map(|v| (v.name.as_str(), &v.metrics));
    for (name, metrics) in views.chain([("mean", &evaluation.mean)]) {
        write!(html, "<tr><td>{}", escape(name))?;
        for (_, digits, pick) in &shown {
            let value = pick(metrics).map_or("–".to_owned(), |v| format!("{v:.digits$}"));
            write!(html, "<td class=n>{value}")?;
        }
        html.push_str("</tr>");
    }
    html.push_str("</table></div>");
    if let Some(geometry) = &evaluation.geometry {
        html.push_str(&geometry.html());
    }
    let cost = &evaluation.rendering;
    write!(
        html,
        "<p>Rendering: {:.1} frames/s; a frame takes {:.1} ms (median), 95 % at most {:.1}, 99 % at most {:.1}; \
         {:.0} MiB.</p><p>Photo, render, difference ×4:</p>",
        cost.frames_per_second, cost.frame_ms_median, cost.frame_ms_p95, cost.frame_ms_p99, cost.peak_mib
    )?;
    for view in &evaluation.views {
        html.push_str("<div class=\"triple\">");
        for (kind, picture) in triple(&out.join("eval"), &view.picture)? {
            let code = base64::engine::general_purpose::STANDARD.encode(jpeg(&picture)?);
            write!(
                html,
                "<img loading=lazy alt=\"{kind} of {}\" src=\"data:image/jpeg;base64,{code}\">",
                escape(&view.name)
            )?;
        }
        html.push_str("</div>");
    }
    Ok(())
}

/// Longest side of a picture in the report, pixels.
const PICTURE_SIZE: u32 = 480;

/// Photo, render and four times their difference, small enough for a report.
fn triple(folder: &Path, picture: &str) -> Result<[(&'static str, RgbImage); 3]> {
    let load = |kind: &str| -> Result<RgbImage> {
        let image = scene::io::load_rgb(&folder.join(kind).join(picture))?;
        let (w, h) = image.dimensions();
        let scale = (f64::from(PICTURE_SIZE) / f64::from(w.max(h))).min(1.0);
        let small = |v: u32| ((f64::from(v) * scale).round() as u32).max(1);
        Ok(scene::io::resize_area(&image, small(w), small(h)))
    };
    let (photo, render) = (load("photos")?, load("renders")?);
    let difference = RgbImage::from_fn(photo.width(), photo.height(), |x, y| {
        let (a, b) = (photo.get_pixel(x, y), render.get_pixel(x, y));
        image::Rgb(std::array::from_fn(|c| a[c].abs_diff(b[c]).saturating_mul(4)))
    });
    Ok([("photo", photo), ("render", render), ("difference", difference)])
}

fn jpeg(picture: &RgbImage) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    picture.write_with_encoder(image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 85))?;
    Ok(bytes)
}

fn costs(html: &mut String, record: &RunRecord) -> Result<()> {
    html.push_str(
        "<h2>Cost</h2><table><tr><th>stage<th class=n>wall s<th class=n>CPU s<th class=n>peak MiB</tr>",
    );
    for (stage, cost) in &record.costs {
        write!(
            html,
            "<tr><td>{stage}<td class=n>{:.1}<td class=n>{:.1}<td class=n>{:.0}</tr>",
            cost.wall_s, cost.cpu_s, cost.peak_mib
        )?;
    }
    write!(html, "</table><p>sat-recon {}, seed {}", record.version, record.config.seed)?;
    for (name, version) in &record.libraries {
        write!(html, ", {} {}", escape(name), escape(version))?;
    }
    html.push_str(".</p>");
    Ok(())
}
