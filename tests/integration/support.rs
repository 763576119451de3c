//! What the tests share: the program, folders, real data, small captures.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The program under test.
pub fn sat_recon(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sat-recon")).args(arguments).output().expect("the program starts")
}

/// Runs the program in a folder.
pub fn sat_recon_in(folder: &Path, arguments: &[String]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sat-recon"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("the program starts")
}

/// Runs the program and demands an exit code; what it said is in the failure message.
pub fn expect_code(arguments: &[&str], code: i32) -> String {
    let output = sat_recon(arguments);
    let said =
        format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(code), "sat-recon {}: {said}", arguments.join(" "));
    said
}

/// A fresh folder.
pub fn folder(name: &str) -> PathBuf {
    let path = std::env::temp_dir().join(format!("sat-recon-{name}-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).expect("a temporary folder");
    path
}

/// A path as the program takes it.
pub fn text(path: &Path) -> &str {
    path.to_str().expect("a path in UTF-8")
}

/// A file or folder of the real data; `None` (said loudly) where the data is missing, a failure in
/// CI.
pub fn shared(relative: &str) -> Option<PathBuf> {
    let root = std::env::var_os("SAT_RECON_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    let path = root.join("data").join(relative);
    if path.exists() {
        return Some(path);
    }
    assert!(std::env::var_os("CI").is_none(), "{} is missing, and CI must have it", path.display());
    eprintln!("SKIPPED: {} is missing", path.display());
    None
}

/// A file of the sample data that the project ships.
pub fn sample(relative: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data").join(relative)
}

/// The number of a quantity among the measurements of a decision in `run.json`.
pub fn measured(decision: &serde_json::Value, quantity: &str) -> Option<f64> {
    let all = decision["measurements"].as_array()?;
    all.iter().find(|m| m["quantity"] == quantity)?["value"].as_f64()
}

/// The first decision on a subject in `run.json`.
pub fn decided(run: &serde_json::Value, subject: &str) -> serde_json::Value {
    let all = run["decisions"].as_array().into_iter().flatten();
    all.clone().find(|d| d["subject"] == subject).cloned().unwrap_or_default()
}

/// JSON of a file.
pub fn json(path: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display())))
        .expect("JSON")
}
