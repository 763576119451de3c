//! Real captures with truth: each figure is one the product promises.

use super::support::{decided, expect_code, folder, json, measured, sample, shared, text};
use std::path::Path;

fn poses(name: &str, input: &Path, flags: &[&str], code: i32) -> std::path::PathBuf {
    let out = folder(name).join("out");
    expect_code(&[&["sfm", text(input), "-o", text(&out)][..], flags].concat(), code);
    out
}

fn errors(out: &Path, truth: &Path) -> serde_json::Value {
    let said = expect_code(&["compare", text(out), "--truth", text(truth), "--json"], 0);
    let start = said.find('[').unwrap();
    serde_json::from_str::<serde_json::Value>(&said[start..]).unwrap()[0].clone()
}

#[test]
fn temple_ring_is_one_model_with_accurate_poses() {
    let (Some(images), Some(truth)) = (shared("temple_ring/images"), shared("temple_ring/cameras_par.txt"))
    else {
        return;
    };
    let errors = errors(&poses("temple", &images, &[], 0), &truth);
    assert_eq!(errors["registered"], 47, "{errors}");
    // Sixteen of the photos were turned by half a turn: without finding that out AUC@1 is 20.
    // With keypoints as detected it is 81, and the rotations' median 0.155°.
    assert!(errors["auc"]["1"].as_f64().unwrap() >= 82.0, "{errors}");
    assert!(errors["auc"]["5"].as_f64().unwrap() >= 96.0, "{errors}");
    assert!(errors["rotation_median_deg"].as_f64().unwrap() <= 0.15, "{errors}");
    assert!(errors["centre_median_pct"].as_f64().unwrap() <= 0.05, "{errors}");
}

#[test]
fn the_principal_point_of_fox_is_found_as_in_its_reference() {
    let (Some(images), Some(truth)) = (shared("fox/images"), shared("fox/transforms.json")) else { return };
    let errors = errors(&poses("fox", &images, &[], 0), &truth);
    assert_eq!(errors["registered"], 50, "{errors}");
    // Held at the image centre AUC@1 is 45.
    assert!(errors["auc"]["1"].as_f64().unwrap() >= 75.0, "{errors}");
}

#[test]
fn every_third_fourth_and_fifth_image_of_the_temple_are_enough() {
    let (Some(images), Some(truth)) = (shared("temple_ring/images"), shared("temple_ring/cameras_par.txt"))
    else {
        return;
    };
    for (every, registered, centre_pct) in [(3, 16, 1.0), (4, 12, 1.0), (5, 10, 5.0)] {
        let some = folder(&format!("temple-every-{every}"));
        let mut names: Vec<_> = std::fs::read_dir(&images).unwrap().map(|e| e.unwrap().file_name()).collect();
        names.sort();
        for name in names.into_iter().step_by(every) {
            std::fs::copy(images.join(&name), some.join(&name)).unwrap();
        }
        let errors = errors(&poses(&format!("temple-{every}"), &some, &[], 0), &truth);
        assert_eq!(errors["registered"], registered, "{errors}");
        assert!(errors["centre_max_pct"].as_f64().unwrap() <= centre_pct, "{errors}");
    }
}

#[test]
fn fountain_is_one_model_with_accurate_poses() {
    let (Some(images), Some(truth)) =
        (shared("fountain_p11/images"), shared("fountain_p11/gt_dense_cameras"))
    else {
        return;
    };
    let errors = errors(&poses("fountain", &images, &["--max-size", "1024"], 0), &truth);
    assert_eq!(errors["registered"], 11, "{errors}");
    assert!(errors["auc"]["5"].as_f64().unwrap() >= 85.0, "{errors}");
}

#[test]
fn a_phone_video_becomes_one_model() {
    let Some(video) = shared("phone_video/can_orbit.mp4") else { return };
    let out = poses("can", &video, &["--frames", "40", "--max-size", "640"], 0);
    let run = json(&out.join("run.json"));
    assert_eq!(run["poses"]["registered"], run["poses"]["total"]);
}

#[test]
fn given_poses_are_used_and_solving_is_skipped() {
    let Some(lego) = shared("lego400") else { return };
    let out = poses("lego", &lego, &[], 0);
    let run = json(&out.join("run.json"));
    assert_eq!(run["poses"]["imported"], true);
    assert_eq!(run["poses"]["registered"], 100);
    assert!(out.join("masks").is_dir(), "the alpha channel becomes masks");
}

#[test]
fn photos_are_turned_as_their_exif_says() {
    let Some(photos) = shared("exif_orientation") else { return };
    let out = folder("exif").join("out");
    expect_code(&["frames", text(&photos), "-o", text(&out)], 0);
    for entry in std::fs::read_dir(out.join("images")).unwrap() {
        let path = entry.unwrap().path();
        let (w, h) = image::image_dimensions(&path).unwrap();
        let is_portrait = path.file_name().unwrap().to_string_lossy().starts_with("Portrait");
        assert_eq!(h > w, is_portrait, "{} is {w}×{h}", path.display());
    }
}

#[test]
fn a_satellite_that_yaws_before_a_green_screen_is_keyed_and_posed_from_the_video_alone() {
    let case = sample("testbed/case3");
    let out = poses("yaw", &case.join("video.mp4"), &["--frames", "48"], 0);
    let errors = errors(&out, &case.join("sparse"));
    assert_eq!(errors["registered"], 48, "{errors}");
    assert!(errors["centre_median_pct"].as_f64().unwrap() <= 0.1, "{errors}");
    assert!(errors["auc"]["5"].as_f64().unwrap() >= 75.0, "{errors}");
    let motion = decided(&json(&out.join("run.json")), "motion");
    assert_eq!(motion["choice"]["motion"], "single-axis", "{motion}");
    assert!(measured(&motion, "loop-points") > Some(0.0), "{motion}");
    assert!(measured(&motion, "loop-deviation") < Some(1.0), "{motion}");
    // Upright lines of the room say how the camera looks down; the principal point alone leaves
    // 0.6°.
    assert!(errors["rotation_median_deg"].as_f64().unwrap() <= 0.3, "{errors}");
    assert!(out.join("mattes.png").is_file());
    // The same frames as photos.
    let photos = poses("yaw-photos", &out.join("images"), &[], 0);
    let errors = self::errors(&photos, &case.join("sparse"));
    assert_eq!(errors["registered"], 48, "{errors}");
    assert!(errors["rotation_median_deg"].as_f64().unwrap() <= 0.4, "{errors}");
}

#[test]
fn a_can_that_is_printed_twice_does_not_fold_the_orbit_around_it() {
    let Some(video) = shared("phone_video/can_orbit.mp4") else { return };
    let out = poses("can-unfolded", &video, &["--frames", "60", "--max-size", "640"], 0);
    let model = scene::io::read_model(&out.join("sparse/0")).unwrap();
    assert!(model.images.len() >= 57, "{} images", model.images.len());
    let mut images: Vec<_> = model.images.values().collect();
    images.sort_by(|a, b| a.name.cmp(&b.name));
    // A folded model jumps by half a turn between neighbouring frames.
    for pair in images.windows(2) {
        let turned = pair[0].pose.rotation.angle_between(pair[1].pose.rotation).to_degrees();
        assert!(turned < 60.0, "{turned}° between {} and {}", pair[0].name, pair[1].name);
    }
}

/// The row of a capture in README's results, by its cells.
fn readme_row(start: &str) -> Vec<String> {
    let readme = Path::new(env!("CARGO_MANIFEST_DIR")).join("README.md");
    let readme = std::fs::read_to_string(readme).unwrap();
    let row = readme.lines().find(|line| line.starts_with(&format!("| {start}"))).expect("a row");
    row.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect()
}

/// The first number of a cell, beside its unit.
fn number(cell: &str, unit: &str) -> f64 {
    let text = cell.replace(unit, " ");
    text.split_whitespace().find_map(|word| word.parse().ok()).unwrap_or_else(|| panic!("{cell}"))
}

#[test]
fn the_row_of_fox_in_the_readme_is_of_the_photos_that_it_names() {
    let (Some(images), Some(truth)) = (shared("fox/images"), shared("fox/transforms.json")) else { return };
    let row = readme_row("fox, 50 phone photos");
    let out = folder("fox_row").join("out");
    expect_code(&[text(&images), "-o", text(&out), "--quality", "fast", "--quiet"], 0);
    let run = json(&out.join("run.json"));
    assert_eq!((number(&row[1], "of"), &run["poses"]["registered"]), (50.0, &50.into()));
    let auc = errors(&out, &truth)["auc"]["1"].as_f64().unwrap();
    assert!((auc - number(&row[2], "AUC@1")).abs() < 2.0, "{auc}: {row:?}");
    let psnr = run["evaluation"]["mean"]["psnr"].as_f64().unwrap();
    assert!((psnr - number(&row[4], "dB")).abs() < 0.5, "{psnr}: {row:?}");
    std::fs::remove_dir_all(out).unwrap();
}
