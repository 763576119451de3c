//! Real and hostile image files.

mod common;

use common::shared;
use scene::io::{image_info, load_image, load_rgb, resize_area};

#[test]
fn photos_of_every_orientation_come_out_upright_and_alike() {
    let Some(dir) = shared("exif_orientation") else { return };
    for kind in ["Landscape", "Portrait"] {
        let mut small = Vec::new();
        for n in 1..=4 {
            let path = dir.join(format!("{kind}_{n}.jpg"));
            let image = load_rgb(&path).unwrap();
            let info = image_info(&path).unwrap();
            assert_eq!(image.dimensions(), (info.width, info.height));
            assert_eq!(image.width() > image.height(), kind == "Landscape", "{kind}_{n}");
            small.push(resize_area(&image, 12, 12));
        }
        // The painted numbers differ, the scene does not.
        for other in &small[1..] {
            let difference: u32 =
                small[0].iter().zip(other.iter()).map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
            assert!(difference / small[0].len() as u32 <= 12, "{kind}: mean difference {}", difference / 432);
        }
    }
}

#[test]
fn phone_photos_give_a_focal_length_prior_where_exif_has_one() {
    let Some(dir) = shared("fox/images") else { return };
    for entry in std::fs::read_dir(dir).unwrap().take(3) {
        let info = image_info(&entry.unwrap().path()).unwrap();
        assert_eq!((info.width, info.height), (1080, 1920));
        if let Some(focal) = info.focal_prior_px {
            assert!((focal - 1375.0).abs() < 300.0, "{focal}");
        }
    }
}

#[test]
fn an_alpha_channel_is_found_in_the_lego_scene() {
    let Some(dir) = shared("lego400/images") else { return };
    let loaded = load_image(&dir.join("r_0.png")).unwrap();
    let alpha = loaded.alpha.unwrap();
    assert_eq!((alpha.dimensions(), alpha.get_pixel(0, 0).0[0]), ((400, 400), 0));
    assert!(alpha.contains(&255));
}

#[test]
fn hostile_png_files_end_in_a_picture_or_a_clear_error() {
    let Some(dir) = shared("bad_media") else { return };
    for entry in std::fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        match load_rgb(&path) {
            Ok(image) => assert!(image.width() > 0 && path.extension().unwrap() == "png"),
            Err(error) => {
                assert!(error.to_string().contains(path.file_name().unwrap().to_str().unwrap()), "{error}")
            }
        }
    }
}
