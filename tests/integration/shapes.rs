//! Shapes judged against a true mesh.

use super::support::{expect_code, folder, json, sample, text};
use std::path::Path;

#[test]
fn the_mock_up_is_judged_against_its_mesh_and_a_wrong_frame_is_named() {
    let case = sample("testbed/case3");
    let out = folder("shapes").join("out");
    let (video, mesh, truth) = (case.join("video.mp4"), case.join("mesh.ply"), case.join("sparse"));
    let flags = ["--frames", "30", "--max-size", "320", "--iterations", "400", "--max-gaussians", "8000"];
    let train = [&["train", text(&video), "-o", text(&out), "-q"][..], &flags].concat();
    expect_code(&train, 0);
    let said = expect_code(&["eval", text(&out), "--mesh", text(&mesh), "--mesh-truth", text(&truth)], 0);
    assert!(said.contains("surface F-score"), "{said}");
    let geometry = &json(&out.join("eval/metrics.json"))["geometry"];
    let at = |what: &str, key: &str| geometry[what][key].as_f64().unwrap();
    assert!(at("cloud", "points") > 200.0 && at("cloud", "precision_pct") > 50.0, "{geometry}");
    assert!(at("surface", "recall_pct") > 30.0 && at("surface", "chamfer_pct") < 5.0, "{geometry}");
    // Fusing the views' depths leaves out what they do not agree on.
    assert!(at("fused", "f_score_pct") > 40.0 && at("fused", "chamfer_pct") < 3.0, "{geometry}");
    assert!(at("fused", "accuracy_median_pct") < at("surface", "accuracy_median_pct"), "{geometry}");
    assert!(at("dense", "precision_pct") > 80.0 && at("dense", "recall_pct") > 50.0, "{geometry}");
    the_mesh_is_written(&out, at("fused", "points"));
    the_dense_cloud_is_written(&out, at("dense", "points"));
    assert!(geometry["floaters_pct"].as_f64().unwrap() < 50.0, "{geometry}");
    // A mesh that is somewhere else is not silently given a score of 0.
    let far = folder("shapes-far").join("far.obj");
    std::fs::write(&far, "v 0 0 1000\nv 1 0 1000\nv 0 1 1000\nf 1 2 3\n").unwrap();
    assert!(expect_code(&["eval", text(&out), "--mesh", text(&far)], 1).contains("no camera sees the mesh"));
    std::fs::write(&far, "v 0 0 0\nf 1 2 3\n").unwrap();
    assert!(expect_code(&["eval", text(&out), "--mesh", text(&far)], 1).contains("far.obj"));
}

/// `export --mesh` writes what eval judged, in both formats, and refuses others.
fn the_mesh_is_written(out: &Path, samples: f64) {
    assert!(samples > 1000.0);
    let said = expect_code(&["export", text(out), "--mesh"], 0);
    assert!(said.contains("triangles"), "{said}");
    let ply = scene::io::read_mesh(&out.join("mesh.ply")).unwrap();
    let glb = out.join("coarse.glb");
    expect_code(&["export", text(out), "--mesh", "--mesh-resolution", "30", "-o", text(&glb)], 0);
    let coarse = scene::io::read_mesh(&glb).unwrap();
    assert!(coarse.triangles.len() * 2 < ply.triangles.len());
    assert!((coarse.size() / ply.size() - 1.0).abs() < 0.1, "{} {}", coarse.size(), ply.size());
    let said = expect_code(&["export", text(out), "--mesh", "-o", text(&out.join("a.obj"))], 1);
    assert!(said.contains(".ply or .glb"), "{said}");
    let said = expect_code(&["export", text(&out.join("splat.ply")), "--mesh", "-o", text(&glb)], 1);
    assert!(said.contains("the output folder of a run"), "{said}");
}

/// `export --dense` writes the points that eval judged, and `--mesh-depths` chooses another
/// surface.
fn the_dense_cloud_is_written(out: &Path, points: f64) {
    let said = expect_code(&["export", text(out), "--dense"], 0);
    assert!(said.contains(&format!("{points} points")), "{said}");
    let cloud = out.join("dense.ply");
    assert_eq!(scene::io::ply::read_points_ply(&cloud).unwrap().len() as f64, points);
    let header = std::fs::read(&cloud).unwrap()[..300].to_vec();
    assert!(String::from_utf8_lossy(&header).contains("property float nx"));
    let meshes = ["splat", "both"].map(|from| {
        let file = out.join(format!("{from}.ply"));
        expect_code(&["export", text(out), "--mesh", "--mesh-depths", from, "-o", text(&file)], 0);
        scene::io::read_mesh(&file).unwrap().triangles.len()
    });
    assert!(meshes.iter().all(|n| *n > 1000) && meshes[0] != meshes[1], "{meshes:?}");
    let said = expect_code(&["export", text(out), "--dense", "-o", text(&out.join("a.glb"))], 1);
    assert!(said.contains("written as .ply"), "{said}");
}
