//! Same seed, same bytes, for one thread and two: whole runs, compared file by file.

use super::support::{expect_code, folder, json, sample, text};
use std::path::Path;

/// The model's files after `sfm` with so many threads.
fn model(name: &str, video: &Path, flags: &[&str], threads: &str) -> (Vec<Vec<u8>>, serde_json::Value) {
    let out = folder(&format!("determinism-{name}-{threads}")).join("out");
    let arguments = [&["sfm", text(video), "-o", text(&out), "--threads", threads][..], flags].concat();
    expect_code(&arguments, 0);
    let files = ["cameras.bin", "images.bin", "points3D.bin"];
    let bytes = files.map(|f| std::fs::read(out.join("sparse/0").join(f)).unwrap()).to_vec();
    (bytes, json(&out.join("run.json"))["poses"]["decisions"].clone())
}

#[test]
fn a_free_motion_is_solved_to_the_same_bytes_by_one_thread_and_two() {
    let flags = ["--frames", "20", "--max-size", "320", "--motion", "free"];
    let video = sample("sample/orbit.mp4");
    let (one, said) = model("free", &video, &flags, "1");
    let (two, also) = model("free", &video, &flags, "2");
    assert!(one == two, "the models differ");
    assert_eq!(said, also, "the evidence differs");
}

#[test]
fn a_turn_about_one_axis_is_solved_to_the_same_bytes_by_one_thread_and_two() {
    let flags = ["--frames", "30", "--max-size", "480"];
    let video = sample("testbed/case3/video.mp4");
    let (one, said) = model("axis", &video, &flags, "1");
    let (two, also) = model("axis", &video, &flags, "2");
    assert!(said.to_string().contains("single-axis"), "{said}");
    assert!(one == two, "the models differ");
    assert_eq!(said, also, "the evidence differs");
}
