//! The crates as a registry would get them.

use super::support::{folder, text};
use std::path::Path;
use std::process::Command;

#[test]
fn every_crate_is_packed_with_all_that_it_names() {
    let place = folder("packages");
    let output = Command::new(env!("CARGO"))
        .args(["package", "--workspace", "--exclude", "fuzz", "--no-verify", "--allow-dirty", "--locked"])
        .args(["--offline", "--target-dir", text(&place)])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    assert!(!said.contains("ignoring "), "a target is named and not packed: {said}");
    let crates =
        ["scene", "preprocess", "sfm", "splat", "stereo", "baselines", "shape", "lighting", "sat-recon"];
    for name in crates {
        let file = format!("package/{name}-{}.crate", env!("CARGO_PKG_VERSION"));
        let size =
            std::fs::metadata(place.join(&file)).unwrap_or_else(|e| panic!("{file}: {e}: {said}")).len();
        assert!(size < 10 << 20, "crates.io takes 10 MiB: {file} has {size} bytes");
    }
    let packed = place.join(format!("package/sat-recon-{}.crate", env!("CARGO_PKG_VERSION")));
    let listed = Command::new("tar").args(["-tzf", text(&packed)]).output().unwrap();
    let listed = String::from_utf8_lossy(&listed.stdout).into_owned();
    // What the sources include from beside them.
    let source = |path: &Path| std::fs::read_to_string(path).unwrap();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for (file, prefix) in [("src/view/mod.rs", "../../"), ("src/bench/peers.rs", "../../")] {
        for rest in source(&root.join(file)).split("include_str!(\"").skip(1) {
            let name = rest.split('"').next().unwrap().trim_start_matches(prefix);
            assert!(listed.contains(name), "{file} includes {name}, which is not packed");
        }
    }
    for name in ["viewer/viewer.js.gz", "LICENSE-MIT", "LICENSE-APACHE"] {
        assert!(listed.contains(name), "{name}");
    }
    std::fs::remove_dir_all(place).unwrap();
}
