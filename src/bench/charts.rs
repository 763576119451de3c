//! The charts of a sweep, one SVG. (plotters, as in the report: axes, scales and text are its
//! work.)

use super::point::Point;
use anyhow::{Result, anyhow};
use plotters::coord::Shift;
use plotters::prelude::*;
use std::collections::BTreeMap;

/// Width and height of a chart, pixels. Source: chosen by hand, never measured.
const CHART: (u32, u32) = (480, 360);
/// Charts beside each other. Source: chosen by hand, never measured.
const COLUMNS: usize = 3;
const OURS: RGBColor = RGBColor(0x1f, 0x77, 0xb4);
const THEIRS: [RGBColor; 4] = [
    RGBColor(0xff, 0x7f, 0x0e),
    RGBColor(0x2c, 0xa0, 0x2c),
    RGBColor(0x94, 0x67, 0xbd),
    RGBColor(0x8c, 0x56, 0x4b),
];
const GREY: RGBColor = RGBColor(0x99, 0x99, 0x99);

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// A figure of a point.
type Pick = fn(&Point) -> Option<f64>;

/// All charts: what is along x and what is along y.
fn panels() -> Vec<((&'static str, Pick), (&'static str, Pick))> {
    let wall: (&str, Pick) = ("wall time, s", |p| p.wall_s);
    let cpu: (&str, Pick) = ("CPU time, s", |p| p.cpu_s);
    let gaussians: (&str, Pick) = ("gaussians", |p| p.gaussians.map(|n| n as f64));
    let memory: (&str, Pick) = ("peak memory, MiB", |p| p.peak_mib);
    let psnr: (&str, Pick) = ("PSNR, dB", |p| Some(p.psnr));
    let ssim: (&str, Pick) = ("SSIM", |p| p.ssim);
    let lpips: (&str, Pick) = ("LPIPS", |p| p.lpips);
    let mut all: Vec<_> = [wall, cpu, gaussians, memory].map(|x| (x, psnr)).into();
    all.extend([wall, cpu, gaussians, memory].map(|x| (x, ssim)));
    all.extend([wall, cpu, gaussians, memory].map(|x| (x, lpips)));
    all
}

/// Every chart for which there are figures; x is logarithmic.
pub(crate) fn draw(points: &[Point], peers: &[Point]) -> Result<String> {
    let mut wanted = panels();
    wanted.retain(|((_, x), (_, y))| {
        let mut places = points.iter().filter_map(|p| Some((x(p)?, y(p)?)));
        places.any(|(x, y)| x > 0.0 && x.is_finite() && y.is_finite())
    });
    let rows = wanted.len().div_ceil(COLUMNS).max(1);
    let mut text = String::new();
    {
        let size = (CHART.0 * COLUMNS as u32, CHART.1 * rows as u32);
        let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
        area.fill(&WHITE).map_err(|e| anyhow!("{e}"))?;
        for ((x, y), cell) in wanted.iter().zip(area.split_evenly((rows, COLUMNS))) {
            panel(&cell, *x, *y, points, peers).map_err(|e| anyhow!("{e}"))?;
        }
        area.present().map_err(|e| anyhow!("{e}"))?;
    }
    Ok(text)
}

/// The least and the largest value.
fn bounds(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
}

fn panel(
    area: &Area,
    (x_name, x): (&str, Pick),
    (y_name, y): (&str, Pick),
    points: &[Point],
    peers: &[Point],
) -> std::result::Result<(), Box<dyn std::error::Error>> {
    let all: Vec<(f64, f64)> =
        points.iter().chain(peers).filter_map(|p| Some((x(p).filter(|v| *v > 0.0)?, y(p)?))).collect();
    let (x0, x1) = bounds(all.iter().map(|p| p.0));
    let (y0, y1) = bounds(all.iter().map(|p| p.1));
    let pad = ((y1 - y0) * 0.12).max(y1.abs() * 1e-3);
    let mut chart =
        ChartBuilder::on(area).margin(10).x_label_area_size(34).y_label_area_size(54).build_cartesian_2d(
            (x0 / 1.3..x1 * 1.6).log_scale().with_key_points(ticks(x0 / 1.3, x1 * 1.6)),
            y0 - pad..y1 + pad,
        )?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GREY.mix(0.3))
        .x_labels(6)
        .x_label_formatter(&|v| short(*v))
        .x_desc(x_name)
        .y_desc(y_name)
        .draw()?;
    let mut methods: BTreeMap<&str, Vec<&Point>> = BTreeMap::new();
    peers.iter().for_each(|p| methods.entry(&p.method).or_default().push(p));
    let theirs = methods.into_iter().zip(THEIRS.iter().cycle()).map(|((_, p), colour)| (p, *colour));
    let groups = theirs.chain([(points.iter().collect::<Vec<_>>(), OURS)]);
    for (group, colour) in groups {
        for (index, p) in group.iter().enumerate() {
            let (Some(x), Some(y)) = (x(p).filter(|v| *v > 0.0), y(p)) else { continue };
            // Another tool's name once is enough; ours say which setting they are.
            let label = match (colour == OURS, index) {
                (true, _) => p.setting.clone(),
                (false, 0) => p.method.clone(),
                _ => String::new(),
            };
            chart.draw_series([EmptyElement::at((x, y))
                + Circle::new((0, 0), 4, colour.filled())
                + Text::new(label, (7, -6), ("sans-serif", 11).into_font().color(&colour))])?;
        }
    }
    Ok(())
}

/// Round numbers from `from` to `to` on a logarithmic axis: within a decade many, then 1, 2 and 5
/// of each, of many decades their beginnings.
fn ticks(from: f64, to: f64) -> Vec<f64> {
    let decades = from.log10().floor() as i32..=to.log10().ceil() as i32;
    let steps: &[f64] = match to / from {
        span if span > 300.0 => &[1.0],
        span if span > 8.0 => &[1.0, 2.0, 5.0],
        _ => &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0],
    };
    let all = decades.flat_map(|d| steps.iter().map(move |s| s * 10f64.powi(d)));
    all.filter(|v| (from..=to).contains(v)).collect()
}

/// 1500 → 1.5k.
fn short(v: f64) -> String {
    match v {
        v if v >= 1e6 => format!("{}M", v / 1e6),
        v if v >= 1e3 => format!("{}k", v / 1e3),
        v => format!("{}", (v * 1e3).round() / 1e3),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_figure_that_is_known_has_its_chart_and_every_setting_its_name() {
        let point = |setting: &str, wall: f64, psnr: f64| Point {
            method: "sat-recon".into(),
            setting: setting.into(),
            wall_s: Some(wall),
            cpu_s: Some(2.0 * wall),
            gaussians: Some(20_000),
            psnr,
            ssim: Some(0.9),
            ..Point::default()
        };
        let peer =
            Point { method: "another tool".into(), cpu_s: Some(200.0), psnr: 25.0, ..Point::default() };
        let svg = draw(&[point("fast", 15.0, 30.0), point("60 s", 60.0, 32.0)], &[peer]).unwrap();
        for text in ["fast", "60 s", "another tool", "PSNR, dB", "SSIM", "CPU time, s", "gaussians"] {
            assert!(svg.contains(text), "{text} is missing");
        }
        assert!(!svg.contains("LPIPS") && !svg.contains("peak memory"), "no figures, no chart");
        assert_eq!(ticks(260.0, 900.0), [300.0, 400.0, 500.0, 600.0, 800.0]);
        assert_eq!(ticks(1.5, 150.0), [2.0, 5.0, 10.0, 20.0, 50.0, 100.0]);
        assert_eq!(ticks(0.9, 2000.0), [1.0, 10.0, 100.0, 1000.0]);
        assert_eq!((short(1500.0), short(0.25), short(2e6)), ("1.5k".into(), "0.25".into(), "2M".into()));
    }
}
