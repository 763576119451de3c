//! The evaluation as a reader wants it: protocol, a line a view, percentiles, mean.

use super::metrics::{FIGURES, Figure};
use crate::record::{Evaluation, Metrics};

impl Evaluation {
    /// The figures that were measured.
    pub fn figures(&self) -> Vec<&'static Figure> {
        FIGURES.iter().filter(|f| (f.of)(&self.mean).is_some()).collect()
    }

    /// Rows of the table: a view, a percentile, the mean.
    pub fn rows(&self) -> Vec<(String, &Metrics)> {
        let views = self.views.iter().map(|v| (v.name.clone(), &v.metrics));
        let percentiles =
            self.percentiles.iter().map(|p| (format!("{} % of the views below", p.percent), &p.metrics));
        let training = self.training.as_ref();
        let training = training.map(|t| (format!("mean of {} training views", t.views), &t.mean));
        views
            .chain(percentiles)
            .chain(training)
            .chain([("mean of the held-out views".to_owned(), &self.mean)])
            .collect()
    }

    /// The protocol, the table and what rendering costs, as Markdown.
    pub fn markdown(&self) -> String {
        let figures = self.figures();
        let heads: Vec<&str> = figures.iter().map(|f| f.name).collect();
        let mut lines = vec![
            self.protocol.clone(),
            String::new(),
            format!("| view | {} |", heads.join(" | ")),
            format!("|---|{}", "---|".repeat(heads.len())),
        ];
        for (name, metrics) in self.rows() {
            let cells: Vec<String> = figures.iter().map(|f| f.shown(metrics)).collect();
            lines.push(format!("| {} | {} |", name.replace('|', "\\|"), cells.join(" | ")));
        }
        lines.extend([String::new(), self.rendering.sentence()]);
        lines.join("\n")
    }
}
