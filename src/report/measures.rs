//! The report's measures, which `sat-recon measure` puts into it.

use super::html::{self, figure};
use crate::measure::record::{DRAWING, MeasureRecord};
use crate::measure::table::{overall_rows, relation_rows, shape_rows};
use crate::stage::write_whole;
use anyhow::{Context, Result};
use maud::{Markup, PreEscaped, html};
use std::path::Path;

/// Where the measures begin and end in a report.
const MARKS: [&str; 2] = ["<!-- measures -->", "<!-- end of measures -->"];

/// The section, or where it would be.
pub(super) fn section(out: &Path) -> Markup {
    let inside = MeasureRecord::of_run(out).map(|record| measures(out, &record));
    html! {
        (PreEscaped(MARKS[0]))
        @if let Some(inside) = inside { (inside) }
        (PreEscaped(MARKS[1]))
    }
}

/// Puts the measures of a run into its report, where there is one.
pub(crate) fn put_measures(out: &Path) -> Result<()> {
    let path = out.join("report.html");
    if !path.is_file() {
        return Ok(());
    }
    let page = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let [begin, end] = MARKS.map(|mark| page.find(mark));
    let (Some(begin), Some(end)) = (begin, end) else { return Ok(()) };
    if begin > end {
        return Ok(());
    }
    let after = &page[end + MARKS[1].len()..];
    let whole = format!("{}{}{after}", &page[..begin], section(out).into_string());
    write_whole(&path, whole.as_bytes())
}

fn measures(out: &Path, record: &MeasureRecord) -> Markup {
    let unit = record.unit_name();
    let drawing = std::fs::read_to_string(out.join(DRAWING)).ok();
    let sizes = format!("sizes, {unit}");
    let heads = ["", "shape", &sizes, "normal or axis", "% of area", "rms, % of size"];
    let distance = format!("distance, {unit}");
    html! {
        h2 { "Measures" }
        p {
            "Of " (record.surface) ". Standard deviations are those of the surface about its shapes; "
            "that of the scale is not in them."
        }
        @if let Some(svg) = drawing { (figure(svg, "From three sides; the rest is grey")) }
        (html::table(&["overall", unit], &overall_rows(record)))
        (html::table(&heads, &shape_rows(record)))
        details {
            summary { "angles and distances" }
            (html::table(&["between", "angle, °", &distance], &relation_rows(record)))
        }
    }
}
