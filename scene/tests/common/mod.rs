//! What the integration tests share.
#![allow(dead_code)] // each test binary uses its part

use std::path::{Path, PathBuf};

/// A path below the shared data folder (`$SAT_RECON_SHARED/data` or `../shared/data` beside the
/// repository). Where it is missing the test is skipped aloud, or fails in CI.
pub fn shared(sub: &str) -> Option<PathBuf> {
    let root = std::env::var_os("SAT_RECON_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    let path = root.join("data").join(sub);
    if path.exists() {
        return Some(path);
    }
    assert!(std::env::var("CI").as_deref() != Ok("true"), "CI has no {}", path.display());
    eprintln!("SKIPPED: {} is not there", path.display());
    None
}

/// A fresh folder for a test.
pub fn folder(name: &str) -> PathBuf {
    let dir = std::env::temp_dir().join(format!("scene_it_{name}_{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&dir);
    std::fs::create_dir_all(&dir).unwrap();
    dir
}
