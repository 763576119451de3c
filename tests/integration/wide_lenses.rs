//! Panoramas, fisheye pictures and the metadata that say what is up, with exact truth.

use super::support::{decided, expect_code, folder, json, text};
use glam::{DMat3, DQuat, DVec2, DVec3};
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use scene::sim3::{PoseErrors, compare_poses};
use scene::synthetic::{TexturedScene, orbit_pose};
use scene::{Camera, CameraModel, Pose, PosedImage, Reconstruction};
use std::f64::consts::{FRAC_PI_4, PI, TAU};
use std::path::Path;

/// A textured block in a textured room.
fn furnished() -> TexturedScene {
    TexturedScene { room: Some(3.5), ..TexturedScene::default() }
}

/// Writes a JPEG with an XMP packet of these properties (an APP1 segment behind the first marker).
fn save(path: &Path, image: &RgbImage, properties: &str) {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, 95).encode_image(image).unwrap();
    let packet = format!(
        "http://ns.adobe.com/xap/1.0/\0<x:xmpmeta xmlns:x=\"adobe:ns:meta/\">\
         <rdf:RDF xmlns:rdf=\"http://www.w3.org/1999/02/22-rdf-syntax-ns#\"><rdf:Description \
         xmlns:GPano=\"http://ns.google.com/photos/1.0/panorama/\" \
         xmlns:drone-dji=\"http://www.dji.com/drone-dji/1.0/\" {properties}/></rdf:RDF></x:xmpmeta>"
    );
    let length = (packet.len() as u16 + 2).to_be_bytes();
    let segment = [&[0xff, 0xe1], &length[..], packet.as_bytes()].concat();
    std::fs::write(path, [&bytes[..2], &segment, &bytes[2..]].concat()).unwrap();
}

fn truth_of(poses: Vec<(String, Pose)>) -> Reconstruction {
    let mut model = Reconstruction::default();
    model.cameras.insert(1, Camera::centred(1, CameraModel::Pinhole, 100, 100, 50.0));
    for (id, (name, pose)) in (1..).zip(poses) {
        model.images.insert(id, PosedImage { id, camera: 1, name, pose, observations: Vec::new() });
    }
    model
}

/// Solves the photos and compares all poses with the truth.
fn solved(photos: &Path, out: &Path, flags: &[&str], truth: &Reconstruction) -> PoseErrors {
    let begin = ["sfm", text(photos), "-o", text(out)];
    expect_code(&[&begin[..], flags].concat(), 0);
    let errors = compare_poses(&scene::io::read_model(&out.join("sparse/0")).unwrap(), truth);
    assert_eq!(errors.registered, errors.total, "{errors:?}");
    errors
}

/// Largest errors: degrees, and percent of the extent of the cameras.
fn largest(errors: &PoseErrors) -> [f64; 2] {
    let most = |f: fn(&scene::sim3::ImageError) -> f64| errors.images.iter().map(f).fold(0.0, f64::max);
    [most(|e| e.rotation_deg), most(|e| e.centre_pct)]
}

/// A panorama of the room, its picture in longitude and latitude.
fn panorama(scene: &TexturedScene, pose: &Pose) -> RgbImage {
    let ray = |pixel: DVec2| {
        let (longitude, latitude) = ((pixel.x / 1024.0 - 0.5) * TAU, (pixel.y / 512.0 - 0.5) * PI);
        let ahead = DVec2::new(longitude.sin(), longitude.cos()) * latitude.cos();
        Some(DVec3::new(ahead.x, latitude.sin(), ahead.y))
    };
    scene.render_through((1024, 512), ray, pose)
}

/// Poses of the views that are cut from a panorama of this pose, by their names.
fn views_of(name: &str, pose: &Pose) -> Vec<(String, Pose)> {
    let turned = |view: u32| {
        let turn = DQuat::from_mat3(&DMat3::from_rotation_y(-f64::from(view) * FRAC_PI_4));
        (format!("{name}_{view}.png"), Pose::from_centre(turn * pose.rotation, pose.centre()))
    };
    (0..8).map(turned).collect()
}

/// On an arc about the block, `step` radians from one to the next; `heading`: where it looks.
fn standing(i: i32, step: f64, heading: f64) -> Pose {
    let angle = f64::from(i) * step;
    let eye = DVec3::new(2.0 * angle.cos(), 2.0 * angle.sin(), 0.1 + 0.05 * f64::from(i % 3));
    Pose::look_at(eye, eye + DVec3::new(heading.cos(), heading.sin(), 0.0), DVec3::Z)
}

/// That a run saw panoramas and does not ask whether their places form a closed ring.
fn expect_panoramas(out: &Path) {
    let run = json(&out.join("run.json"));
    assert_eq!(run["frames"]["wide_lens"], "panorama");
    let lights = run["verdict"].as_array().unwrap();
    assert!(lights.len() >= 4 && lights.iter().all(|l| l["what"] != "loop"), "{lights:?}");
    assert!(lights.iter().all(|l| l["level"] != "bad"), "{lights:?}");
}

#[test]
fn panoramas_are_known_by_their_metadata_and_every_view_of_them_gets_its_pose() {
    let (dir, scene) = (folder("panoramas"), furnished());
    let photos = dir.join("photos");
    std::fs::create_dir_all(&photos).unwrap();
    let mut poses = Vec::new();
    for i in 0..8 {
        // Each looks another way, level.
        let pose = standing(i, 0.35, 1.3 * f64::from(i));
        let picture = panorama(&scene, &pose);
        save(&photos.join(format!("p{i}.jpg")), &picture, "GPano:ProjectionType=\"equirectangular\"");
        poses.extend(views_of(&format!("p{i}"), &pose));
    }
    let out = dir.join("out");
    let errors = solved(&photos, &out, &[], &truth_of(poses));
    let [rotation_deg, centre_pct] = largest(&errors);
    assert!(rotation_deg < 0.3 && centre_pct < 0.6, "{rotation_deg}° {centre_pct} %");
    expect_panoramas(&out);
    let said = expect_code(
        &["frames", text(&photos), "-o", text(&dir.join("as_they_are")), "--lens", "perspective"],
        0,
    );
    assert!(said.contains("8, 1024×512"), "{said}");
}

#[test]
fn a_video_of_panoramas_is_solved_and_not_called_an_open_ring() {
    let (dir, scene) = (folder("panorama_video"), furnished());
    let mut poses = Vec::new();
    for i in 0..10 {
        let pose = standing(i, 0.25, 0.1 * f64::from(i));
        panorama(&scene, &pose).save(dir.join(format!("{i:02}.png"))).unwrap();
        poses.extend(views_of(&format!("frame_{i:06}"), &pose));
    }
    let video = dir.join("walk.mp4");
    let encoded = std::process::Command::new("ffmpeg")
        .args(["-v", "error", "-framerate", "5", "-i", text(&dir.join("%02d.png"))])
        .args(["-c:v", "libx264", "-crf", "14", "-pix_fmt", "yuv420p", text(&video)])
        .status();
    assert!(encoded.unwrap().success());
    let flags = ["--lens", "panorama", "--frames", "10"];
    let errors = solved(&video, &dir.join("out"), &flags, &truth_of(poses));
    let [rotation_deg, centre_pct] = largest(&errors);
    assert!(rotation_deg < 0.3 && centre_pct < 0.6, "{rotation_deg}° {centre_pct} %");
    expect_panoramas(&dir.join("out"));
}

/// Photos of a fisheye on an arc about the block; `place`: radius in the picture, in radians, of a
/// direction so far from the axis.
fn fisheye_photos(photos: &Path, place: impl Fn(f64) -> f64 + Sync) -> Reconstruction {
    std::fs::create_dir_all(photos).unwrap();
    let (scene, half) = (furnished(), 300.0);
    let focal = half / (PI / 2.0);
    let ray = |pixel: DVec2| {
        let from_middle = pixel - DVec2::splat(half);
        let radius = from_middle.length() / focal;
        // The angle whose place this is, by bisection.
        let (mut low, mut high) = (0.0, PI / 2.0);
        for _ in 0..40 {
            let middle = (low + high) / 2.0;
            if place(middle) < radius { low = middle } else { high = middle }
        }
        let sides = from_middle.normalize_or_zero() * low.sin();
        (radius <= place(PI / 2.0)).then(|| sides.extend(low.cos()))
    };
    let mut poses = Vec::new();
    for i in 0..16 {
        let pose = orbit_pose(f64::from(i) * 0.2, 0.35 + 0.05 * f64::from(i % 2), 2.4);
        let picture = scene.render_through((600, 600), ray, &pose);
        picture.save(photos.join(format!("f{i:02}.png"))).unwrap();
        poses.push((format!("f{i:02}.png"), pose));
    }
    truth_of(poses)
}

#[test]
fn photos_of_a_fisheye_of_180_degrees_are_solved() {
    let dir = folder("fisheye");
    let truth = fisheye_photos(&dir.join("photos"), |theta| theta);
    let out = dir.join("out");
    let errors = solved(&dir.join("photos"), &out, &["--lens", "fisheye"], &truth);
    let [rotation_deg, centre_pct] = largest(&errors);
    assert!(rotation_deg < 0.3 && centre_pct < 0.6, "{rotation_deg}° {centre_pct} %");
    let notes = json(&out.join("run.json"))["frames"]["notes"].to_string();
    assert!(notes.contains("191 pixels a radian, 180° across its circle (assumed"), "{notes}");
    let bare = expect_code(
        &["frames", text(&dir.join("photos")), "-o", text(&dir.join("x")), "--fisheye-field", "150"],
        1,
    );
    assert!(bare.contains("--lens fisheye"), "{bare}");
}

#[test]
fn a_fisheye_that_is_not_quite_equidistant_is_solved_with_radial_terms() {
    let dir = folder("equisolid");
    // Of the same field and circle, but equisolid: r = 2 sin(θ/2), scaled.
    let truth =
        fisheye_photos(&dir.join("photos"), |theta| (theta / 2.0).sin() * PI / 2.0 / (PI / 4.0).sin());
    let errors = solved(&dir.join("photos"), &dir.join("out"), &["--lens", "fisheye"], &truth);
    let [rotation_deg, centre_pct] = largest(&errors);
    assert!(rotation_deg < 0.5 && centre_pct < 1.0, "{rotation_deg}° {centre_pct} %");
}

#[test]
fn metadata_say_what_is_up_where_the_cameras_do_not() {
    let (dir, scene) = (folder("stated_up"), furnished());
    let photos = dir.join("photos");
    std::fs::create_dir_all(&photos).unwrap();
    let camera = Camera::centred(1, CameraModel::SimplePinhole, 480, 360, 460.0);
    let mut poses = Vec::new();
    for i in 0..10 {
        // Down by 50 to 60°, all rolled by 12° clockwise: nothing in how they are held is level.
        let (down, away) = (50.0 + f64::from(i * 7 % 5) * 2.5, 2.9 + 0.2 * f64::from(i % 4));
        let level = orbit_pose(f64::from(i) * 0.12 + 0.04 * f64::from(i % 3), f64::to_radians(down), away);
        let roll = DQuat::from_rotation_z(-12_f64.to_radians());
        let pose = Pose::from_centre(roll * level.rotation, level.centre());
        // One of them is wrong.
        let pitch = if i == 4 { 10.0 } else { -down };
        let held =
            format!("drone-dji:GimbalPitchDegree=\"{pitch:+.2}\" drone-dji:GimbalRollDegree=\"+12.00\"");
        save(&photos.join(format!("d{i}.jpg")), &scene.render(&camera, &pose), &held);
        poses.push((format!("d{i}.jpg"), pose));
    }
    let out = dir.join("out");
    let truth = truth_of(poses);
    solved(&photos, &out, &[], &truth);
    let run = json(&out.join("run.json"));
    assert_eq!(run["poses"]["world"]["up_evidence"], "metadata");
    assert_eq!(run["poses"]["world"]["stated"], serde_json::json!([9, 10]));
    assert_eq!(decided(&run, "world-up")["choice"]["up"], "metadata");
    let model = scene::io::read_model(&out.join("sparse/0")).unwrap();
    let image = model.images.values().find(|i| i.name == "d0.jpg").unwrap();
    let true_up = truth.images[&1].pose.rotation * DVec3::Z;
    let found = image.pose.rotation * DVec3::NEG_Y;
    assert!(found.angle_between(true_up).to_degrees() < 0.3, "{found} {true_up}");
}
