//! Bad input: a clear message that names the file, the right exit code, nothing left behind that
//! looks whole.

use super::support::{expect_code, folder, sat_recon_in, shared, text};
use image::RgbImage;
use std::path::Path;

fn noise_image(seed: u32, w: u32, h: u32) -> RgbImage {
    let mut state = seed.wrapping_mul(2_654_435_761).max(1);
    RgbImage::from_fn(w, h, |_, _| {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        image::Rgb([state as u8, (state >> 8) as u8, (state >> 16) as u8])
    })
}

fn photos(name: &str, images: &[RgbImage]) -> std::path::PathBuf {
    let dir = folder(name).join("photos");
    std::fs::create_dir_all(&dir).unwrap();
    for (i, image) in images.iter().enumerate() {
        image.save(dir.join(format!("photo_{i:02}.png"))).unwrap();
    }
    dir
}

fn run(input: &Path, code: i32) -> String {
    let out = input.with_file_name("out");
    expect_code(&[text(input), "-o", text(&out)], code)
}

#[test]
fn a_missing_input_is_named() {
    assert!(expect_code(&["no/such/video.mp4"], 1).contains("no/such/video.mp4"));
}

#[test]
fn empty_and_non_video_files_are_refused_by_name() {
    let dir = folder("nonvideo");
    for (name, content) in
        [("empty.mp4", &b""[..]), ("text.mp4", b"this is no video\n"), ("zeros.mov", &[0; 4096])]
    {
        let path = dir.join(name);
        std::fs::write(&path, content).unwrap();
        assert!(run(&path, 1).contains(name), "{name}");
    }
    assert!(!dir.join("out/images").exists(), "no frames may be left of a file that is no video");
}

#[test]
fn an_empty_folder_and_a_folder_without_photos_are_refused() {
    let dir = folder("nophotos").join("photos");
    std::fs::create_dir_all(&dir).unwrap();
    assert!(run(&dir, 1).contains("photos"));
    std::fs::write(dir.join("readme.txt"), "no photo").unwrap();
    assert!(run(&dir, 1).contains("photos"));
}

#[test]
fn one_photo_is_too_few_and_the_message_says_how_many_are_needed() {
    let said = run(&photos("one", &[noise_image(1, 320, 240)]), 1);
    assert!(said.contains('1') && said.contains('2'), "{said}");
}

#[test]
fn identical_photos_black_photos_and_unrelated_photos_give_no_model() {
    let same = vec![noise_image(3, 320, 240); 4];
    let black = vec![RgbImage::new(320, 240); 4];
    let unrelated: Vec<_> = (10..14).map(|i| noise_image(i, 320, 240)).collect();
    for (name, images) in [("same", same), ("black", black), ("unrelated", unrelated)] {
        let said = run(&photos(name, &images), 2);
        assert!(said.contains("no model") || said.contains("duplicate"), "{name}: {said}");
        assert!(said.contains("red: Not reliable"), "{name}: the end says the verdict: {said}");
        assert!(!said.contains("splat.ply"), "{name}: nothing is named that is not there: {said}");
    }
}

#[test]
fn photos_of_mixed_sizes_are_taken() {
    let mixed = [noise_image(5, 320, 240), noise_image(6, 200, 300), noise_image(7, 64, 64)];
    run(&photos("mixed", &mixed), 2);
}

/// A COLMAP text model of two images with the given names.
fn posed(name: &str, names: [&str; 2]) -> std::path::PathBuf {
    let dir = folder(name).join("dataset");
    let model = dir.join("sparse/0");
    std::fs::create_dir_all(&model).unwrap();
    std::fs::create_dir_all(dir.join("images")).unwrap();
    noise_image(8, 64, 48).save(dir.join("images/a.png")).unwrap();
    std::fs::write(model.join("cameras.txt"), "1 PINHOLE 64 48 60 60 32 24\n").unwrap();
    let lines: Vec<String> =
        names.iter().enumerate().map(|(i, n)| format!("{} 1 0 0 0 0 0 {i} 1 {n}\n\n", i + 1)).collect();
    std::fs::write(model.join("images.txt"), lines.concat()).unwrap();
    std::fs::write(model.join("points3D.txt"), "").unwrap();
    dir
}

#[test]
fn a_model_whose_images_are_missing_names_the_first() {
    assert!(run(&posed("lost", ["a.png", "b.png"]), 1).contains("b.png"));
}

#[test]
fn a_model_whose_images_lie_outside_its_folder_is_refused() {
    assert!(run(&posed("outside", ["a.png", "../b.png"]), 1).contains("../b.png"));
}

#[test]
fn every_hostile_media_file_ends_in_a_message_and_never_in_a_crash() {
    let Some(dir) = shared("bad_media") else { return };
    let out = folder("bad_media");
    let mut seen = 0;
    for entry in std::fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|e| e != "mp4") {
            continue;
        }
        let target = out.join(path.file_stem().unwrap());
        let output = super::support::sat_recon(&["frames", text(&path), "-o", text(&target)]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        let code = output.status.code();
        assert!(code == Some(0) || code == Some(1), "{}: {code:?} {said}", path.display());
        assert!(!said.contains("panicked"), "{}: {said}", path.display());
        if code == Some(1) {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            assert!(said.contains(&name), "{name} is not named: {said}");
        }
        seen += 1;
    }
    assert!(seen > 10);
    std::fs::remove_dir_all(out).unwrap();
}

#[test]
fn files_of_others_in_the_output_folder_are_left_alone() {
    let input = photos("foreign", &[noise_image(1, 320, 240), noise_image(2, 320, 240)]);
    let out = input.with_file_name("out");
    std::fs::create_dir_all(out.join("images")).unwrap();
    std::fs::write(out.join("images/precious.jpg"), "mine").unwrap();
    assert!(run(&input, 1).contains("images"));
    assert_eq!(std::fs::read(out.join("images/precious.jpg")).unwrap(), b"mine");
}

#[test]
fn inputs_of_one_name_have_output_folders_of_their_own() {
    let dir = folder("one-name");
    for sub in ["a", "b", "c/a"] {
        std::fs::create_dir_all(dir.join(sub).join("shots")).unwrap();
        for k in 0..2 {
            noise_image(k, 64, 48).save(dir.join(sub).join(format!("shots/{k}.png"))).unwrap();
        }
    }
    let frames = |input: &str| sat_recon_in(&dir, &["frames", input].map(str::to_owned));
    assert!(frames("a/shots").status.success() && frames("b/shots").status.success());
    assert!(dir.join("shots_recon/images/0.png").is_file());
    assert!(dir.join("b_shots_recon/images/0.png").is_file());
    // The second time each finds its own.
    assert!(frames("b/shots").status.success() && !dir.join("b_b_shots_recon").exists());
    assert!(frames("c/a/shots").status.success() && dir.join("a_shots_recon/images/0.png").is_file());
    std::fs::create_dir_all(dir.join("d/c/a")).unwrap();
    std::fs::rename(dir.join("c/a/shots"), dir.join("d/c/a/shots")).unwrap();
    let refused = frames("d/c/a/shots");
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success() && said.contains("name another folder with -o"), "{said}");
}
