//! The tools that attack the program from outside (`make reliability`), on a part of their cases.

use super::support::{folder, text};
use std::path::Path;
use std::process::Command;

/// Scenes that take a fraction of a second each.
const SCENES: [&str; 24] = [
    "one_photo",
    "two_equal_photos",
    "black",
    "noise",
    "true_poses",
    "small_world",
    "huge_world",
    "nan_poses",
    "equal_poses",
    "no_rotations",
    "poses_of_other_photos",
    "one_pixel",
    "one_row",
    "video_of_one_frame",
    "black_video",
    "transparent",
    "all_masked",
    "link_loop",
    "output_is_a_file",
    "read_only_output",
    "playlist",
    "deep_json",
    "no_focal",
    "huge_count",
];

/// Runs a tool where Python with numpy is installed; it must end well.
fn run(tool: &str, name: &str, more: &[&str]) {
    // Where another Python comes first on the PATH, Debian's has numpy.
    let python = ["python3", "/usr/bin/python3"].into_iter().find(|python| {
        let numpy = Command::new(python).args(["-c", "import numpy"]).output();
        numpy.is_ok_and(|o| o.status.success())
    });
    let Some(python) = python else {
        assert!(std::env::var_os("CI").is_none(), "python3 or numpy is missing");
        return eprintln!("SKIPPED: needs python3 with numpy");
    };
    let out = folder(name);
    let run = Command::new(python)
        .arg("-B")
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tools/reliability").join(tool))
        .args([env!("CARGO_BIN_EXE_sat-recon"), "--out", text(&out)])
        .args(more)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&run.stdout).into_owned();
    assert!(run.status.success(), "{said}{}", String::from_utf8_lossy(&run.stderr));
    std::fs::remove_dir_all(out).unwrap();
}

#[test]
fn degenerate_scenes_have_their_right_answers() {
    run("scenes.py", "scenes", &[&["--only"][..], &SCENES].concat());
}

#[test]
fn no_wrong_model_is_taken_for_a_right_one_and_harmless_changes_are_taken() {
    run("models.py", "models", &["--count", "60", "--first", "100000"]);
}
