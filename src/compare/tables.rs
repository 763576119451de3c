//! Tables as in papers: methods as rows, cases as column groups, the best of each column in bold.

use serde::{Deserialize, Serialize};
use std::fmt::Write as _;

/// Heading and rows of the table of poses.
pub(crate) type Cells = (Vec<&'static str>, Vec<Vec<String>>);

/// A column of every case.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TableColumn {
    /// Heading, with its unit.
    pub name: String,
    /// Digits behind the point.
    pub digits: usize,
    /// Whether more is better.
    pub more_is_better: bool,
}

/// Numbers by method, case and column.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Table {
    /// What it is about.
    pub title: String,
    /// Rows.
    pub methods: Vec<String>,
    /// TableColumn groups.
    pub cases: Vec<String>,
    /// Columns of each group.
    pub columns: Vec<TableColumn>,
    /// [methods × cases × columns].
    pub values: Vec<Vec<Vec<Option<f64>>>>,
    /// Methods whose numbers were published, not measured here: they stand beside the others and
    /// are never the best.
    #[serde(default)]
    pub published: Vec<String>,
}

impl Table {
    /// A table without numbers.
    pub(crate) fn new(title: &str, methods: &[String], cases: &[String], columns: &[TableColumn]) -> Self {
        let values = vec![vec![vec![None; columns.len()]; cases.len()]; methods.len()];
        let (methods, cases, columns) = (methods.to_vec(), cases.to_vec(), columns.to_vec());
        Self { title: title.to_owned(), methods, cases, columns, values, published: Vec::new() }
    }

    /// Whether there is a row of cases for every method and a number or none for every column of
    /// them.
    pub(crate) fn is_whole(&self) -> bool {
        self.values.len() == self.methods.len()
            && self.values.iter().all(|cases| cases.len() == self.cases.len())
            && self.values.iter().flatten().all(|case| case.len() == self.columns.len())
    }

    /// Takes in another table's numbers (which must be whole); methods, cases and columns that are
    /// new come last.
    pub(crate) fn merge(&mut self, other: &Self) {
        let methods: Vec<usize> =
            other.methods.iter().map(|m| find_or_push(&mut self.methods, m, |a, b| a == b)).collect();
        let cases: Vec<usize> =
            other.cases.iter().map(|c| find_or_push(&mut self.cases, c, |a, b| a == b)).collect();
        let columns: Vec<usize> = other
            .columns
            .iter()
            .map(|c| find_or_push(&mut self.columns, c, |a, b| a.name == b.name))
            .collect();
        self.values.resize(self.methods.len(), Vec::new());
        for method in &mut self.values {
            method.resize(self.cases.len(), Vec::new());
            method.iter_mut().for_each(|case| case.resize(self.columns.len(), None));
        }
        for (m, row) in methods.iter().zip(&other.values) {
            for (c, values) in cases.iter().zip(row) {
                for (k, value) in columns.iter().zip(values).filter(|(_, v)| v.is_some()) {
                    self.values[*m][*c][*k] = *value;
                }
            }
        }
        let new = other.published.iter().filter(|p| !self.published.contains(p)).cloned();
        let new: Vec<String> = new.collect();
        self.published.extend(new);
    }

    /// Whether there is no number in it.
    pub(crate) fn is_empty(&self) -> bool {
        self.values.iter().flatten().flatten().all(Option::is_none)
    }

    /// Takes out the columns in which no method has a number in any case.
    pub(crate) fn without_empty_columns(mut self) -> Self {
        let used: Vec<usize> = (0..self.columns.len())
            .filter(|&c| self.values.iter().flatten().any(|row| row[c].is_some()))
            .collect();
        self.columns = used.iter().map(|&c| self.columns[c].clone()).collect();
        for row in self.values.iter_mut().flatten() {
            *row = used.iter().map(|&c| row[c]).collect();
        }
        self
    }

    /// The number as it is shown, and whether none that was measured in its column is better (two
    /// at least).
    fn cell(&self, method: usize, case: usize, column: usize) -> (String, bool) {
        let Some(value) = self.values[method][case][column] else { return ("–".into(), false) };
        let TableColumn { digits, more_is_better, .. } = self.columns[column].clone();
        let shown = |v: f64| format!("{v:.digits$}");
        let is_published = |m: usize| self.published.contains(&self.methods[m]);
        let measured = (0..self.methods.len()).filter(|&m| !is_published(m));
        let others: Vec<f64> = measured.filter_map(|m| self.values[m][case][column]).collect();
        let best = others.iter().copied().reduce(if more_is_better { f64::max } else { f64::min });
        let is_best =
            others.len() > 1 && !is_published(method) && best.is_some_and(|b| shown(b) == shown(value));
        (shown(value), is_best)
    }

    /// The numbers of a method as they are shown, and whether each is the best of its column.
    pub(super) fn cells(&self, method: usize) -> Vec<(String, bool)> {
        let places = (0..self.cases.len()).flat_map(|case| (0..self.columns.len()).map(move |c| (case, c)));
        places.map(|(case, column)| self.cell(method, case, column)).collect()
    }

    fn row(&self, method: usize, bold: impl Fn(&str) -> String) -> Vec<String> {
        let cells = self.cells(method).into_iter();
        cells.map(|(text, is_best)| if is_best { bold(&text) } else { text }).collect()
    }

    /// GitHub's Markdown.
    pub(crate) fn markdown(&self) -> String {
        let mut text = format!("### {}\n\n| method |", self.title);
        for case in &self.cases {
            self.columns.iter().for_each(|c| text += &format!(" {} {} |", case.replace('|', "\\|"), c.name));
        }
        text += "\n|---|";
        text += &"---|".repeat(self.cases.len() * self.columns.len());
        text.push('\n');
        for (m, method) in self.methods.iter().enumerate() {
            let cells = self.row(m, |t| format!("**{t}**")).join(" | ");
            let _ = writeln!(text, "| {} | {cells} |", method.replace('|', "\\|")); // writing to a string
        }
        text
    }

    /// One line a method and case.
    pub(crate) fn csv(&self) -> String {
        let names: Vec<String> = self.columns.iter().map(|c| quoted(&c.name)).collect();
        let mut text = format!("table,method,case,{}\n", names.join(","));
        for (method, values) in self.methods.iter().zip(&self.values) {
            for (case, row) in self.cases.iter().zip(values) {
                let row: Vec<String> =
                    row.iter().map(|v| v.map_or(String::new(), |v| v.to_string())).collect();
                let _ =
                    writeln!(text, "{},{},{},{}", self.title, quoted(method), quoted(case), row.join(","));
            }
        }
        text
    }

    /// A `tabular` for LaTeX with booktabs.
    pub(crate) fn latex(&self) -> String {
        let width = self.columns.len();
        let mut text = format!(
            "% {}\n\\begin{{tabular}}{{l{}}}\n\\toprule\n",
            self.title,
            "r".repeat(width * self.cases.len())
        );
        for case in &self.cases {
            let _ = write!(text, " & \\multicolumn{{{width}}}{{c}}{{{}}}", escape_latex(case));
        }
        text += " \\\\\nmethod";
        for _ in &self.cases {
            self.columns.iter().for_each(|c| text += &format!(" & {}", escape_latex(&c.name)));
        }
        text += " \\\\\n\\midrule\n";
        for (m, method) in self.methods.iter().enumerate() {
            let cells = self.row(m, |t| format!("\\textbf{{{t}}}")).join(" & ").replace('–', "--");
            let _ = writeln!(text, "{} & {cells} \\\\", escape_latex(method));
        }
        text + "\\bottomrule\n\\end{tabular}\n"
    }
}

/// The index of an equal element, which is added where there is none.
fn find_or_push<T: Clone>(all: &mut Vec<T>, wanted: &T, is_equal: fn(&T, &T) -> bool) -> usize {
    all.iter().position(|t| is_equal(t, wanted)).unwrap_or_else(|| {
        all.push(wanted.clone());
        all.len() - 1
    })
}

fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('"', "\"\""))
}

fn escape_latex(text: &str) -> String {
    text.chars()
        .map(|c| match c {
            '_' | '%' | '&' | '#' | '$' | '{' | '}' => format!("\\{c}"),
            '\\' => "\\textbackslash{}".into(),
            c => c.to_string(),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let column =
            |name: &str, more_is_better| TableColumn { name: name.to_owned(), digits: 2, more_is_better };
        let names = ["a_b".to_owned(), "c".to_owned()];
        let mut table = Table::new(
            "quality",
            &names,
            &["one".to_owned()],
            &[column("PSNR", true), column("s", false), column("none", true)],
        );
        table.values = vec![vec![vec![Some(30.0), Some(5.0), None]], vec![vec![Some(31.0), Some(6.0), None]]];
        table.without_empty_columns()
    }

    #[test]
    fn the_best_of_each_column_is_bold_by_the_columns_own_sense() {
        let text = table().markdown();
        assert!(
            text.contains("| a_b | 30.00 | **5.00** |") && text.contains("| c | **31.00** | 6.00 |"),
            "{text}"
        );
        assert!(!text.contains("none"), "{text}");
    }

    #[test]
    fn published_numbers_stand_beside_the_measured_ones_and_are_never_the_best() {
        let column = |name: &str| TableColumn { name: name.to_owned(), digits: 0, more_is_better: true };
        let mut paper = Table::new(
            "quality",
            &["paper".into()],
            &["one".into(), "two".into()],
            &[column("VRAM"), column("PSNR")],
        );
        paper.values = vec![vec![vec![Some(9.0), Some(99.0)], vec![None, Some(7.0)]]];
        paper.published = vec!["paper".into()];
        assert!(paper.is_whole());
        let mut all = table();
        all.merge(&paper);
        assert!(all.is_whole());
        let text = all.markdown();
        assert!(text.contains("one VRAM") && text.contains("two PSNR"), "{text}");
        assert!(text.contains("| paper | 99.00 | – | 9 | 7.00 | – | – |"), "{text}");
        assert!(text.contains("| c | **31.00** | 6.00 | – | – | – | – |"), "{text}");
        paper.values[0].pop();
        assert!(!paper.is_whole());
    }

    #[test]
    fn latex_is_escaped_and_csv_holds_every_number() {
        assert!(table().latex().contains("a\\_b & 30.00 & \\textbf{5.00} \\\\"));
        assert!(table().csv().contains("quality,\"c\",\"one\",31,6"));
    }
}
