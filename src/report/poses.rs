//! The report's poses: cameras and points on a canvas, angles, reprojection errors, intrinsics.

use super::charts::{self, Series};
use super::html::{self, figure, folded};
use crate::record::{Deviations, PoseSummary, RunRecord};
use anyhow::Result;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use maud::{Markup, html};
use scene::overview::quantile;
use scene::{FrameSet, Overview, PosedImage, Reconstruction, RingSequence};
use serde::Serialize;
use std::collections::BTreeMap;

/// Most points that are shown. Source: chosen by hand, never measured.
const MOST_POINTS: usize = 4000;
/// The 16-bit number that stands for 1 in the shown frame: twice that still fits.
/// Source: derived, 2¹⁴ − 1.
const UNIT: f64 = 16383.0;
/// Points farther out are not shown, so that they fit 16 bits. Source: derived from [`UNIT`].
const FARTHEST: f64 = 1.9;

/// A camera as the canvas draws it.
#[derive(Serialize)]
struct ShownCamera {
    /// Centre and the four corners of its image plane, in the shown frame.
    corners: Vec<f64>,
    /// "held", "weak" or nothing.
    kind: &'static str,
    /// What is said of it.
    text: String,
}

/// What the canvas draws, in the frame of [`Overview`].
#[derive(Serialize)]
struct ShownModel {
    /// 16-bit numbers, three a point.
    points: String,
    /// sRGB bytes, three a point.
    colours: String,
    cameras: Vec<ShownCamera>,
}

/// Reprojection errors by image number, pixels.
type Errors = BTreeMap<u32, Vec<f64>>;

/// The whole section.
pub(super) fn section(
    record: &RunRecord,
    poses: &PoseSummary,
    model: Option<&Reconstruction>,
) -> Result<Markup> {
    let model = model.map(|model| solved(record, poses, model)).transpose()?;
    Ok(html! {
        h2 { "Poses" }
        (folded("frames without a pose", &named(&poses.missing, "has no pose")))
        (folded("weak frames", &named(&poses.weak, "is weakly constrained")))
        @if let Some(model) = model { (model) }
    })
}

fn named(list: &[(String, String)], what: &str) -> Vec<String> {
    list.iter().map(|(name, why)| format!("{name} {what}: {why}")).collect()
}

fn solved(record: &RunRecord, poses: &PoseSummary, model: &Reconstruction) -> Result<Markup> {
    let errors = model.reprojection_errors_by_image();
    let sequence = record.frames.as_ref().and_then(|frames| RingSequence::of(model, frames));
    let shown = html::json(&shown(record, poses, model, sequence.as_ref(), &errors))?;
    let mut charts = Vec::new();
    if let (Some(sequence), Some(frames)) = (&sequence, &record.frames) {
        charts.extend(angles(sequence, frames)?);
    }
    charts.extend(reprojection(poses, model, &errors)?);
    Ok(html! {
        p { (poses.registered) " of " (poses.total) " images, " (poses.points) " points." }
        div.poses {
            canvas id="poses" tabindex="0" aria-label="cameras and points" {}
            output {}
            script type="application/json" id="poses-data" { (shown) }
        }
        small.key {
            "Drag to rotate, use the wheel or two fingers to zoom, tap a camera to see its name."
            span { b style="background:#4da3ff" {} "training view" } " "
            span { b style="background:#ff9f1c" {} "held out" } " "
            span { b style="background:#ff4d4d" {} "weakly constrained" }
        }
        div.row { @for chart in &charts { (chart) } }
        (cameras(poses, model))
        @if let Some(known) = &poses.deviations { (deviations(known)) }
        (figures(poses))
    })
}

fn shown(
    record: &RunRecord,
    poses: &PoseSummary,
    model: &Reconstruction,
    sequence: Option<&RingSequence>,
    errors: &Errors,
) -> ShownModel {
    let overview = Overview::of(model, sequence.map(|s| &s.ring));
    let step = model.points.len().div_ceil(MOST_POINTS).max(1);
    let (mut points, mut colours) = (Vec::new(), Vec::new());
    for point in model.points.values().step_by(step) {
        let p = overview.shown_from_world.transform(point.position);
        if p.abs().max_element() < FARTHEST {
            p.to_array().iter().for_each(|v| points.extend(((v * UNIT) as i16).to_le_bytes()));
            colours.extend(point.rgb);
        }
    }
    let mut names: Vec<&str> = model.images.values().map(|i| i.name.as_str()).collect();
    names.sort_unstable();
    let cameras = model.images.values().filter_map(|image| {
        let corners = overview.frustum(model, image)?;
        let index = names.binary_search(&image.name.as_str()).unwrap_or(0);
        let is_held_out =
            record.splat.is_some() && record.config.dataset.holds_out(&image.name, index, names.len());
        let weak = poses.weak.iter().find(|w| w.0 == image.name);
        let kind = match (weak, is_held_out) {
            (Some(_), _) => "weak",
            (None, true) => "held",
            (None, false) => "",
        };
        let corners = corners.iter().flat_map(|c| c.to_array()).map(|v| (v * 1e4).round() / 1e4);
        let text = caption(image, errors.get(&image.id), weak.map(|w| w.1.as_str()));
        Some(ShownCamera { corners: corners.collect(), kind, text })
    });
    let cameras = cameras.collect();
    ShownModel { points: STANDARD.encode(points), colours: STANDARD.encode(colours), cameras }
}

fn caption(image: &PosedImage, errors: Option<&Vec<f64>>, weak: Option<&str>) -> String {
    let mut text = image.name.clone();
    if let Some(errors) = errors {
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        text += &format!(": {mean:.2} px over {} observations", errors.len());
    }
    text + &weak.map_or(String::new(), |why| format!("; weakly constrained: {why}"))
}

/// Angles about the axis against time or frame, and how far they are from a constant rate.
fn angles(sequence: &RingSequence, frames: &FrameSet) -> Result<Vec<Markup>> {
    let RingSequence { ring, places, .. } = sequence;
    let times: Option<Vec<f64>> = places.iter().map(|&p| frames.frames[p as usize].time_s).collect();
    let (axis, unit, places) = match times {
        Some(times) if frames.is_video => ("time, s", "second", times),
        _ => ("frame", "frame", places.clone()),
    };
    let first = ring.angles.first().copied().unwrap_or(0.0);
    let degrees = ring.angles.iter().map(|a| (a - first).to_degrees());
    let rotation = Series::of(places.iter().copied().zip(degrees));
    let chart = charts::series([axis, "angle, °"], &[rotation], true)?;
    let mut all = vec![figure(chart, "Angle about the axis of the cameras' circle")];
    if frames.is_video {
        let (rate, off) = ring.steadiness(&places);
        let off = Series::of(places.iter().copied().zip(off.iter().map(|o| o.to_degrees())));
        let caption =
            format!("Deviation of each angle from a constant rate of {:.3}° a {unit}", rate.to_degrees());
        all.push(figure(charts::series([axis, "deviation, °"], &[off], true)?, &caption));
    }
    Ok(all)
}

fn reprojection(poses: &PoseSummary, model: &Reconstruction, errors: &Errors) -> Result<Vec<Markup>> {
    if errors.is_empty() {
        return Ok(Vec::new());
    }
    let mut images: Vec<&PosedImage> = model.images.values().collect();
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let bars: Vec<(f64, f64, bool)> = images
        .into_iter()
        .map(|image| {
            let of_image = errors.get(&image.id).cloned().unwrap_or_default();
            let [median, high] = [0.5, 0.95].map(|share| quantile(of_image.clone(), share).unwrap_or(0.0));
            (median, high, poses.weak.iter().any(|w| w.0 == image.name))
        })
        .collect();
    let caption = "Reprojection error of each image, by name: median, and the whisker below which 95 % lie; \
                   weakly constrained images in red";
    let all: Vec<f64> = errors.values().flatten().copied().collect();
    Ok(vec![
        figure(charts::bars(["image", "px"], &bars)?, caption),
        figure(charts::error_histogram(&all)?, "Reprojection error (the last bar holds all larger ones)"),
    ])
}

fn cameras(poses: &PoseSummary, model: &Reconstruction) -> Markup {
    let known = poses.deviations.as_ref();
    let rows: Vec<Vec<String>> = model
        .cameras
        .values()
        .map(|camera| {
            let deviations = known.and_then(|d| d.cameras.get(&camera.id)).map_or(&[][..], Vec::as_slice);
            let params = camera.params.iter().enumerate().map(|(i, p)| parameter(*p, deviations.get(i)));
            let params: Vec<String> = params.collect();
            let size = format!("{}×{}", camera.width, camera.height);
            vec![camera.id.to_string(), camera.model.name().to_owned(), size, params.join(", ")]
        })
        .collect();
    html::table(&["camera", "model", "size", "parameters"], &rows)
}

/// A parameter with two digits of its standard deviation, where that is known.
fn parameter(value: f64, deviation: Option<&f64>) -> String {
    match deviation.filter(|s| **s > 0.0) {
        Some(deviation) => {
            let digits = (1.0 - deviation.log10().floor()).clamp(0.0, 9.0) as usize;
            format!("{value:.digits$} ± {deviation:.digits$}")
        }
        None => format!("{value:.5}"),
    }
}

/// Standard deviations of all poses, folded behind the median.
fn deviations(known: &Deviations) -> Markup {
    let rotations: Vec<f64> =
        known.images.iter().map(|i| i.rotation_deg.iter().copied().fold(0.0, f64::max)).collect();
    let Some(median) = quantile(rotations.clone(), 0.5) else { return Markup::default() };
    let worst = rotations.into_iter().fold(0.0, f64::max);
    let rows: Vec<Vec<String>> = known
        .images
        .iter()
        .map(|image| {
            let rotation = image.rotation_deg.map(|v| format!("{v:.4}")).join(", ");
            vec![image.name.clone(), rotation, image.centre.map(|v| format!("{v:.2e}")).join(", ")]
        })
        .collect();
    html! {
        details {
            summary {
                (format!("Standard deviation of the rotations: median {median:.4}°, at most {worst:.4}°, "))
                (format!("for observations with {:.2} px", known.sigma_px))
            }
            (html::table(&["image", "σ rotation x, y, z, °", "σ centre x, y, z, scene units"], &rows))
        }
    }
}

fn figures(poses: &PoseSummary) -> Markup {
    let rows: Vec<Vec<String>> = poses
        .figures
        .iter()
        .map(|(name, value)| {
            let digits = if value.fract() == 0.0 { 0 } else { 2 };
            vec![name.clone(), format!("{value:.digits$}")]
        })
        .collect();
    html! {
        @if !rows.is_empty() {
            details {
                summary { "figures of the solver" }
                (html::table(&["figure", "value"], &rows))
            }
        }
    }
}
