//! The reports' charts, as inline SVG by plotters.

use anyhow::{Result, anyhow};
use plotters::prelude::*;
use std::ops::Range;

/// Width and height of a chart, pixels. Source: chosen by hand, never measured.
const SIZE: (u32, u32) = (460, 320);
const GREY: RGBColor = RGBColor(0x99, 0x99, 0x99);
const RED: RGBColor = RGBColor(0xd6, 0x27, 0x28);
/// Of series, in order.
const COLOURS: [RGBColor; 6] = [
    RGBColor(0x1f, 0x77, 0xb4),
    RGBColor(0xff, 0x7f, 0x0e),
    RGBColor(0x2c, 0xa0, 0x2c),
    RGBColor(0x94, 0x67, 0xbd),
    RGBColor(0x8c, 0x56, 0x4b),
    RGBColor(0xe3, 0x77, 0xc2),
];

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
type Chart<'a, 'b> = ChartContext<
    'a,
    SVGBackend<'b>,
    Cartesian2d<plotters::coord::types::RangedCoordf64, plotters::coord::types::RangedCoordf64>,
>;

/// Points under a name.
#[derive(Clone, Debug, Default)]
pub(crate) struct Series {
    /// Shown where there are several.
    pub name: String,
    /// x, y.
    pub points: Vec<(f64, f64)>,
}

impl Series {
    /// Without a name.
    pub(crate) fn of(points: impl Iterator<Item = (f64, f64)>) -> Self {
        Self { name: String::new(), points: points.collect() }
    }
}

fn svg(draw: impl FnOnce(&Area<'_>) -> Result<()>) -> Result<String> {
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
        draw(&area)?;
        area.present().map_err(|e| anyhow!("{e}"))?;
    }
    Ok(text)
}

/// Widens an interval by a twentieth on either side; an empty one becomes [-1, 1].
fn padded(values: impl Iterator<Item = f64>) -> Range<f64> {
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

/// Digits that labels of a range need: small numbers need theirs, large ones none.
fn digits(range: &Range<f64>) -> usize {
    (1.0 - (range.end - range.start).max(1e-9).log10()).ceil().clamp(0.0, 6.0) as usize
}

fn axes<'a, 'b>(
    area: &'a Area<'b>,
    x: Range<f64>,
    y: Range<f64>,
    [x_name, y_name]: [&str; 2],
) -> Result<Chart<'a, 'b>> {
    let (dx, dy) = (digits(&x), digits(&y));
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .x_label_area_size(44)
        .y_label_area_size(68)
        .build_cartesian_2d(x, y)
        .map_err(|e| anyhow!("{e}"))?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GREY.mix(0.3))
        .x_label_formatter(&|v| format!("{v:.dx$}"))
        .y_label_formatter(&|v| format!("{v:.dy$}"))
        .x_labels(8)
        .label_style(("sans-serif", 15))
        .axis_desc_style(("sans-serif", 16))
        .x_desc(x_name)
        .y_desc(y_name)
        .draw()
        .map_err(|e| anyhow!("{e}"))?;
    Ok(chart)
}

/// Lines, or dots where the order along x means nothing; with a key where there are several.
pub(crate) fn series(names: [&str; 2], all: &[Series], as_dots: bool) -> Result<String> {
    let points = || all.iter().flat_map(|s| &s.points);
    let (x, y) = (padded(points().map(|p| p.0)), padded(points().map(|p| p.1)));
    svg(|area| {
        let mut chart = axes(area, x, y, names)?;
        for (one, colour) in all.iter().zip(COLOURS.iter().cycle()) {
            let drawn = if as_dots {
                chart.draw_series(one.points.iter().map(|p| Circle::new(*p, 2, colour.filled())))
            } else {
                chart.draw_series(LineSeries::new(one.points.clone(), colour.stroke_width(2)))
            };
            let drawn = drawn.map_err(|e| anyhow!("{e}"))?;
            if all.len() > 1 {
                let mark = move |(x, y)| Rectangle::new([(x, y - 4), (x + 12, y + 4)], colour.filled());
                drawn.label(one.name.clone()).legend(mark);
            }
        }
        if all.len() > 1 {
            chart
                .configure_series_labels()
                .background_style(WHITE.mix(0.8))
                .label_font(("sans-serif", 15))
                .draw()
                .map_err(|e| anyhow!("{e}"))?;
        }
        Ok(())
    })
}

/// A bar for each, from zero to its first number, with a whisker to its second; the marked ones in
/// red.
pub(crate) fn bars(names: [&str; 2], all: &[(f64, f64, bool)]) -> Result<String> {
    let top = all.iter().map(|b| b.1).filter(|v| v.is_finite()).fold(0.0, f64::max).max(1e-9) * 1.05;
    svg(|area| {
        let mut chart = axes(area, 0.5..all.len().max(1) as f64 + 0.5, 0.0..top, names)?;
        let placed = || {
            all.iter().enumerate().map(|(i, &(value, high, is_marked))| {
                (i as f64 + 1.0, value, high, if is_marked { RED } else { COLOURS[0] })
            })
        };
        let bars = placed()
            .map(|(x, value, _, colour)| Rectangle::new([(x - 0.4, 0.0), (x + 0.4, value)], colour.filled()));
        chart.draw_series(bars).map_err(|e| anyhow!("{e}"))?;
        let whiskers = placed()
            .map(|(x, value, high, colour)| PathElement::new(vec![(x, value), (x, high)], colour.mix(0.5)));
        chart.draw_series(whiskers).map_err(|e| anyhow!("{e}"))?;
        Ok(())
    })
}

/// Bars of the histogram. Source: chosen by hand, never measured.
const BINS: usize = 40;
/// Errors from here on are in the last bar, pixels. Source: chosen by hand, never measured.
const LARGEST_ERROR: f64 = 4.0;

/// Histogram of errors, pixels; the last bar holds all above.
pub(crate) fn error_histogram(errors: &[f64]) -> Result<String> {
    let mut counts = [0_u32; BINS];
    for e in errors {
        counts[((e / LARGEST_ERROR * BINS as f64) as usize).min(BINS - 1)] += 1;
    }
    let top = f64::from(counts.iter().copied().max().unwrap_or(1).max(1)) * 1.05;
    svg(|area| {
        let mut chart = axes(area, 0.0..LARGEST_ERROR, 0.0..top, ["reprojection error, px", "observations"])?;
        let width = LARGEST_ERROR / BINS as f64;
        let bars = counts.iter().enumerate().map(|(i, &n)| {
            let left = i as f64 * width;
            Rectangle::new([(left, 0.0), (left + width, f64::from(n))], COLOURS[0].filled())
        });
        chart.draw_series(bars).map_err(|e| anyhow!("{e}"))?;
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn charts_hold_their_series_and_stand_numbers_that_are_none() {
        let named = |name: &str, y: f64| Series { name: name.into(), points: vec![(0.0, 1.0), (1.0, y)] };
        let text =
            series(["time", "PSNR"], &[named("first", 2.0), named("second", f64::NAN)], false).unwrap();
        assert!(text.contains("first") && text.contains("second") && text.contains("PSNR"), "{text}");
        assert!(series(["x", "y"], &[Series::default()], true).unwrap().starts_with("<svg"));
        assert!(bars(["image", "px"], &[(0.5, 0.9, true)]).unwrap().contains("#D62728"));
        assert!(bars(["image", "px"], &[]).unwrap().starts_with("<svg"));
    }
}
