//! Tables as in papers: methods as rows, cases as column groups, the best of each column in bold.

use serde::Serialize;
use std::fmt::Write as _;

/// A column of every case.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Column {
    /// Heading, with its unit.
    pub name: &'static str,
    /// Digits behind the point.
    pub digits: usize,
    /// Whether more is better.
    pub more_is_better: bool,
}

/// Numbers by method, case and column.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// What it is about.
    pub title: &'static str,
    /// Rows.
    pub methods: Vec<String>,
    /// Column groups.
    pub cases: Vec<String>,
    /// Columns of each group.
    pub columns: Vec<Column>,
    /// [methods × cases × columns].
    pub values: Vec<Vec<Vec<Option<f64>>>>,
}

impl Table {
    /// A table without numbers.
    pub fn new(title: &'static str, methods: &[String], cases: &[String], columns: &[Column]) -> Self {
        let values = vec![vec![vec![None; columns.len()]; cases.len()]; methods.len()];
        Self { title, methods: methods.to_vec(), cases: cases.to_vec(), columns: columns.to_vec(), values }
    }

    /// Whether there is no number in it.
    pub fn is_empty(&self) -> bool {
        self.values.iter().flatten().flatten().all(Option::is_none)
    }

    /// Takes out the columns in which no method has a number in any case.
    pub fn without_empty_columns(mut self) -> Self {
        let used: Vec<usize> = (0..self.columns.len())
            .filter(|&c| self.values.iter().flatten().any(|row| row[c].is_some()))
            .collect();
        self.columns = used.iter().map(|&c| self.columns[c]).collect();
        for row in self.values.iter_mut().flatten() {
            *row = used.iter().map(|&c| row[c]).collect();
        }
        self
    }

    /// The number as it is shown, and whether none in its column is better (with two methods at least).
    fn cell(&self, method: usize, case: usize, column: usize) -> (String, bool) {
        let Some(value) = self.values[method][case][column] else { return ("–".into(), false) };
        let Column { digits, more_is_better, .. } = self.columns[column];
        let shown = |v: f64| format!("{v:.digits$}");
        let others: Vec<f64> = self.values.iter().filter_map(|m| m[case][column]).collect();
        let best = others.iter().copied().reduce(if more_is_better { f64::max } else { f64::min });
        let is_best = others.len() > 1 && best.is_some_and(|b| shown(b) == shown(value));
        (shown(value), is_best)
    }

    fn row(&self, method: usize, bold: impl Fn(&str) -> String) -> Vec<String> {
        let places = (0..self.cases.len()).flat_map(|case| (0..self.columns.len()).map(move |c| (case, c)));
        let text = |(case, column)| {
            let (text, is_best) = self.cell(method, case, column);
            if is_best { bold(&text) } else { text }
        };
        places.map(text).collect()
    }

    /// GitHub's Markdown.
    pub fn markdown(&self) -> String {
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
    pub fn csv(&self) -> String {
        let quoted = |t: &str| format!("\"{}\"", t.replace('"', "\"\""));
        let names: Vec<String> = self.columns.iter().map(|c| quoted(c.name)).collect();
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
    pub fn latex(&self) -> String {
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
            self.columns.iter().for_each(|c| text += &format!(" & {}", escape_latex(c.name)));
        }
        text += " \\\\\n\\midrule\n";
        for (m, method) in self.methods.iter().enumerate() {
            let cells = self.row(m, |t| format!("\\textbf{{{t}}}")).join(" & ").replace('–', "--");
            let _ = writeln!(text, "{} & {cells} \\\\", escape_latex(method));
        }
        text + "\\bottomrule\n\\end{tabular}\n"
    }
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
        let column = |name, more_is_better| Column { name, digits: 2, more_is_better };
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
    fn latex_is_escaped_and_csv_holds_every_number() {
        assert!(table().latex().contains("a\\_b & 30.00 & \\textbf{5.00} \\\\"));
        assert!(table().csv().contains("quality,\"c\",\"one\",31,6"));
    }
}
