//! Takes the web viewer into the program where `make viewer` has built it (it needs Node.js; all
//! else works without), and what tells the sources of each step from those of another build.

use std::hash::{DefaultHasher, Hasher};
use std::path::{Path, PathBuf};

fn main() {
    println!("cargo:rerun-if-changed=viewer/dist");
    let root = std::env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    let bundle = Path::new(&root).join("viewer/dist/viewer.js");
    let value = if bundle.is_file() { format!("Some(include_str!({bundle:?}))") } else { "None".to_owned() };
    let out = std::env::var("OUT_DIR").unwrap_or_default();
    let code =
        format!("/// The viewer's script, where it was built.\npub const BUNDLE: Option<&str> = {value};\n");
    let written = std::fs::write(Path::new(&out).join("bundle.rs"), code);
    written.expect("the build folder can be written");
    // A stage that another build ran is not current. Unreadable sources only mean that it may be.
    for (name, crates) in
        [("FRAMES", ["preprocess", "scene"]), ("SFM", ["sfm", "scene"]), ("SPLAT", ["splat", "scene"])]
    {
        let mut hasher = DefaultHasher::new();
        for folder in crates {
            println!("cargo:rerun-if-changed={folder}/src");
            for file in files(&Path::new(&root).join(folder).join("src")) {
                hasher.write(file.to_string_lossy().strip_prefix(&root).unwrap_or_default().as_bytes());
                hasher.write(&std::fs::read(&file).unwrap_or_default());
            }
        }
        println!("cargo:rustc-env={name}_SOURCES={:016x}", hasher.finish());
    }
}

/// All files below a folder, in order.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut found: Vec<PathBuf> =
        entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect();
    found.sort();
    found
}
