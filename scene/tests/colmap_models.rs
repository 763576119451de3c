//! COLMAP model folders: real ones, round trips, hostile ones, and COLMAP itself as the reader.

mod common;

use common::{folder, shared};
use glam::{DQuat, DVec2, DVec3};
use scene::io::{IoError, read_model, write_model_bin, write_model_txt};
use scene::{Camera, CameraModel, Observation, Pose, PosedImage, Reconstruction, ScenePoint, TrackElement};
use std::fs;
use std::process::Command;

/// Two images, two points, one keypoint without a point, an image name with a space.
fn small_model() -> Reconstruction {
    let mut model = Reconstruction::default();
    for (i, camera_model) in CameraModel::ALL.into_iter().enumerate() {
        let mut camera = Camera::centred(i as u32 + 1, camera_model, 640, 480, 700.0 / 3.0);
        if let Some(last) = camera.params.last_mut().filter(|_| camera_model.num_params() > 4) {
            *last = 1.0e-7 / 3.0;
        }
        model.cameras.insert(camera.id, camera);
    }
    for id in [3_u32, 9] {
        let observation =
            |x: f64, point| Observation { pixel: DVec2::new(x / 7.0, 1.0 / f64::from(id)), point };
        let image = PosedImage {
            id,
            camera: id % 5 + 1,
            name: format!("sub/view {id}.png"),
            pose: Pose::new(
                DQuat::from_xyzw(0.1, f64::from(id), -0.3, 1.0),
                DVec3::new(1e-9, 2e7, -1.0 / 3.0),
            ),
            observations: vec![
                observation(1.0, Some(4)),
                observation(2.0, None),
                observation(3.0, Some(u64::MAX - 1)),
            ],
        };
        model.images.insert(id, image);
    }
    for (id, observation) in [(4, 0), (u64::MAX - 1, 2)] {
        let track = vec![TrackElement { image: 3, observation }, TrackElement { image: 9, observation }];
        let point =
            ScenePoint { position: DVec3::new(-0.1, 1e-30, 5.0), rgb: [0, 128, 255], error_px: 0.7, track };
        model.points.insert(id, point);
    }
    model
}

#[test]
fn a_model_survives_both_forms_bit_for_bit() {
    let model = small_model();
    let dir = folder("round_trip");
    write_model_bin(&model, &dir.join("bin")).unwrap();
    write_model_txt(&model, &dir.join("txt/sparse/0")).unwrap();
    assert_eq!(read_model(&dir.join("bin")).unwrap(), model);
    assert_eq!(read_model(&dir.join("txt")).unwrap(), model, "the text form, found in sparse/0");
}

#[test]
fn an_empty_model_is_written_and_read() {
    let dir = folder("empty");
    write_model_bin(&Reconstruction::default(), &dir).unwrap();
    assert_eq!(read_model(&dir).unwrap(), Reconstruction::default());
}

#[test]
fn real_models_are_read_and_project_where_they_say() {
    for (sub, images) in [("colmap_model", 56), ("phone_video/can_orbit_colmap", 71)] {
        let Some(dir) = shared(sub) else { return };
        let model = read_model(&dir).unwrap();
        assert_eq!(model.images.len(), images);
        let errors = model.reprojection_errors();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let stored = model.points.values().map(|p| p.error_px * p.track.len() as f64).sum::<f64>()
            / errors.len() as f64;
        assert!((mean - stored).abs() < 1e-3 * stored, "{sub}: {mean} px, COLMAP said {stored}");
        let out = folder("real").join(sub);
        write_model_txt(&model, &out).unwrap();
        assert_eq!(read_model(&out).unwrap(), model);
    }
}

#[test]
fn models_with_rigs_and_frames_are_read_in_both_forms() {
    // Made by tests/oracle/rigs.py with COLMAP 4.2.1.
    let dir = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/rigs");
    assert!(dir.join("rigs.bin").is_file() && dir.join("text/frames.txt").is_file());
    let poses: serde_json::Value =
        serde_json::from_slice(&fs::read(dir.join("poses.json")).unwrap()).unwrap();
    for folder in [dir.clone(), dir.join("text")] {
        let model = read_model(&folder).unwrap();
        assert_eq!((model.cameras.len(), model.images.len(), model.points.len()), (2, 6, 20));
        assert!(model.reprojection_errors().iter().all(|e| *e < 1e-3), "the scene is exact");
        for image in model.images.values() {
            let said = &poses[&image.name];
            let number = |key: &str, i: usize| said[key][i].as_f64().unwrap();
            let q = DQuat::from_xyzw(
                number("quat_wxyz", 1),
                number("quat_wxyz", 2),
                number("quat_wxyz", 3),
                number("quat_wxyz", 0),
            );
            let t = DVec3::new(number("translation", 0), number("translation", 1), number("translation", 2));
            assert_eq!(said["camera"], image.camera);
            assert!(image.pose.rotation.dot(q).abs() > 1.0 - 1e-12, "{}", image.name);
            assert!(image.pose.translation.distance(t) < 1e-9, "{}", image.name);
        }
    }
}

#[test]
fn names_that_lead_out_of_the_folder_are_refused() {
    for bad in ["../x.png", "/etc/passwd", "a\\b.png"] {
        let dir = folder("names");
        let mut model = small_model();
        write_model_txt(&model, &dir).unwrap();
        let text = fs::read_to_string(dir.join("images.txt")).unwrap();
        fs::write(dir.join("images.txt"), text.replace("sub/view 3.png", bad)).unwrap();
        assert!(matches!(read_model(&dir), Err(IoError::Name { .. })), "{bad}");
        model.images.get_mut(&3).unwrap().name = bad.into();
        assert!(matches!(write_model_bin(&model, &dir), Err(IoError::Name { .. })), "{bad}");
    }
}

#[test]
fn a_count_larger_than_the_file_is_refused_before_memory_is_reserved() {
    let dir = folder("counts");
    write_model_bin(&small_model(), &dir).unwrap();
    for file in ["cameras.bin", "images.bin", "points3D.bin"] {
        let whole = fs::read(dir.join(file)).unwrap();
        let mut bad = whole.clone();
        bad[..8].copy_from_slice(&(u64::MAX / 3).to_le_bytes());
        fs::write(dir.join(file), bad).unwrap();
        assert!(matches!(read_model(&dir), Err(IoError::Truncated { .. })), "{file}");
        fs::write(dir.join(file), whole).unwrap();
    }
}

#[test]
fn poses_and_points_that_are_not_numbers_are_refused() {
    let dir = folder("nan");
    for (file, word) in [("images.txt", "0.000000001"), ("images.txt", "1e-9"), ("points3D.txt", "1e-30")] {
        write_model_txt(&small_model(), &dir).unwrap();
        let text = fs::read_to_string(dir.join(file)).unwrap();
        if !text.contains(word) {
            continue;
        }
        fs::write(dir.join(file), text.replace(word, "nan")).unwrap();
        assert!(matches!(read_model(&dir), Err(IoError::NotFinite { .. })), "{file}");
    }
}

#[test]
fn a_fisheye_camera_is_named_in_the_message() {
    let dir = folder("fisheye");
    write_model_bin(&small_model(), &dir).unwrap();
    let mut bytes = fs::read(dir.join("cameras.bin")).unwrap();
    bytes[12] = 5;
    fs::write(dir.join("cameras.bin"), bytes).unwrap();
    let message = read_model(&dir).unwrap_err().to_string();
    assert!(message.contains("OPENCV_FISHEYE") && message.contains("undistort"), "{message}");
    write_model_txt(&small_model(), &dir.join("t")).unwrap();
    fs::write(dir.join("t/cameras.txt"), "1 FOV 640 480 1 2 3 4 5\n").unwrap();
    assert!(read_model(&dir.join("t")).unwrap_err().to_string().contains("FOV"));
}

#[test]
fn quaternions_are_normalised_and_a_zero_one_is_refused() {
    let dir = folder("quaternion");
    write_model_txt(&small_model(), &dir).unwrap();
    fs::write(dir.join("points3D.txt"), "").unwrap();
    let cases = [("1.01 0 0 0", true), ("2 0 0 0", false), ("0 0 0 0", false), ("1e200 0 0 1e200", false)];
    for (quaternion, fine) in cases {
        fs::write(dir.join("images.txt"), format!("7 {quaternion} 0 0 0 1 a.png\n\n")).unwrap();
        match read_model(&dir) {
            Ok(model) => assert!(fine && (model.images[&7].pose.rotation.length() - 1.0).abs() < 1e-15),
            Err(e) => assert!(!fine, "{quaternion}: {e}"),
        }
    }
}

#[test]
fn a_model_that_contradicts_itself_is_refused_both_ways() {
    let mut model = small_model();
    model.cameras.remove(&4);
    let dir = folder("contradiction");
    assert!(write_model_bin(&model, &dir).unwrap_err().to_string().contains("camera 4"));
    write_model_txt(&small_model(), &dir).unwrap();
    fs::write(dir.join("points3D.txt"), "4 0 0 0 1 2 3 0.5 3 0 9 1\n").unwrap();
    assert!(read_model(&dir).unwrap_err().to_string().contains("contradicts"));
}

#[test]
fn colmap_reads_what_we_write_and_we_read_what_it_makes_of_it() {
    let Some(dir) = shared("phone_video/can_orbit_colmap") else { return };
    let ok = Command::new("colmap").arg("help").output().is_ok_and(|o| o.status.success());
    if !ok {
        eprintln!("SKIPPED: colmap is not installed");
        return;
    }
    let out = folder("colmap");
    let model = read_model(&dir).unwrap();
    write_model_bin(&model, &out.join("bin")).unwrap();
    fs::create_dir(out.join("txt")).unwrap();
    let run = Command::new("colmap")
        .env("QT_QPA_PLATFORM", "offscreen")
        .args(["model_converter", "--output_type", "TXT", "--input_path"])
        .arg(out.join("bin"))
        .arg("--output_path")
        .arg(out.join("txt"))
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let back = read_model(&out.join("txt")).unwrap();
    assert_eq!(back.points.len(), model.points.len());
    for (id, image) in &model.images {
        let other = &back.images[id];
        assert_eq!(other.observations.len(), image.observations.len());
        assert!((other.pose.centre() - image.pose.centre()).length() < 1e-9);
    }
}
