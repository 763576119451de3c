//! An object with a part that turns while the object is filmed, with exact truth.

use super::support::{expect_code, folder, json, text};
use glam::{DQuat, DVec3};
use image::RgbImage;
use scene::synthetic::{TexturedScene, default_camera, orbit_pose};
use scene::{CameraModel, Pose};
use std::path::Path;

const FRAMES: u32 = 72;
/// How far the part turns from the first frame to the last, degrees.
const TURN_DEG: f64 = 90.0;
/// Where the part's centre is, units of the body; it turns about the line from the body's centre.
const PART: DVec3 = DVec3::new(1.6, 0.0, 0.0);
const SCREEN: [u8; 3] = [20, 170, 60];

/// A body that yaws before a green screen, seen by a camera that stands still, and its part.
fn frame(number: u32) -> RgbImage {
    let share = f64::from(number) / f64::from(FRAMES);
    let camera = default_camera(CameraModel::Pinhole, 320, 240);
    let of_body = orbit_pose(share * std::f64::consts::TAU, 0.3, 6.0);
    let turn = DQuat::from_rotation_x((share * TURN_DEG).to_radians());
    let of_part = of_body.compose(&Pose { rotation: turn, translation: PART });
    let block = TexturedScene { ground: false, background: SCREEN, ..TexturedScene::default() };
    let small = TexturedScene { unit: 0.55, seed: 7, ..block };
    let mut pictures = [(&block, of_body), (&small, of_part)];
    // Neither encloses the other: the one whose centre is farther is hidden by the other.
    pictures.sort_by(|a, b| b.1.translation.length().total_cmp(&a.1.translation.length()));
    let [far, near] = pictures.map(|(scene, pose)| scene.render(&camera, &pose));
    let cover = pictures[1].0.render_mask(&camera, &pictures[1].1);
    RgbImage::from_fn(camera.width, camera.height, |x, y| {
        let beside = 1.0 - f64::from(cover.get_pixel(x, y).0[0]) / 255.0;
        let (front, back) = (near.get_pixel(x, y).0, far.get_pixel(x, y).0);
        image::Rgb(std::array::from_fn(|c| {
            (f64::from(front[c]) + beside * (f64::from(back[c]) - f64::from(SCREEN[c]))) as u8
        }))
    })
}

fn film(pictures: &Path, video: &Path) {
    std::fs::create_dir_all(pictures).unwrap();
    for number in 0..FRAMES {
        frame(number).save(pictures.join(format!("{number:03}.png"))).unwrap();
    }
    let encoded = std::process::Command::new("ffmpeg")
        .args(["-v", "error", "-framerate", "5", "-i", text(&pictures.join("%03d.png"))])
        .args(["-c:v", "libx264", "-crf", "10", "-pix_fmt", "yuv420p", text(video)])
        .status();
    assert!(encoded.unwrap().success());
}

fn held_out(run: &Path) -> f64 {
    json(&run.join("eval/metrics.json"))["mean"]["psnr_mask"].as_f64().unwrap()
}

#[test]
fn a_part_is_found_by_its_turn_and_a_splat_of_parts_shows_what_a_rigid_one_cannot() {
    let dir = folder("moving_parts");
    let (video, out) = (dir.join("turn.mp4"), dir.join("out"));
    film(&dir.join("pictures"), &video);
    let short = ["--iterations", "800", "--max-gaussians", "4000", "-q"];
    expect_code(&[&["eval", text(&video), "-o", text(&out)][..], &short].concat(), 0);
    let said = expect_code(&["parts", text(&out)], 0);
    assert!(said.contains("part 1: turns by"), "{said}");
    let found = json(&out.join("parts/parts.json"));
    let parts = found["parts"].as_array().unwrap();
    assert_eq!(parts.len(), 1, "{said}");
    let angles: Vec<f64> =
        parts[0]["angles_deg"].as_array().unwrap().iter().map(|a| a.as_f64().unwrap()).collect();
    assert_eq!(angles[0], 0.0, "angles count from the first frame");
    let turned = (angles[angles.len() - 1] - angles[0]).abs();
    let true_turn = TURN_DEG * f64::from(FRAMES - 1) / f64::from(FRAMES);
    assert!((turned - true_turn).abs() < 2.0, "{turned} of {true_turn}");
    let [rigid, moving] = [held_out(&out), held_out(&out.join("parts"))];
    assert!(moving > rigid + 1.5, "{rigid} dB as one rigid body, {moving} dB as parts");
    // Joints without their splat do not leave the old one beside them.
    expect_code(&["parts", text(&out), "--no-splat", "-q"], 0);
    assert!(!out.join("parts/splat.ply").exists() && !out.join("parts/parts.glb").exists());
}
