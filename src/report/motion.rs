//! The report's motion: spin axis, rate, nutation and inertia of the object, and its rates over
//! time.

use super::charts::{self, Series};
use super::html::{self, figure};
use anyhow::Result;
use maud::{Markup, html};
use scene::motion_report::{Estimate, MotionReport};

/// The whole section.
pub(super) fn section(motion: &MotionReport) -> Result<Markup> {
    let rates = |size: &dyn Fn([f64; 3]) -> f64| {
        Series::of(motion.samples.iter().map(|s| (s.time_s, size(s.rate_deg_s))))
    };
    let length = |w: [f64; 3]| w.iter().map(|v| v * v).sum::<f64>().sqrt();
    let size = rates(&length);
    let chart = charts::series(["time, s", "rate, °/s"], &[size], false)?;
    Ok(html! {
        h2 { "Motion" }
        (html::table(&["", "value", "standard deviation"], &rows(motion)))
        div.row { (figure(chart, "Rate at which the object turns, at the images' times")) }
    })
}

fn rows(motion: &MotionReport) -> Vec<Vec<String>> {
    let direction = |axis: [f64; 3]| axis.map(|v| format!("{v:.4}")).join(", ");
    let mut rows = vec![
        row("rate, °/s", motion.rate_deg_s),
        vec![
            "spin axis, camera frame (x right, y down, z forward)".to_owned(),
            direction(motion.axis_camera),
            format!("{:.3}°", motion.axis_camera_deviation_deg),
        ],
        vec![
            "spin axis, frame of the model".to_owned(),
            direction(motion.axis_body),
            format!("{:.3}°", motion.axis_body_deviation_deg),
        ],
    ];
    if let Some(tumble) = &motion.tumble {
        rows.push(row("nutation, °", tumble.nutation_deg));
        rows.extend(tumble.period_s.map(|period| row("the body's rates repeat after, s", period)));
        let names = ["smallest over largest moment of inertia", "middle over largest moment of inertia"];
        rows.extend(names.iter().zip(tumble.inertia_ratios).map(|(name, ratio)| row(name, ratio)));
    }
    rows
}

/// A number with two digits of its standard deviation.
fn row(name: &str, estimate: Estimate) -> Vec<String> {
    let Estimate { value, deviation } = estimate;
    let digits = (1.0 - deviation.max(1e-9).log10().floor()).clamp(0.0, 6.0) as usize;
    vec![name.to_owned(), format!("{value:.digits$}"), format!("{deviation:.digits$}")]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_digits_that_their_deviation_allows() {
        assert_eq!(row("x", Estimate::new(12.3456, 0.0123)), ["x", "12.346", "0.012"]);
        assert_eq!(row("x", Estimate::new(12.3456, 3.0)), ["x", "12.3", "3.0"]);
    }
}
