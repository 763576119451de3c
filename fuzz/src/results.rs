//! Sums over all runs, by target, in a JSON file.

use crate::run::Told;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// What came of a target so far.
#[derive(Default, Serialize, Deserialize)]
struct Sum {
    executions: u64,
    accepted: u64,
    failures: u64,
    seconds: f64,
}

/// Adds what came of a run to the sums in the file, which is made where it is missing.
pub fn add(path: &Path, target: &str, told: &Told) {
    let known = fs::read(path).ok();
    let mut sums: BTreeMap<String, Sum> =
        known.map(|text| serde_json::from_slice(&text).expect("sums by target")).unwrap_or_default();
    let sum = sums.entry(target.to_owned()).or_default();
    sum.executions += told.executions;
    sum.accepted += told.accepted;
    sum.failures += told.failures.len() as u64;
    sum.seconds += told.seconds;
    let text = serde_json::to_string_pretty(&sums).expect("numbers become JSON");
    fs::write(path, text + "\n").expect("the results can be written");
}
