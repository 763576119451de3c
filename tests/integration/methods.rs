//! `--method`: a field instead of a splat, by the same commands.

use super::support::{expect_code, folder, json, sample, text};

#[test]
fn an_instant_nerf_is_trained_judged_and_rendered_and_is_no_splat() {
    let dir = folder("instant-ngp");
    let (out, input) = (dir.join("out"), sample("testbed/case3/video.mp4"));
    let flags = [
        "--frames",
        "30",
        "--max-size",
        "320",
        "--iterations",
        "60",
        "--method",
        "instant-ngp",
        "--fps-loops",
        "1",
    ];
    // Sixty steps make a poor field, and the verdict says so.
    let said = expect_code(&[&["run", text(&input), "-o", text(&out)][..], &flags].concat(), 3);
    assert!(said.contains("instant-ngp, 60 steps"), "{said}");
    assert!(out.join("field.bin").is_file() && !out.join("splat.ply").exists());
    let run = json(&out.join("run.json"));
    assert_eq!(run["field"]["method"], "instant-ngp");
    let psnr = run["evaluation"]["mean"]["psnr"].as_f64().unwrap();
    assert!(psnr > 15.0, "{psnr}");
    let report = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(report.contains("instant-ngp, 60 steps"));
    // A second run has nothing to do; pictures come from the field; what needs a splat says so.
    assert!(expect_code(&["eval", text(&out)], 3).contains("as before"));
    let pictures = dir.join("pictures");
    expect_code(&["render", text(&out), "-o", text(&pictures), "--path", "test"], 0);
    assert!(std::fs::read_dir(&pictures).unwrap().count() > 1);
    let said = expect_code(&["export", text(&out), "-o", text(&dir.join("a.ply"))], 1);
    assert!(said.contains("has a field and no splat"), "{said}");
    let said = expect_code(&["train", text(&out), "--backend", "gpu"], 1);
    assert!(said.contains("on the processor only"), "{said}");
    // Back to a splat: the field is gone.
    expect_code(
        &["train", text(&out), "--method", "3dgs", "--iterations", "40", "--max-gaussians", "2000"],
        0,
    );
    assert!(out.join("splat.ply").is_file() && !out.join("field.bin").exists());
}
