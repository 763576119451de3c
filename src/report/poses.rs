//! The report's poses: cameras and points to turn, angles, reprojection errors, the camera itself.

use super::charts::{self, Series};
use super::html::{self, escape, figure, folded};
use super::verdict;
use crate::pipeline::{Deviations, PoseSummary, RunRecord};
use anyhow::Result;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat3, DVec2, DVec3};
use scene::{FrameSet, Reconstruction};
use serde::Serialize;
use std::collections::BTreeMap;

/// Most points that are shown.
const MOST_POINTS: usize = 4000;

#[derive(Serialize)]
struct Camera {
    /// Centre and the four corners of its picture, in the shown frame.
    corners: Vec<f32>,
    /// "held", "weak" or nothing.
    kind: &'static str,
    /// What is said of it.
    text: String,
}

/// What the canvas draws, in a frame in which all of it lies in [-1, 1] and z is up.
#[derive(Serialize)]
struct Scene {
    /// 16-bit numbers, three a point, 16383 = 1.
    points: String,
    /// sRGB bytes, three a point.
    colours: String,
    cameras: Vec<Camera>,
}

/// Writes the section.
pub fn section(
    html: &mut String,
    record: &RunRecord,
    poses: &PoseSummary,
    model: Option<&Reconstruction>,
) -> Result<()> {
    html.push_str("<h2>Poses</h2>");
    let say = |word: &str, list: &[(String, String)]| -> Vec<String> {
        list.iter().map(|(name, why)| format!("{} {word}: {}", escape(name), escape(why))).collect()
    };
    folded(html, "frames without a pose", &say("has no pose", &poses.missing));
    folded(html, "weak frames", &say("is weak", &poses.weak));
    let Some(model) = model else { return Ok(()) };
    *html += &format!("<p>{} of {} images, {} points.</p>", poses.registered, poses.total, poses.points);
    let errors = model.reprojection_errors_by_image();
    let data = html::json(&scene(record, poses, model, &errors))?;
    *html += &format!(
        "<div class=\"poses\"><canvas id=\"poses\" tabindex=0 aria-label=\"cameras and points\"></canvas><output></output>\
         <script type=\"application/json\" id=\"poses-data\">{data}</script></div>\
         <small class=\"key\">Drag turns, wheel or two fingers zoom, a tap on a camera names it.\
         <span><b style=\"background:#4da3ff\"></b>trained on</span> \
         <span><b style=\"background:#ff9f1c\"></b>held out</span> \
         <span><b style=\"background:#ff4d4d\"></b>weak</span></small><div class=\"row\">"
    );
    if let Some(frames) = &record.frames {
        angles(html, model, frames)?;
    }
    reprojection(html, poses, model, &errors)?;
    html.push_str("</div>");
    cameras(html, poses, model);
    if let Some(known) = &poses.deviations {
        deviations(html, known);
    }
    figures(html, poses);
    Ok(())
}

/// How the object stands in the canvas: the ring's axis up, or what is up in most images.
fn scene(
    record: &RunRecord,
    poses: &PoseSummary,
    model: &Reconstruction,
    errors: &BTreeMap<u32, Vec<f64>>,
) -> Scene {
    let centres: Vec<DVec3> = model.images.values().map(|i| i.pose.centre()).collect();
    let up: DVec3 = model.images.values().map(|i| i.pose.rotation.conjugate() * -DVec3::Y).sum();
    let in_order = record.frames.as_ref();
    let ring = in_order.and_then(|f| verdict::ring(model, f)).map(|(ring, ..)| ring);
    let up = ring.as_ref().map_or(up, |r| r.axis).normalize_or(DVec3::Z);
    let middle =
        ring.map_or_else(|| centres.iter().sum::<DVec3>() / centres.len().max(1) as f64, |r| r.centre);
    let (x, y) = up.any_orthonormal_pair();
    let turn = DMat3::from_cols(x, y, up).transpose();
    let reach = centres.iter().map(|c| c.distance(middle)).fold(0.0, f64::max).max(1e-12);
    let shown = |p: DVec3| (turn * (p - middle) / reach * 0.9).as_vec3();

    let step = model.points.len().div_ceil(MOST_POINTS).max(1);
    let (mut points, mut colours) = (Vec::new(), Vec::new());
    for point in model.points.values().step_by(step) {
        let p = shown(point.position);
        if p.abs().max_element() < 1.9 {
            p.to_array().iter().for_each(|v| points.extend(((v * 16383.0) as i16).to_le_bytes()));
            colours.extend(point.rgb);
        }
    }
    let mut names: Vec<&str> = model.images.values().map(|i| i.name.as_str()).collect();
    names.sort_unstable();
    let count = names.len();
    let camera = |image: &scene::PosedImage| {
        let camera = model.cameras.get(&image.camera)?;
        let (w, h) = (f64::from(camera.width), f64::from(camera.height));
        let ray = |x: f64, y: f64| camera.unproject(DVec2::new(x, y)).extend(1.0) * (reach * 0.09);
        let back = image.pose.inverse();
        let corners = [ray(0.0, 0.0), ray(w, 0.0), ray(w, h), ray(0.0, h)].map(|r| back.transform(r));
        let corners = [image.pose.centre()].into_iter().chain(corners);
        let index = names.binary_search(&image.name.as_str()).unwrap_or(0);
        let weak = poses.weak.iter().find(|w| w.0 == image.name);
        let held = record.splat.is_some() && record.config.dataset.holds_out(index, count);
        let seen = errors.get(&image.id).map_or(String::new(), |e| {
            format!(": {:.2} px over {} sightings", e.iter().sum::<f64>() / e.len() as f64, e.len())
        });
        Some(Camera {
            corners: corners.flat_map(|c| shown(c).to_array()).map(|v| (v * 1e4).round() / 1e4).collect(),
            kind: if weak.is_some() {
                "weak"
            } else if held {
                "held"
            } else {
                ""
            },
            text: format!(
                "{}{seen}{}",
                image.name,
                weak.map_or(String::new(), |w| format!("; weak: {}", w.1))
            ),
        })
    };
    let cameras = model.images.values().filter_map(camera).collect();
    Scene { points: STANDARD.encode(points), colours: STANDARD.encode(colours), cameras }
}

/// Angles about the axis against time or frame, and how far they are from a steady turn.
fn angles(html: &mut String, model: &Reconstruction, frames: &FrameSet) -> Result<()> {
    let Some((ring, _, places)) = verdict::ring(model, frames) else { return Ok(()) };
    let times: Option<Vec<f64>> = places.iter().map(|&p| frames.frames[p as usize].time_s).collect();
    let (unit, places) = match times {
        Some(times) if frames.is_video => ("time, s", times),
        _ => ("frame", places),
    };
    let first = ring.angles.first().copied().unwrap_or(0.0);
    let degrees = ring.angles.iter().map(|a| (a - first).to_degrees());
    let turned = Series::of(places.iter().copied().zip(degrees));
    figure(
        html,
        &charts::series([unit, "angle, °"], &[turned], true)?,
        "Angle about the axis of the cameras' circle",
    );
    if frames.is_video {
        let (rate, off) = ring.steadiness(&places);
        let off = Series::of(places.iter().copied().zip(off.iter().map(|o| o.to_degrees())));
        let caption = format!(
            "How far each angle is from a steady turn of {:.3}° a {}",
            rate.to_degrees(),
            if unit == "frame" { unit } else { "second" }
        );
        figure(html, &charts::series([unit, "off a steady turn, °"], &[off], true)?, &caption);
    }
    Ok(())
}

fn reprojection(
    html: &mut String,
    poses: &PoseSummary,
    model: &Reconstruction,
    errors: &BTreeMap<u32, Vec<f64>>,
) -> Result<()> {
    if errors.is_empty() {
        return Ok(());
    }
    let bar = |image: &scene::PosedImage| {
        let mut of_image = errors.get(&image.id).cloned().unwrap_or_default();
        of_image.sort_by(f64::total_cmp);
        let at = |q: f64| of_image.get(((of_image.len() as f64 - 1.0) * q) as usize).copied().unwrap_or(0.0);
        (at(0.5), at(0.95), poses.weak.iter().any(|w| w.0 == image.name))
    };
    let mut images: Vec<&scene::PosedImage> = model.images.values().collect();
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let bars: Vec<(f64, f64, bool)> = images.into_iter().map(bar).collect();
    let caption =
        "Reprojection error of each image, by name: median, 95 % below the whisker; weak ones in red";
    figure(html, &charts::bars(["image", "px"], &bars)?, caption);
    let all: Vec<f64> = errors.values().flatten().copied().collect();
    figure(html, &charts::error_histogram(&all)?, "Reprojection error (the last bar holds all above)");
    Ok(())
}

fn cameras(html: &mut String, poses: &PoseSummary, model: &Reconstruction) {
    let row = |camera: &scene::Camera| {
        let sigma = poses.deviations.as_ref().and_then(|d| d.cameras.get(&camera.id));
        let param = |(i, p): (usize, &f64)| match sigma.and_then(|s| s.get(i)).filter(|s| **s > 0.0) {
            Some(s) => {
                // Two digits of the deviation, and as many of the value.
                let digits = (1.0 - s.log10().floor()).clamp(0.0, 9.0) as usize;
                format!("{p:.digits$} ± {s:.digits$}")
            }
            None => format!("{p:.5}"),
        };
        let params: Vec<String> = camera.params.iter().enumerate().map(param).collect();
        let size = format!("{}×{}", camera.width, camera.height);
        vec![camera.id.to_string(), camera.model.name().to_owned(), size, params.join(", ")]
    };
    let rows: Vec<Vec<String>> = model.cameras.values().map(row).collect();
    html::table(html, &["camera", "model", "size", "parameters"], &rows);
}

/// Standard deviations of all poses, folded away under what is usual.
fn deviations(html: &mut String, known: &Deviations) {
    let largest = |v: &[f64; 3]| v.iter().fold(0.0_f64, |m, x| m.max(*x));
    let mut rotations: Vec<f64> = known.images.iter().map(|i| largest(&i.rotation_deg)).collect();
    rotations.sort_unstable_by(f64::total_cmp);
    let Some(worst) = rotations.last() else { return };
    *html += &format!(
        "<details><summary>Rotations are known to {:.4}° (median; worst {worst:.4}°) for sightings known to {:.2} px</summary>",
        rotations[rotations.len() / 2],
        known.sigma_px
    );
    let row = |image: &crate::pipeline::ImageDeviation| {
        let rotation = image.rotation_deg.map(|v| format!("{v:.4}")).join(", ");
        vec![escape(&image.name), rotation, image.centre.map(|v| format!("{v:.2e}")).join(", ")]
    };
    let rows: Vec<Vec<String>> = known.images.iter().map(row).collect();
    html::table(html, &["image", "σ rotation x, y, z, °", "σ centre x, y, z, scene units"], &rows);
    html.push_str("</details>");
}

fn figures(html: &mut String, poses: &PoseSummary) {
    let digits = |v: f64| if v.fract() == 0.0 { 0 } else { 2 };
    let rows: Vec<Vec<String>> =
        poses.figures.iter().map(|(name, v)| vec![escape(name), format!("{v:.*}", digits(*v))]).collect();
    if !rows.is_empty() {
        html.push_str("<details><summary>figures of the solver</summary>");
        html::table(html, &["figure", "value"], &rows);
        html.push_str("</details>");
    }
}
