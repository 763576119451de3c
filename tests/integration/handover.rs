//! What other programs get: the world frame of all outputs, and the folders of `export --for`.

use super::end_to_end::finished_run;
use super::support::{decided, expect_code, folder, json, sample, sat_recon, text};
use glam::DVec3;
use scene::{Reconstruction, Ring};
use std::collections::BTreeSet;
use std::path::Path;

fn model(folder: &Path) -> Reconstruction {
    scene::io::read_model(folder).unwrap()
}

fn names(folder: &Path) -> BTreeSet<String> {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
}

fn export(tool: &str) -> std::path::PathBuf {
    let target = folder(&format!("for_{tool}")).join("set");
    let said = expect_code(&["export", text(finished_run()), "--for", tool, "-o", text(&target)], 0);
    assert!(said.contains("to load it"), "{said}");
    target
}

/// Upright (y down), the object in the origin, its radius one unit; told in the record.
#[test]
fn poses_points_and_splat_lie_in_one_upright_world() {
    let out = finished_run();
    let found = model(&out.join("sparse/0"));
    let poses: Vec<scene::Pose> = found.images.values().map(|i| i.pose).collect();
    let axis = Ring::fit(&poses).expect("the cameras stand on a circle").axis;
    assert!(axis.y.abs() > 0.9995, "the circle lies flat: {axis}");
    let held: DVec3 = poses.iter().map(|p| p.rotation.conjugate() * DVec3::NEG_Y).sum();
    assert!(held.normalize().y < -0.7, "the cameras stand upright: {held}");
    let splat = scene::io::read_splat(&out.join("splat.ply")).unwrap();
    let mut radii: Vec<f32> = splat.means.iter().map(|m| m.length()).collect();
    radii.sort_by(f32::total_cmp);
    assert!((0.2..2.0).contains(&radii[radii.len() / 2]), "the object is about one unit large");
    let run = json(&out.join("run.json"));
    assert_eq!(run["poses"]["world"]["up"], serde_json::json!([0.0, -1.0, 0.0]));
    assert_eq!(run["poses"]["world"]["unit"], "object-radius");
    assert_eq!(decided(&run, "world-up")["rule"], "evidence");
    let report = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(report.contains("<h3>Up direction"));
}

/// The longest distance between two points, about: of a cloud without its outermost.
fn extent(model: &Reconstruction) -> f64 {
    let widths = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| {
        let mut along: Vec<f64> = model.points.values().map(|p| p.position.dot(axis)).collect();
        along.sort_by(f64::total_cmp);
        along[along.len() - 1 - along.len() / 200] - along[along.len() / 200]
    });
    widths.into_iter().fold(0.0, f64::max)
}

#[test]
fn a_known_length_makes_everything_metric_and_the_record_says_by_what() {
    let out = folder("metric");
    let input = sample("sample/orbit.mp4");
    let few = ["--frames", "24", "--quality", "draft", "--quiet"];
    let solved =
        sat_recon(&[&["sfm", text(&input), "-o", text(&out), "--known-length", "0.25"], &few[..]].concat());
    assert!(matches!(solved.status.code(), Some(0 | 3)), "{solved:?}");
    let found = extent(&model(&out.join("sparse/0")));
    assert!((0.15..=0.26).contains(&found), "0.25 m from end to end: {found}");
    let run = json(&out.join("run.json"));
    assert_eq!(run["poses"]["world"]["unit"], "metre");
    assert_eq!(run["poses"]["world"]["scale"]["evidence"], "longest-extent");
    assert_eq!(decided(&run, "world-scale")["rule"], "given");
    let kept = &["sfm", text(&input), "-o", text(&out), "--keep-frame", "--tag-size", "0.1"];
    assert!(expect_code(kept, 1).contains("cannot be used with"));
    let said =
        expect_code(&["sfm", text(&input), "-o", text(&out), "--tag-size", "0.1", "--frames", "24"], 1);
    assert!(said.contains("no tag was read"), "{said}");
}

#[test]
fn transforms_json_has_z_up_and_names_the_split() {
    let written = json(&finished_run().join("transforms.json"));
    let frames = written["frames"].as_array().unwrap();
    let up: f64 = frames.iter().map(|f| f["transform_matrix"][2][1].as_f64().unwrap()).sum();
    assert!(up > 0.7 * frames.len() as f64, "{up}");
    let list = |key: &str| -> BTreeSet<String> {
        let all = written[key].as_array().unwrap_or_else(|| panic!("{key} is missing"));
        all.iter().map(|n| n.as_str().unwrap().to_owned()).collect()
    };
    let (train, held_out) = (list("train_filenames"), list("val_filenames"));
    assert_eq!((held_out.len(), train.len()), (5, 31));
    assert!(train.is_disjoint(&held_out) && held_out == list("test_filenames"));
    let judged = json(&finished_run().join("eval/metrics.json"));
    for view in judged["views"].as_array().unwrap() {
        assert!(held_out.contains(&format!("images/{}", view["name"].as_str().unwrap())), "{view}");
    }
    assert!(frames[1]["time_s"].as_f64().unwrap() > 0.0);
}

#[test]
fn an_exported_json_keeps_the_images_folder_and_the_cloud() {
    let out = finished_run();
    let target = folder("json").join("x.json");
    let said = expect_code(&["export", text(out), "-o", text(&target)], 0);
    assert!(said.contains("put it there"), "{said}");
    assert_eq!(std::fs::read(&target).unwrap(), std::fs::read(out.join("transforms.json")).unwrap());
    assert_eq!(json(&target)["ply_file_path"], "sparse_points.ply");
    assert!(json(&target)["frames"][0]["file_path"].as_str().unwrap().starts_with("images/"));
}

#[test]
fn sets_for_gaussian_trainers_hold_images_a_model_and_nothing_that_misleads() {
    for tool in ["3dgs", "gsplat", "brush"] {
        let set = export(tool);
        let found = model(&set.join("sparse/0"));
        assert_eq!(found.images.len(), 36);
        assert!(found.cameras.values().all(|c| c.model == scene::CameraModel::Pinhole));
        let images: BTreeSet<String> = found.images.values().map(|i| i.name.clone()).collect();
        assert_eq!(names(&set.join("images")), images, "{tool}");
        let expected = ["frame_times.csv", "images", "sparse"].map(str::to_owned);
        assert_eq!(names(&set), expected.into(), "{tool}");
        let list = set.join("sparse/0/test.txt");
        assert_eq!(list.is_file(), tool == "3dgs");
        if tool == "3dgs" {
            assert_eq!(std::fs::read_to_string(list).unwrap().lines().count(), 5);
        }
    }
}

#[test]
fn sets_for_nerfstudio_metashape_and_colmap_are_read_back_with_the_same_poses() {
    let given = model(&finished_run().join("sparse/0"));
    for (tool, file) in
        [("nerfstudio", "transforms.json"), ("metashape", "cameras.xml"), ("colmap", "sparse/0")]
    {
        let set = export(tool);
        let read = scene::io::read_poses(&set.join(file), &set.join("images")).unwrap().model;
        assert_eq!(read.images.len(), given.images.len(), "{tool}");
        for image in read.images.values() {
            let stem = |name: &str| Path::new(name).file_stem().unwrap().to_owned();
            let of_run = given.images.values().find(|i| stem(&i.name) == stem(&image.name)).unwrap();
            let angle = scene::pose::rotation_angle(image.pose.rotation, of_run.pose.rotation);
            assert!(angle < 1e-6, "{tool} {}: {angle}", image.name);
            assert!(image.pose.centre().distance(of_run.pose.centre()) < 1e-6, "{tool} {}", image.name);
        }
    }
}

/// Three photos with a square cut out, and their poses.
fn cut_out() -> std::path::PathBuf {
    let dir = folder("cut_out");
    for sub in ["set/images", "set/sparse/0"] {
        std::fs::create_dir_all(dir.join(sub)).unwrap();
    }
    let mut images = String::new();
    for i in 1..4_u8 {
        let inside = |v: u32, size: u32| (size / 4..3 * size / 4).contains(&v);
        let photo = image::RgbaImage::from_fn(64, 48, |x, y| {
            let alpha = if inside(x, 64) && inside(y, 48) { 255 } else { 0 };
            image::Rgba([200, (4 * x) as u8, 60 * i, alpha])
        });
        photo.save(dir.join(format!("set/images/{i}.png"))).unwrap();
        images += &format!("{i} 1 0 0 0 0.{i} 0 4 1 {i}.png\n\n");
    }
    let model = dir.join("set/sparse/0");
    std::fs::write(model.join("cameras.txt"), "1 PINHOLE 64 48 60 60 32 24\n").unwrap();
    std::fs::write(model.join("images.txt"), images).unwrap();
    std::fs::write(model.join("points3D.txt"), "").unwrap();
    let out = dir.join("out");
    expect_code(&["sfm", text(&dir.join("set")), "-o", text(&out)], 0);
    out
}

#[test]
fn mattes_are_burnt_in_or_alpha_and_masks_are_named_as_each_program_wants_them() {
    let out = cut_out();
    let set = |tool: &str| {
        let target = out.with_file_name(tool);
        expect_code(&["export", text(&out), "--for", tool, "-o", text(&target)], 0);
        target
    };
    let three = |ending: &str| -> BTreeSet<String> { (1..4).map(|i| format!("{i}{ending}")).collect() };
    let corner = |set: &Path| image::open(set.join("images/1.png")).unwrap().to_rgba8().get_pixel(1, 1).0;
    for tool in ["3dgs", "gsplat", "brush", "nerfstudio"] {
        let set = set(tool);
        assert!(!set.join("masks").exists(), "{tool}: masks are in the pixels");
        let expected = if ["3dgs", "gsplat"].contains(&tool) { [0, 0, 0, 255] } else { [200, 4, 60, 0] };
        assert_eq!(corner(&set), expected, "{tool}");
        assert!(!set.join("splat.ply").exists());
    }
    assert_eq!(names(&set("colmap").join("masks")), three(".png.png"));
    assert_eq!(names(&set("metashape").join("masks")), three("_mask.png"));
    let written = json(&out.join("transforms.json"));
    assert_eq!(written["frames"][0]["mask_path"], "masks/1.png");
    std::fs::remove_dir_all(out.parent().unwrap()).unwrap();
}

#[test]
fn a_set_is_not_written_over_what_is_there() {
    let target = folder("not_over");
    std::fs::write(target.join("mine.txt"), "mine").unwrap();
    let said = expect_code(&["export", text(finished_run()), "--for", "brush", "-o", text(&target)], 1);
    assert!(said.contains("not empty"), "{said}");
    assert_eq!(names(&target), ["mine.txt".to_owned()].into());
}

/// An object as it leaves the program: red on top (y = −1), blue at the bottom (y = 1), grey
/// between.
fn standing() -> scene::Gaussians {
    let mut splat = scene::Gaussians::default();
    for i in 0..4000 {
        // A spiral over a column.
        let (y, angle) = (2.0 * (i as f32 / 3999.0) - 1.0, i as f32 * 2.399_963);
        let colour = if y < -0.5 {
            [0.9, 0.1, 0.1]
        } else if y > 0.5 {
            [0.1, 0.1, 0.9]
        } else {
            [0.5; 3]
        };
        splat.means.push(glam::Vec3::new(0.5 * angle.cos(), y, 0.5 * angle.sin()));
        splat.log_scales.push(glam::Vec3::splat(0.04_f32.ln()));
        splat.rotations.push(glam::Quat::IDENTITY);
        splat.opacity_logits.push(3.0);
        splat.sh.extend(colour.map(|c: f32| (c - 0.5) / scene::gaussians::SH_C0));
    }
    splat
}

/// What is up in our world is up in SuperSplat and in Spark.
#[test]
fn a_splat_stands_upright_in_the_viewers_of_others() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("viewer");
    if !super::viewer::can_look() {
        return;
    }
    let dir = folder("upright");
    let splat = dir.join("splat.ply");
    scene::io::write_splat(&splat, &standing()).unwrap();
    let script = root.join("test_upright.mjs");
    let browser = super::viewer::chromium();
    let output = std::process::Command::new("node")
        .args([text(&script), text(&browser), text(&splat), text(&dir)])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let problem = String::from_utf8_lossy(&output.stderr).into_owned();
    let seen: serde_json::Value = serde_json::from_str(&said).unwrap_or_else(|_| panic!("{said}{problem}"));
    for viewer in ["supersplat", "spark"] {
        let at = |what: &str| seen[viewer][what].as_f64().unwrap_or(f64::NAN);
        assert!(at("pixels") > 500.0, "{viewer} shows the object: {seen}");
        assert!(at("red") + 0.1 < at("blue"), "red is on top in {viewer}: {seen}");
    }
    std::fs::remove_dir_all(dir).unwrap();
}
