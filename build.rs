//! Takes the web viewer into the program where `make viewer` has built it (it needs Node.js; all else works without).

use std::path::Path;

fn main() {
    println!("cargo:rerun-if-changed=viewer/dist");
    let root = std::env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    let bundle = Path::new(&root).join("viewer/dist/viewer.js");
    let value = if bundle.is_file() { format!("Some(include_str!({bundle:?}))") } else { "None".to_owned() };
    let out = std::env::var("OUT_DIR").unwrap_or_default();
    let code =
        format!("/// The viewer's script, where it was built.\npub const BUNDLE: Option<&str> = {value};\n");
    std::fs::write(Path::new(&out).join("bundle.rs"), code).expect("the build folder can be written");
}
