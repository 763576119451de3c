//! The readers of the program itself: flags, records and tables.

use crate::targets::Reader::Folder;
use crate::targets::{Target, target};
use std::fs;
use std::path::Path;

const WRITTEN: &str = "a seed is written";

/// What it reads of its own.
pub fn targets() -> Vec<Target> {
    vec![
        target(
            "flags-toml",
            50,
            flags,
            Folder(|f| {
                let file = f.join("flags.toml").to_string_lossy().into_owned();
                let words = ["sat-recon", "sfm", "no-such-input", "--config", &file].map(str::to_owned);
                sat_recon::config::parse(words.to_vec()).is_ok_and(|usage| usage.is_ok())
            }),
        ),
        target(
            "former-run",
            50,
            former_run,
            Folder(|f| {
                let words = ["sat-recon", "sfm", &f.to_string_lossy()].map(str::to_owned);
                let parsed = sat_recon::config::parse(words.to_vec());
                // Without the record the folder is taken for one of photos.
                parsed.is_ok_and(|usage| usage.is_ok_and(|p| p.recorded.is_some_and(|r| !r.flags.is_empty())))
            }),
        ),
        target("times", 1000, times, Folder(|f| sat_recon::times::Times::read(f).is_ok())),
        target(
            "tables",
            1000,
            tables,
            Folder(|f| sat_recon::compare::runs::read_tables(&f.join("a.json")).is_ok()),
        ),
    ]
}

fn flags(folder: &Path) {
    let text = "iterations = 2000\nquality = \"draft\"\nkeep_frame = true\nmatch_ratio = 0.8\n";
    fs::write(folder.join("flags.toml"), text).expect(WRITTEN);
}

/// A run folder whose record names the flags that it was made with.
fn former_run(folder: &Path) {
    let text = r#"{"input":"/photos","flags":["--iterations=2000","--quality=draft","--keep-frame"]}"#;
    fs::create_dir_all(folder.join(".stages")).expect(WRITTEN);
    fs::write(folder.join(".stages/args.json"), text).expect(WRITTEN);
}

fn times(folder: &Path) {
    fs::write(folder.join("times.json"), r#"{"a.png":0.0,"b.png":0.5,"c.png":1.0}"#).expect(WRITTEN);
}

fn tables(folder: &Path) {
    let text = r#"[{"title":"quality","methods":["a","b"],"cases":["one"],
        "columns":[{"name":"PSNR","digits":2,"more_is_better":true}],"values":[[[1.0]],[[2.0]]]}]"#;
    fs::write(folder.join("a.json"), text).expect(WRITTEN);
}
