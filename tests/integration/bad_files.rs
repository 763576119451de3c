//! Bad files where a finished run, a splat or weights are expected: refused by name, with what to
//! do.

use super::end_to_end::finished_run;
use super::support::{expect_code, folder, text};
use std::path::{Path, PathBuf};

/// What a finished run needs to be compared and reported: a copy that may be damaged.
fn copy_of_run(name: &str) -> PathBuf {
    fn copy(from: &Path, to: &Path) {
        std::fs::create_dir_all(to).unwrap();
        for entry in std::fs::read_dir(from).unwrap() {
            let path = entry.unwrap().path();
            let target = to.join(path.file_name().unwrap());
            if path.is_dir() {
                copy(&path, &target);
            } else {
                std::fs::copy(&path, &target).unwrap();
            }
        }
    }
    let out = folder(name).join("run");
    copy(finished_run(), &out);
    out
}

fn first_file(folder: &Path) -> PathBuf {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    files.swap_remove(0)
}

#[test]
fn a_run_whose_renders_are_missing_is_named_by_compare_and_mended_by_report() {
    let run = copy_of_run("lost_renders");
    let lost = first_file(&run.join("eval/renders"));
    std::fs::remove_file(&lost).unwrap();
    let said = expect_code(&["compare", text(&run)], 1);
    let name = lost.file_name().unwrap().to_string_lossy().into_owned();
    assert!(said.contains(&name) && said.contains("eval again"), "{said}");
    expect_code(&["report", text(&run)], 0);
    assert!(lost.is_file(), "the picture is there again");
    expect_code(&["compare", text(&run)], 0);
    std::fs::remove_dir_all(run.parent().unwrap()).unwrap();
}

#[test]
fn a_picture_name_that_leads_out_of_the_run_is_refused() {
    let run = copy_of_run("tricked_renders");
    let path = run.join("eval/metrics.json");
    let metrics = std::fs::read_to_string(&path).unwrap();
    let name = first_file(&run.join("eval/renders")).file_name().unwrap().to_string_lossy().into_owned();
    for trick in ["../../../outside.png", "/etc/hostname", "..\\\\outside.png"] {
        std::fs::write(&path, metrics.replace(&name, trick)).unwrap();
        let said = expect_code(&["compare", text(&run)], 1);
        assert!(said.contains("inside the folder"), "{trick}: {said}");
    }
    std::fs::write(&path, metrics.replace(&name, "%2e%2e/outside.png")).unwrap();
    assert!(expect_code(&["compare", text(&run)], 1).contains("is missing"), "nothing is decoded");
    std::fs::remove_dir_all(run.parent().unwrap()).unwrap();
}

#[test]
fn weights_of_the_wrong_shape_are_refused_before_the_work_begins() {
    let dir = folder("weights");
    let path = dir.join("weights.safetensors");
    let header = r#"{"features.0.weight":{"dtype":"F32","shape":[64,3,7,7],"data_offsets":[0,37632]}}"#;
    let bytes = [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &vec![0; 37632]].concat();
    std::fs::write(&path, bytes).unwrap();
    let photos = dir.join("photos");
    std::fs::create_dir_all(&photos).unwrap();
    for i in 0..3 {
        image::RgbImage::new(64, 48).save(photos.join(format!("{i}.png"))).unwrap();
    }
    let out = dir.join("out");
    let said = expect_code(&[text(&photos), "-o", text(&out), "--lpips-weights", text(&path)], 1);
    for word in ["weights.safetensors", "features.0.weight", "[64, 3, 11, 11]", "[64, 3, 7, 7]"] {
        assert!(said.contains(word), "{word}: {said}");
    }
    assert!(!out.join("images").exists(), "nothing was begun");
    std::fs::remove_dir_all(dir).unwrap();
}

/// A small splat in the 3DGS order.
fn splat(path: &Path) -> Vec<u8> {
    let mut g = scene::Gaussians { sh_degree: 0, ..Default::default() };
    for i in 0..8 {
        g.means.push(glam::Vec3::splat(i as f32));
        g.log_scales.push(glam::Vec3::splat(-3.0));
        g.rotations.push(glam::Quat::IDENTITY);
        g.opacity_logits.push(1.0);
        g.sh.extend([0.1; 3]);
    }
    scene::io::write_splat_ply(path, &g).unwrap();
    std::fs::read(path).unwrap()
}

fn replaced(bytes: &[u8], from: &str, to: &str) -> Vec<u8> {
    let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
    [&bytes[..at], to.as_bytes(), &bytes[at + from.len()..]].concat()
}

#[test]
fn splats_with_nan_a_wrong_header_or_a_claim_of_two_gigabytes_are_refused() {
    let dir = folder("bad_splats");
    let path = dir.join("bad.ply");
    let good = splat(&path);
    let body = good.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let mut nan = good.clone();
    nan[body..body + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    // 8 vertices are 544 bytes; 32 million of them are two gigabytes.
    let claim = replaced(&good, "element vertex 8", "element vertex 32000000");
    assert!(claim.len() < 1200, "{}", claim.len());
    for (content, word) in [
        (nan, "not finite"),
        (claim, "cut off"),
        (replaced(&good, "ply\n", "plx\n"), "begins with the line 'ply'"),
        (replaced(&good, "property float opacity", "property float opaque"), "opacity"),
        (replaced(&good, "binary_little_endian", "binary_middle_endian"), "makes no sense"),
        (replaced(&good, "element vertex 8", "element vertex -8"), "number of rows"),
        (replaced(&good, "end_header", "end_headed"), "makes no sense"),
    ] {
        std::fs::write(&path, content).unwrap();
        let said = expect_code(&["export", text(&path), "-o", text(&dir.join("out.spz"))], 1);
        assert!(said.contains(word) && said.contains("bad.ply"), "{word}: {said}");
        assert!(!dir.join("out.spz").exists(), "{word}");
    }
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn a_splat_with_nan_is_not_handed_to_a_browser() {
    if sat_recon::view::BUNDLE.is_none() {
        return eprintln!("SKIPPED: built without the viewer");
    }
    let run = copy_of_run("nan_splat");
    let path = run.join("splat.ply");
    let mut bytes = std::fs::read(&path).unwrap();
    let body = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    bytes[body..body + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(&path, bytes).unwrap();
    for command in [&["export", text(&run), "--html"][..], &["view", text(&run)]] {
        let said = expect_code(command, 1);
        assert!(said.contains("splat.ply") && said.contains("not finite"), "{said}");
    }
    std::fs::remove_dir_all(run.parent().unwrap()).unwrap();
}

#[test]
fn poses_whose_photos_lie_elsewhere_are_refused() {
    let dir = folder("tricked_transforms");
    image::RgbImage::new(64, 48).save(dir.join("a.png")).unwrap();
    let unit = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
    for (name, word) in [
        ("../b.png", "'..'"),
        ("/etc/b.png", "absolute"),
        ("a/../../b.png", "'..'"),
        ("%2e%2e/b.png", "%2e%2e/b.png"),
    ] {
        let frame = |name: &str| format!(r#"{{"file_path":"{name}","transform_matrix":{unit}}}"#);
        let frames = [frame("a.png"), frame(name)].join(",");
        let json = format!(r#"{{"w":64,"h":48,"fl_x":60,"frames":[{frames}]}}"#);
        std::fs::write(dir.join("transforms.json"), json).unwrap();
        let out = dir.join("out");
        let said = expect_code(&["sfm", text(&dir), "-o", text(&out)], 1);
        assert!(said.contains(word), "{name}: {said}");
    }
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn tables_that_are_none_are_refused_by_name() {
    let dir = folder("bad_tables");
    let path = dir.join("beside.json");
    let torn = r#"[{"title":"quality","methods":["a","b"],"cases":["one"],
        "columns":[{"name":"PSNR","digits":2,"more_is_better":true}],"values":[[[1.0]]]}]"#;
    for content in ["{}", "no json", torn] {
        std::fs::write(&path, content).unwrap();
        let said = expect_code(&["compare", text(finished_run()), "--beside", text(&path)], 1);
        assert!(said.contains("beside.json"), "{said}");
    }
    std::fs::remove_dir_all(dir).unwrap();
}
