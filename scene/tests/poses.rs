//! Ground-truth formats, `transforms.json` and the comparison of poses.

mod common;

use common::{folder, shared};
use scene::io::{
    TransformsOptions, read_model, read_transforms, read_truth, write_model_bin, write_transforms,
};
use scene::pose::rotation_angle;
use scene::sim3::compare_poses;
use scene::{CameraModel, Pose, Reconstruction};
use std::fs;
use std::process::Command;

#[test]
fn the_temple_truth_looks_inwards_from_a_ring() {
    let Some(path) = shared("temple_ring/cameras_par.txt") else { return };
    let truth = read_truth(&path).unwrap();
    assert_eq!((truth.images.len(), truth.cameras.len()), (47, 2), "some images were turned upside down");
    let camera = &truth.cameras[&truth.image_named("templeR0001.png").unwrap().camera];
    assert_eq!(camera.params, [1525.9, 1520.4, 246.87, 337.68]);
    let middle = truth.images.values().map(|i| i.pose.centre()).sum::<glam::DVec3>() / 47.0;
    for image in truth.images.values() {
        let inwards = (middle - image.pose.centre()).normalize();
        assert!(image.pose.view_direction().dot(inwards) > 0.7, "{}", image.name);
    }
}

#[test]
fn the_fountain_truth_has_its_eleven_cameras() {
    let Some(path) = shared("fountain_p11/gt_dense_cameras") else { return };
    let truth = read_truth(&path).unwrap();
    assert_eq!(truth.images.len(), 11);
    let image = truth.image_named("0000.jpg").unwrap();
    assert!((image.pose.centre() - glam::DVec3::new(-7.28137, -7.57667, 0.204446)).length() < 1e-9);
    let camera = &truth.cameras[&image.camera];
    assert_eq!((camera.width, camera.height, camera.params[1]), (3072, 2048, 2764.16));
}

#[test]
fn real_transforms_are_read_with_intrinsics_or_with_an_angle_of_view() {
    let Some(path) = shared("fox/transforms.json") else { return };
    let fox = read_transforms(&path).unwrap();
    assert_eq!((fox.frames.len(), fox.reconstruction.cameras.len()), (67, 1));
    assert_eq!(fox.frames.iter().filter(|f| f.found).count(), 50, "the others' files are not there");
    let camera = &fox.reconstruction.cameras[&1];
    assert_eq!((camera.model, camera.width, camera.height), (CameraModel::Opencv, 1080, 1920));
    assert_eq!(camera.params[..2], [1375.52, 1374.49]);
    let Some(path) = shared("lego400/transforms.json") else { return };
    let lego = read_transforms(&path).unwrap();
    assert_eq!(lego.frames.len(), 100);
    let camera = &lego.reconstruction.cameras[&1];
    assert_eq!((camera.model, camera.width), (CameraModel::Pinhole, 400));
    assert!((camera.params[0] - 555.555).abs() < 0.01, "{}", camera.params[0]);
    for image in lego.reconstruction.images.values() {
        let x = image.pose.transform(glam::DVec3::ZERO);
        assert!(x.z > 0.0 && x.truncate().length() < 0.05 * x.z, "{} looks at the origin", image.name);
        assert!((x.length() - 4.0311).abs() < 0.01);
    }
}

/// Poses of a real model without its points.
fn poses_of(model: &Reconstruction) -> Reconstruction {
    let mut poses = Reconstruction { points: Default::default(), ..model.clone() };
    poses.images.values_mut().for_each(|i| i.observations.clear());
    poses
}

#[test]
fn transforms_survive_writing_and_reading() {
    let Some(path) = shared("phone_video/can_orbit_colmap") else { return };
    let model = poses_of(&read_model(&path).unwrap());
    let path = folder("transforms").join("transforms.json");
    let mut options = TransformsOptions { image_folder: "images".into(), ..Default::default() };
    options.masks.insert(*model.images.keys().next().unwrap(), "masks/a.png".into());
    options.ply_file_path = Some("sparse.ply".into());
    write_transforms(&path, &model, &options).unwrap();
    let back = read_transforms(&path).unwrap();
    assert_eq!(back.ply_file_path.as_deref(), Some("sparse.ply"));
    assert_eq!(back.frames[0].mask_path.as_deref(), Some("masks/a.png"));
    for (image, other) in model.images.values().zip(back.reconstruction.images.values()) {
        assert_eq!(other.name, format!("images/{}", image.name));
        assert!(rotation_angle(image.pose.rotation, other.pose.rotation) < 1e-14);
        assert!((image.pose.centre() - other.pose.centre()).length() < 1e-12);
        let (a, b) = (&model.cameras[&image.camera], &back.reconstruction.cameras[&other.camera]);
        assert_eq!((a.focal(), a.principal_point()), (b.focal(), b.principal_point()));
        for x in [glam::DVec3::new(0.3, 0.2, 1.0), glam::DVec3::new(-0.4, 0.1, 1.0)] {
            assert!((a.project(x).unwrap() - b.project(x).unwrap()).length() < 1e-9);
        }
    }
}

#[test]
fn hostile_transforms_are_refused_with_a_reason() {
    let dir = folder("hostile_transforms");
    let matrix = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
    let size = r#""w":10,"h":10,"fl_x":9"#;
    let cases = [
        (format!(r#"{{{size},"frames":[{{"file_path":"../a.png","transform_matrix":{matrix}}}]}}"#), ".."),
        (
            format!(r#"{{{size},"frames":[{{"file_path":"/a.png","transform_matrix":{matrix}}}]}}"#),
            "absolute",
        ),
        (format!(r#"{{{size},"frames":[{{"file_path":"a.png","transform_matrix":[[1]]}}]}}"#), "4×4"),
        (
            format!(
                r#"{{{size},"frames":[{{"file_path":"a","transform_matrix":[[1,0,0,1e999],[0,1,0,0],[0,0,1,0]]}}]}}"#
            ),
            "",
        ),
        (
            format!(
                r#"{{{size},"frames":[{{"file_path":"a","transform_matrix":[[1,0,0,0],[0,1,0,0],[0,0,-1,0]]}}]}}"#
            ),
            "determinant",
        ),
        (
            format!(
                r#"{{"w":0,"h":10,"fl_x":9,"frames":[{{"file_path":"a.png","transform_matrix":{matrix}}}]}}"#
            ),
            "size",
        ),
        (
            format!(r#"{{"w":9,"h":10,"frames":[{{"file_path":"a.png","transform_matrix":{matrix}}}]}}"#),
            "fl_x",
        ),
        (
            format!(r#"{{"fl_x":9,"frames":[{{"file_path":"a.png","transform_matrix":{matrix}}}]}}"#),
            "image file",
        ),
        (
            format!(
                r#"{{{size},"camera_model":"OPENCV_FISHEYE","frames":[{{"file_path":"a","transform_matrix":{matrix}}}]}}"#
            ),
            "FISHEYE",
        ),
        (r#"{"frames":[]}"#.to_string(), "no"),
        ("[".repeat(100_000), ""),
        (String::new(), "transforms.json"),
    ];
    for (i, (text, reason)) in cases.into_iter().enumerate() {
        let path = dir.join("transforms.json");
        fs::write(&path, text).unwrap();
        let message = read_transforms(&path).unwrap_err().to_string();
        assert!(message.contains(reason), "case {i}: {message}");
    }
}

/// The temple's truth moved, with errors of known pattern, ten images missing.
fn disturbed(truth: &Reconstruction) -> Reconstruction {
    let mut model = truth.clone();
    for (id, image) in &mut model.images {
        let k = f64::from(*id);
        let wobble = glam::DVec3::new((k * 1.3).sin(), (k * 2.1).cos(), (k * 0.7).sin());
        let turn = glam::DQuat::from_scaled_axis(wobble * if id % 9 == 0 { 0.2 } else { 0.01 });
        let shift = wobble.cross(glam::DVec3::ONE) * if id % 11 == 0 { 0.1 } else { 0.002 };
        image.pose = Pose::from_centre(turn * image.pose.rotation, image.pose.centre() + shift);
    }
    model.images.retain(|id, _| id % 7 != 3);
    let sim = scene::sim3::Sim3 {
        scale: 17.0,
        rotation: glam::DQuat::from_xyzw(0.1, 0.7, -0.2, 0.4).normalize(),
        translation: glam::DVec3::new(5.0, -3.0, 100.0),
    };
    model.cameras.values_mut().for_each(|c| (c.width, c.height, c.params[0]) = (480, 640, 1600.0));
    sim.transform_reconstruction(&model)
}

#[test]
fn pose_errors_agree_with_compare_poses_py() {
    let Some(path) = shared("temple_ring/cameras_par.txt") else { return };
    let script = path.with_file_name("../../tools/compare_poses.py");
    let truth = read_truth(&path).unwrap();
    let model = disturbed(&truth);
    let ours = compare_poses(&model, &truth);
    let dir = folder("compare");
    write_model_bin(&model, &dir.join("model")).unwrap();
    let run = Command::new("python3")
        .arg(script)
        .arg(dir.join("model"))
        .arg("--gt")
        .arg(&path)
        .arg("--json")
        .arg(dir.join("o.json"))
        .output();
    if !run.as_ref().is_ok_and(|r| r.status.success()) {
        eprintln!("SKIPPED: compare_poses.py does not run: {run:?}");
        return;
    }
    let json: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(dir.join("o.json")).unwrap()).unwrap();
    let theirs = json.get(0).unwrap_or(&json);
    let rotation = ours.rotation_deg.unwrap();
    let centre = ours.centre_pct.unwrap();
    let auc = ours.auc.unwrap();
    let rows = [
        ("registered", ours.registered as f64),
        ("total", ours.total as f64),
        ("auc@1", auc[0]),
        ("auc@3", auc[1]),
        ("auc@5", auc[2]),
        ("auc@10", auc[3]),
        ("rot_deg_median", rotation.median),
        ("rot_deg_max", rotation.max),
        ("centre_pct_median", centre.median),
        ("centre_pct_mean", centre.mean),
        ("centre_pct_max", centre.max),
        ("focal_err_pct", ours.focal_err_pct.unwrap()),
        ("align_scale", ours.scale.unwrap()),
    ];
    for (key, ours) in rows {
        let theirs = theirs[key].as_f64().unwrap();
        assert!(
            (ours - theirs).abs() < 1e-6 * theirs.abs().max(1.0),
            "{key}: {ours}, compare_poses.py {theirs}"
        );
    }
}
