//! The report's charts, as inline SVG.

use anyhow::{Result, anyhow};
use plotters::prelude::*;
use scene::Reconstruction;
use splat::train::CurvePoint;

const SIZE: (u32, u32) = (460, 320);
const BLUE: RGBColor = RGBColor(0x1f, 0x77, 0xb4);
const ORANGE: RGBColor = RGBColor(0xff, 0x7f, 0x0e);
const GREY: RGBColor = RGBColor(0x99, 0x99, 0x99);

fn svg(draw: impl FnOnce(&DrawingArea<SVGBackend, plotters::coord::Shift>) -> Result<()>) -> Result<String> {
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
        draw(&area)?;
        area.present().map_err(|e| anyhow!("{e}"))?;
    }
    Ok(text)
}

/// Widens an interval by a twentieth on either side; an empty one becomes [-1, 1].
fn padded(values: impl Iterator<Item = f64>) -> std::ops::Range<f64> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for v in values.filter(|v| v.is_finite()) {
        low = low.min(v);
        high = high.max(v);
    }
    if low > high {
        return -1.0..1.0;
    }
    let pad = ((high - low) * 0.05).max(high.abs().max(1e-9) * 1e-3);
    low - pad..high + pad
}

/// Two of the three coordinates as seen along the third, same scale on both axes.
fn equal_axes(points: &[(f64, f64)]) -> (std::ops::Range<f64>, std::ops::Range<f64>) {
    let (x, y) = (padded(points.iter().map(|p| p.0)), padded(points.iter().map(|p| p.1)));
    let aspect = f64::from(SIZE.0) / f64::from(SIZE.1);
    let (wx, wy) = (x.end - x.start, (y.end - y.start) * aspect);
    let half = wx.max(wy) / 2.0;
    let (cx, cy) = ((x.start + x.end) / 2.0, (y.start + y.end) / 2.0);
    (cx - half..cx + half, cy - half / aspect..cy + half / aspect)
}

/// The camera ring and the points, seen along the cameras' common axis (`from_above`) or from the side.
pub fn camera_map(reconstruction: &Reconstruction, from_above: bool) -> Result<String> {
    let frame = principal_frame(reconstruction);
    let flat = |p: glam::DVec3| {
        let q = frame * p;
        if from_above { (q.x, q.y) } else { (q.x, q.z) }
    };
    let centres: Vec<_> = reconstruction.images.values().map(|i| (flat(i.pose.centre()), i.pose)).collect();
    let scale = padded(centres.iter().map(|c| c.0.0));
    let arrow = (scale.end - scale.start) * 0.06;
    let step = (reconstruction.points.len() / 3000).max(1);
    let mut points: Vec<_> =
        reconstruction.points.values().step_by(step).map(|p| (flat(p.position), p.rgb)).collect();
    let reach = points_reach(&points, &centres.iter().map(|c| c.0).collect::<Vec<_>>());
    points.retain(|(p, _)| p.0.abs() <= reach && p.1.abs() <= reach);
    let all: Vec<_> = centres.iter().map(|c| c.0).chain(points.iter().map(|p| p.0)).collect();
    let (x, y) = equal_axes(&all);
    svg(|area| {
        let mut chart =
            ChartBuilder::on(area).margin(8).build_cartesian_2d(x, y).map_err(|e| anyhow!("{e}"))?;
        let dots = points.iter().map(|(p, c)| Circle::new(*p, 1, RGBColor(c[0], c[1], c[2]).filled()));
        chart.draw_series(dots).map_err(|e| anyhow!("{e}"))?;
        for (centre, pose) in &centres {
            let tip = flat(pose.centre() + pose.view_direction() * arrow);
            chart
                .draw_series([PathElement::new(vec![*centre, tip], BLUE.stroke_width(2))])
                .map_err(|e| anyhow!("{e}"))?;
        }
        chart
            .draw_series(centres.iter().map(|c| Circle::new(c.0, 3, BLUE.filled())))
            .map_err(|e| anyhow!("{e}"))?;
        Ok(())
    })
}

/// Points far outside the cameras' reach would shrink the ring to a dot: where to cut.
fn points_reach(points: &[((f64, f64), [u8; 3])], centres: &[(f64, f64)]) -> f64 {
    let largest = centres.iter().map(|c| c.0.abs().max(c.1.abs())).fold(0.0, f64::max);
    let mut radii: Vec<f64> = points.iter().map(|p| p.0.0.abs().max(p.0.1.abs())).collect();
    radii.sort_by(f64::total_cmp);
    let most = radii.get(radii.len() * 9 / 10).copied().unwrap_or(0.0);
    (2.0 * largest).max(largest.max(1e-12)).min(largest.max(most) * 1.5)
}

/// Rows: the two directions in which the camera centres spread most, then the one in which they spread least.
fn principal_frame(reconstruction: &Reconstruction) -> glam::DMat3 {
    let centres: Vec<glam::DVec3> = reconstruction.images.values().map(|i| i.pose.centre()).collect();
    let mean = centres.iter().sum::<glam::DVec3>() / centres.len().max(1) as f64;
    let mut covariance = glam::DMat3::ZERO;
    for c in &centres {
        let d = *c - mean;
        covariance += glam::DMat3::from_cols(d * d.x, d * d.y, d * d.z);
    }
    let first = power_iteration(covariance, glam::DVec3::new(1.0, 0.3, 0.1));
    let rest = covariance
        - glam::DMat3::from_cols(first * first.x, first * first.y, first * first.z)
            * (covariance * first).dot(first);
    let start = first.any_orthonormal_vector();
    let second = power_iteration(rest, start);
    let second = (second - first * first.dot(second)).try_normalize().unwrap_or(start);
    let mut third = first.cross(second);
    // Up in most pictures is up in the side view.
    let up: glam::DVec3 =
        reconstruction.images.values().map(|i| i.pose.rotation.conjugate() * -glam::DVec3::Y).sum();
    if third.dot(up) < 0.0 {
        third = -third;
    }
    glam::DMat3::from_cols(first, second, third).transpose()
}

fn power_iteration(m: glam::DMat3, start: glam::DVec3) -> glam::DVec3 {
    let mut v = start;
    for _ in 0..100 {
        match (m * v).try_normalize() {
            Some(next) => v = next,
            None => return start.normalize_or(glam::DVec3::X),
        }
    }
    v
}

/// Histogram of reprojection errors up to four pixels.
pub fn error_histogram(errors: &[f64]) -> Result<String> {
    const BINS: usize = 40;
    let mut counts = [0_u32; BINS];
    for e in errors {
        counts[((e / 4.0 * BINS as f64) as usize).min(BINS - 1)] += 1;
    }
    let top = f64::from(counts.iter().copied().max().unwrap_or(1).max(1)) * 1.05;
    svg(|area| {
        let mut chart = axes(area, 0.0..4.0, 0.0..top, "reprojection error, px", "sightings")?;
        let bars = counts.iter().enumerate().map(|(i, &n)| {
            let x = |i: usize| i as f64 * 4.0 / BINS as f64;
            Rectangle::new([(x(i), 0.0), (x(i + 1), f64::from(n))], BLUE.filled())
        });
        chart.draw_series(bars).map_err(|e| anyhow!("{e}"))?;
        Ok(())
    })
}

type Chart<'a, 'b> = ChartContext<
    'a,
    SVGBackend<'b>,
    Cartesian2d<plotters::coord::types::RangedCoordf64, plotters::coord::types::RangedCoordf64>,
>;

fn axes<'a, 'b>(
    area: &'a DrawingArea<SVGBackend<'b>, plotters::coord::Shift>,
    x: std::ops::Range<f64>,
    y: std::ops::Range<f64>,
    x_name: &str,
    y_name: &str,
) -> Result<Chart<'a, 'b>> {
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .x_label_area_size(32)
        .y_label_area_size(52)
        .build_cartesian_2d(x, y)
        .map_err(|e| anyhow!("{e}"))?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GREY.mix(0.3))
        .x_desc(x_name)
        .y_desc(y_name)
        .draw()
        .map_err(|e| anyhow!("{e}"))?;
    Ok(chart)
}

/// A training curve: `pick` chooses loss or PSNR.
pub fn training_curve(curve: &[CurvePoint], name: &str, pick: impl Fn(&CurvePoint) -> f64) -> Result<String> {
    let points: Vec<(f64, f64)> = curve.iter().map(|p| (p.seconds, pick(p))).collect();
    let x = padded(points.iter().map(|p| p.0).chain([0.0]));
    let y = padded(points.iter().map(|p| p.1));
    svg(|area| {
        let mut chart = axes(area, x, y, "training time, s", name)?;
        chart.draw_series(LineSeries::new(points, ORANGE.stroke_width(2))).map_err(|e| anyhow!("{e}"))?;
        Ok(())
    })
}
