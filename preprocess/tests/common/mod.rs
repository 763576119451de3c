//! Where the real data lies, and scratch folders.

use std::path::{Path, PathBuf};

/// `../shared/data/name`, or `None` with a loud word where it is missing (a failure in CI).
pub fn shared(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("SAT_RECON_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    let path = root.join("data").join(name);
    if path.exists() {
        return Some(path);
    }
    assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "{} is missing", path.display());
    println!("SKIPPED: {} is missing", path.display());
    None
}

/// A fresh folder, removed at the end of the test.
pub struct Scratch(pub PathBuf);

impl Scratch {
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("sat-recon-preprocess-{}-{name}", std::process::id()));
        std::fs::remove_dir_all(&path).ok();
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    /// Names in a folder inside, sorted; empty where it does not exist.
    #[allow(dead_code)]
    pub fn list(&self, folder: &str) -> Vec<String> {
        let Ok(entries) = std::fs::read_dir(self.0.join(folder)) else { return Vec::new() };
        let mut names: Vec<_> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        if std::env::var_os("SAT_RECON_KEEP").is_none() {
            std::fs::remove_dir_all(&self.0).ok();
        }
    }
}
