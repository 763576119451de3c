//! Measures as tables.

use super::record::MeasureRecord;
use scene::motion_report::Estimate;
use shape::measure::{Feature, FeatureKind, Size};
use std::fmt::Write as _;

/// The name of a shape in tables and the drawing.
pub(super) fn name(features: &[Feature], index: usize) -> String {
    let letter = match features[index].kind {
        FeatureKind::Plane => "P",
        FeatureKind::Disc => "D",
        FeatureKind::Cylinder => "C",
    };
    format!("{letter}{}", index + 1)
}

/// A value with its deviation, both to the deviation's second digit.
pub(super) fn with_deviation(e: Estimate) -> String {
    let finest = e.deviation.max(e.value.abs() * 1e-4).max(f64::MIN_POSITIVE);
    let digits = 1.0 - finest.log10().floor();
    if !(-3.0..=6.0).contains(&digits) {
        return format!("{:.4e} ± {:.1e}", e.value, e.deviation);
    }
    let digits = digits.max(0.0) as usize;
    format!("{:.digits$} ± {:.digits$}", e.value, e.deviation)
}

/// The sides of the box: name, value and deviation.
pub(crate) fn overall_rows(record: &MeasureRecord) -> Vec<Vec<String>> {
    let sides = ["longest side", "middle side", "shortest side"].iter().zip(record.measures.overall.sides);
    sides.map(|(name, side)| vec![(*name).to_owned(), with_deviation(side)]).collect()
}

/// A row a shape: name, kind, sizes, direction, share of the area, scatter.
pub(crate) fn shape_rows(record: &MeasureRecord) -> Vec<Vec<String>> {
    let features = &record.measures.features;
    let rows = features.iter().enumerate().map(|(i, f)| {
        let kind = match f.kind {
            FeatureKind::Plane => "plane",
            FeatureKind::Disc => "disc",
            FeatureKind::Cylinder => "cylinder",
        };
        let sizes: Vec<String> = f.sizes.iter().map(size).collect();
        let round = f.coverage_deg.map_or(String::new(), |c| format!(", {c:.0}° of it"));
        vec![
            name(features, i),
            kind.to_owned(),
            sizes.join(", ") + &round,
            format!("{:.3} {:.3} {:.3} ± {:.2}°", f.axis[0], f.axis[1], f.axis[2], f.axis_deviation_deg),
            format!("{:.1}", 100.0 * f.area / record.measures.area),
            format!("{:.2}", 100.0 * f.rms / record.measures.overall.sides[0].value),
        ]
    });
    rows.collect()
}

fn size(size: &Size) -> String {
    let what = match size {
        Size::Length(_) => "length",
        Size::Width(_) => "width",
        Size::Diameter(_) => "diameter",
    };
    format!("{what} {}", with_deviation(size.estimate()))
}

/// A row each two shapes: names, angle, distance.
pub(crate) fn relation_rows(record: &MeasureRecord) -> Vec<Vec<String>> {
    let features = &record.measures.features;
    let rows = record.measures.relations.iter().map(|r| {
        vec![
            r.between.map(|i| name(features, i)).join(" – "),
            format!("{:.2} ± {:.2}", r.angle_deg.value, r.angle_deg.deviation),
            r.distance.map_or(String::new(), with_deviation),
        ]
    });
    rows.collect()
}

/// All of it for a terminal.
pub(super) fn text(record: &MeasureRecord) -> String {
    let unit = record.unit_name();
    let mut out = format!("overall, {unit}\n{}", aligned(&[], &overall_rows(record)));
    let heads = ["", "shape", &format!("sizes, {unit}"), "normal or axis", "% of area", "rms, % of size"];
    let _ = write!(out, "\n{}", aligned(&heads, &shape_rows(record)));
    let heads = ["between", "angle, °", &format!("distance, {unit}")];
    let _ = write!(out, "\n{}", aligned(&heads, &relation_rows(record)));
    out.trim_end().to_owned()
}

fn aligned(heads: &[&str], rows: &[Vec<String>]) -> String {
    let heads: Vec<String> = heads.iter().map(|h| (*h).to_owned()).collect();
    let all: Vec<&Vec<String>> = [&heads].into_iter().filter(|h| !h.is_empty()).chain(rows).collect();
    let columns = all.iter().map(|r| r.len()).max().unwrap_or(0);
    let width = |k: usize| all.iter().filter_map(|r| r.get(k)).map(|c| c.chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let mut out = String::new();
    for row in all {
        let cells: Vec<String> = row.iter().zip(&widths).map(|(cell, w)| format!("{cell:<w$}")).collect();
        let _ = writeln!(out, "{}", cells.join("  ").trim_end());
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_the_digits_that_their_deviation_allows() {
        assert_eq!(with_deviation(Estimate::new(1.234_56, 0.0123)), "1.235 ± 0.012");
        assert_eq!(with_deviation(Estimate::new(123.456, 20.0)), "123 ± 20");
        assert_eq!(with_deviation(Estimate::new(1.5e-6, 2e-8)), "1.5000e-6 ± 2.0e-8");
        assert_eq!(with_deviation(Estimate::new(0.0, 0.0)), "0.0000e0 ± 0.0e0");
    }

    #[test]
    fn columns_are_as_wide_as_their_widest_cell() {
        let rows = [vec!["a".to_owned(), "±x".to_owned(), "1".to_owned()]];
        assert_eq!(aligned(&["long", "b", "c"], &rows), "long  b   c\na     ±x  1\n");
    }
}
