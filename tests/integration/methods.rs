//! `--method`: a field instead of a splat, by the same commands.

use super::support::{expect_code, folder, json, sample, text};
use std::path::{Path, PathBuf};
use std::process::Command;

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
    let said = expect_code(&["train", text(&out), "--gpu", "no such adapter"], 1);
    assert!(said.contains("no graphics adapter matches"), "{said}");
    // Back to a splat on the processor, as the error says: the field is gone.
    let flags = ["--method", "3dgs", "--iterations", "40", "--max-gaussians", "2000", "--backend", "cpu"];
    expect_code(&[&["train", text(&out)][..], &flags].concat(), 0);
    assert!(out.join("splat.ply").is_file() && !out.join("field.bin").exists());
}

/// `data/hinge.py` as D-NeRF's scenes come: training and test photos in files of their own.
fn hinge(dir: &Path) -> PathBuf {
    let (script, scene) = (sample("hinge.py"), dir.join("hinge"));
    let arguments = [text(&script), text(&scene), "--views", "24", "--size", "40"];
    let made = Command::new("/usr/bin/python3").args(arguments).output().unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    std::fs::remove_file(scene.join("transforms.json")).unwrap();
    scene
}

#[test]
fn a_scene_that_moves_is_trained_by_every_method_on_the_split_it_comes_with() {
    let dir = folder("moving-methods");
    let scene = hinge(&dir);
    let test = json(&scene.join("transforms_test.json"))["frames"].as_array().unwrap().len();
    for method in ["nerf", "d-nerf", "4dgs"] {
        let out = dir.join(method);
        let flags = ["--method", method, "--time-limit", "10s", "--fps-loops", "1", "--quiet"];
        // Ten seconds make a poor field, and the verdict says so.
        expect_code(&[&["run", text(&scene), "-o", text(&out)][..], &flags].concat(), 3);
        let run = json(&out.join("run.json"));
        assert_eq!(run["field"]["method"], method);
        assert_eq!(run["evaluation"]["views"].as_array().unwrap().len(), test);
        let psnr = run["evaluation"]["mean"]["psnr"].as_f64().unwrap();
        assert!(psnr > 14.3, "{method}: {psnr}"); // black pictures have 14.24 dB
        let times = json(&out.join("times.json"));
        let times = times.as_object().unwrap().values().map(|t| t.as_f64().unwrap());
        assert_eq!(times.clone().fold(1.0, f64::min), 0.0, "{method}");
        assert_eq!(times.fold(0.0, f64::max), 1.0, "{method}");
        let pictures = dir.join(format!("{method}-pictures"));
        expect_code(&["render", text(&out), "-o", text(&pictures), "--path", "test"], 0);
        assert!(std::fs::read_dir(&pictures).unwrap().count() >= test, "{method}");
    }
}
