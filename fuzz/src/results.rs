//! Sums over all runs, by target, and what each run was, in a JSON file.

use crate::run::Told;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

/// What came of a target, or of a run.
#[derive(Default, Serialize, Deserialize)]
pub struct Sum {
    executions: u64,
    accepted: u64,
    failures: u64,
    seconds: f64,
}

impl Sum {
    /// Adds what came of a target.
    pub fn add(&mut self, told: &Told) {
        self.executions += told.executions;
        self.accepted += told.accepted;
        self.failures += told.failures.len() as u64;
        self.seconds += told.seconds;
    }
}

/// One run over some of the targets.
#[derive(Default, Serialize, Deserialize)]
struct Piece {
    commit: String,
    #[serde(flatten)]
    sum: Sum,
    /// What is to be known of it.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    note: String,
}

/// The whole file.
#[derive(Default, Serialize, Deserialize)]
struct Sums {
    targets: BTreeMap<String, Sum>,
    runs: Vec<Piece>,
}

/// Adds what came of a run, by target, to the sums in the file, which is made where it is missing.
pub fn add(path: &Path, run: &[(&str, Told)]) {
    let known = fs::read(path).ok();
    let mut sums: Sums =
        known.map(|t| serde_json::from_slice(&t).expect("sums by target")).unwrap_or_default();
    let mut piece = Piece { commit: commit(), ..Piece::default() };
    for (target, told) in run {
        sums.targets.entry((*target).to_owned()).or_default().add(told);
        piece.sum.add(told);
    }
    sums.runs.push(piece);
    let text = serde_json::to_string_pretty(&sums).expect("numbers become JSON");
    fs::write(path, text + "\n").expect("the results can be written");
}

/// The commit that the readers are of; empty where that is not known.
fn commit() -> String {
    let mut git = Command::new("git");
    git.args(["rev-parse", "--short", "HEAD"]).current_dir(env!("CARGO_MANIFEST_DIR"));
    let said = git.output().map(|o| String::from_utf8_lossy(&o.stdout).trim().to_owned());
    said.unwrap_or_default()
}
