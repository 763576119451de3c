//! Takes the web viewer into the program as `make viewer` has bundled it, and what tells the
//! sources of each step from those of another build.

use std::hash::{DefaultHasher, Hasher};
use std::path::{Path, PathBuf};

fn main() {
    println!("cargo:rerun-if-changed=viewer/viewer.js.gz");
    let root = std::env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    let out = PathBuf::from(std::env::var("OUT_DIR").unwrap_or_default());
    take_viewer_in(&Path::new(&root).join("viewer/viewer.js.gz"), &out)
        .expect("the build folder can be written");
    // A stage that another build ran is not current. Unreadable sources only mean that it may be.
    for (name, crates) in [
        ("FRAMES", ["preprocess", "scene"].as_slice()),
        ("SFM", &["sfm", "scene"]),
        ("SPLAT", &["splat", "scene"]),
        ("STEREO", &["stereo", "scene"]),
        ("BASELINES", &["baselines", "splat", "scene"]),
    ] {
        let mut hasher = DefaultHasher::new();
        // All that is known where the crates come from a registry.
        hasher.write(std::env::var("CARGO_PKG_VERSION").unwrap_or_default().as_bytes());
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

/// Writes the script and the constant that holds it, or that there is none.
fn take_viewer_in(script: &Path, out: &Path) -> std::io::Result<()> {
    let mut value = "None";
    if let Ok(script) = std::fs::read(script) {
        std::fs::write(out.join("viewer.js.gz"), script)?;
        value = r#"Some(include_bytes!(concat!(env!("OUT_DIR"), "/viewer.js.gz")))"#;
    }
    let code = format!(
        "/// The viewer's script with gzip, where it was bundled.\n\
         pub const BUNDLE: Option<&[u8]> = {value};\n"
    );
    std::fs::write(out.join("bundle.rs"), code)
}

/// All files below a folder, in order.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut found: Vec<PathBuf> =
        entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect();
    found.sort();
    found
}
