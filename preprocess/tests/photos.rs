//! Folders of photos: orientation, bit depth, alpha, masks, names, what cannot be read.

mod common;

use common::{Scratch, shared};
use image::{GrayImage, Luma, Rgb, RgbImage, Rgba, RgbaImage};
use preprocess::{FrameConfig, PreprocessError, photo_frames};
use scene::{FrameSet, Progress};
use std::path::Path;

fn run(input: &Path, out: &Path, config: &FrameConfig) -> Result<FrameSet, PreprocessError> {
    photo_frames(input, out, config, &Progress::silent())
}

fn photo(shade: u8) -> RgbImage {
    RgbImage::from_fn(32, 24, |x, y| Rgb([shade, (x * 8) as u8, (y * 10) as u8]))
}

/// The brightest blob of a mask: its centre.
fn centroid(mask: &GrayImage) -> (f64, f64) {
    let sum: f64 = mask.pixels().map(|p| f64::from(p[0])).sum();
    let along = |f: fn(u32, u32) -> u32| {
        mask.enumerate_pixels().map(|(x, y, p)| f64::from(f(x, y)) * f64::from(p[0])).sum::<f64>() / sum
    };
    (along(|x, _| x), along(|_, y| y))
}

#[test]
fn exif_orientations_come_out_as_the_upright_picture() {
    let Some(folder) = shared("exif_orientation") else { return };
    let out = Scratch::new("exif");
    let set = run(&folder, &out.0, &FrameConfig::default()).unwrap();
    assert_eq!(set.len(), 8, "{:?}", set.notes);
    let picture = |name: &str| {
        let frame = set.frames.iter().find(|f| f.name.starts_with(name)).unwrap();
        image::open(&frame.path).unwrap().to_rgb8()
    };
    for shape in ["Landscape", "Portrait"] {
        let reference = picture(&format!("{shape}_1"));
        for n in 2..=4 {
            let turned = picture(&format!("{shape}_{n}"));
            assert_eq!(turned.dimensions(), reference.dimensions());
            // The number painted in the middle differs; the corners must not.
            let (w, h) = reference.dimensions();
            let corner = |i: &RgbImage, x: u32, y: u32| {
                let mut sum = [0.0; 3];
                for (dx, dy) in (0..40).flat_map(|a| (0..40).map(move |b| (a, b))) {
                    let p = i.get_pixel((x * (w - 41) + dx).min(w - 1), (y * (h - 41) + dy).min(h - 1));
                    (0..3).for_each(|c| sum[c] += f64::from(p[c]) / 1600.0);
                }
                sum
            };
            for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let (a, b) = (corner(&reference, x, y), corner(&turned, x, y));
                assert!((0..3).all(|c| (a[c] - b[c]).abs() < 6.0), "{shape}_{n} corner {x} {y}: {a:?} {b:?}");
            }
        }
    }
    assert!(set.frames.iter().any(|f| f.name == "Landscape_1.jpg"), "an upright JPEG keeps its bytes");
}

#[test]
fn untouched_photos_are_copied_byte_for_byte_and_sorted_as_people_do() {
    let dir = Scratch::new("copy");
    let input = dir.0.join("in");
    std::fs::create_dir_all(&input).unwrap();
    for n in [10, 2, 1] {
        photo(n).save(input.join(format!("img {n}.png"))).unwrap();
    }
    let set = run(&input, &dir.0.join("out"), &FrameConfig::default()).unwrap();
    let names: Vec<_> = set.frames.iter().map(|f| f.name.as_str()).collect();
    assert_eq!(names, ["img_1.png", "img_2.png", "img_10.png"]);
    assert_eq!(std::fs::read(input.join("img 2.png")).unwrap(), std::fs::read(&set.frames[1].path).unwrap());
    assert!(!set.is_video && set.frames.iter().all(|f| f.camera_group == 0 && f.mask.is_none()));
}

#[test]
fn masks_are_found_in_all_four_namings() {
    let dir = Scratch::new("masks");
    let input = dir.0.join("in");
    std::fs::create_dir_all(input.join("masks")).unwrap();
    for name in ["a.png", "b.jpg", "c.png"] {
        photo(9).save(input.join(name)).unwrap();
    }
    let white_left = GrayImage::from_fn(64, 48, |x, _| Luma([if x < 32 { 255 } else { 0 }]));
    for name in ["a.png", "b.jpg.png", "c.mask.png"] {
        white_left.save(input.join("masks").join(name)).unwrap();
    }
    RgbaImage::from_fn(32, 24, |x, _| Rgba([1, 2, 3, if x < 16 { 255 } else { 0 }]))
        .save(input.join("d.png"))
        .unwrap();
    let set = run(&input, &dir.0.join("out"), &FrameConfig::default()).unwrap();
    assert!(set.notes.contains(&"3 of 4 masks matched".to_owned()), "{:?}", set.notes);
    assert!(set.notes.iter().any(|n| n.starts_with("1 of 4 masks taken from the alpha")), "{:?}", set.notes);
    for frame in &set.frames {
        let mask = image::open(frame.mask.as_ref().unwrap()).unwrap();
        assert_eq!((mask.width(), mask.height(), mask.color()), (32, 24, image::ColorType::L8));
        assert_eq!(
            (mask.to_luma8().get_pixel(3, 3)[0], mask.to_luma8().get_pixel(30, 3)[0]),
            (255, 0),
            "{}",
            frame.name
        );
    }
    let d = image::open(&set.frames[3].path).unwrap();
    assert_eq!(
        (d.color(), d.to_rgb8().get_pixel(20, 3).0),
        (image::ColorType::Rgb8, [1, 2, 3]),
        "colour under alpha stays"
    );
    let inverted = FrameConfig { invert_masks: true, ..FrameConfig::default() };
    let set = run(&input, &dir.0.join("out"), &inverted).unwrap();
    assert_eq!(image::open(set.frames[0].mask.as_ref().unwrap()).unwrap().to_luma8().get_pixel(3, 3)[0], 0);
}

#[test]
fn a_mask_folder_that_fits_nothing_is_an_error() {
    let dir = Scratch::new("nomasks");
    let input = dir.0.join("in");
    std::fs::create_dir_all(input.join("masks")).unwrap();
    photo(1).save(input.join("a.png")).unwrap();
    GrayImage::new(32, 24).save(input.join("masks/x.png")).unwrap();
    let error = run(&input, &dir.0.join("out"), &FrameConfig::default()).unwrap_err();
    assert!(error.to_string().contains("0 of 1"), "{error}");
    assert!(dir.list("out").is_empty());
    let off = FrameConfig { masks: "off".to_owned(), ..FrameConfig::default() };
    assert_eq!(run(&input, &dir.0.join("out"), &off).unwrap().len(), 1);
}

#[test]
fn a_mask_is_turned_and_shrunk_with_its_image() {
    let Some(folder) = shared("exif_orientation") else { return };
    let dir = Scratch::new("turn");
    let input = dir.0.join("in");
    std::fs::create_dir_all(input.join("masks")).unwrap();
    std::fs::copy(folder.join("Landscape_3.jpg"), input.join("a.jpg")).unwrap();
    let stored = image::image_dimensions(input.join("a.jpg")).unwrap();
    let mask = GrayImage::from_fn(stored.0, stored.1, |x, y| {
        Luma([if x < stored.0 / 8 && y < stored.1 / 8 { 255 } else { 0 }])
    });
    mask.save(input.join("masks/a.png")).unwrap();
    let config = FrameConfig { max_size: 300, ..FrameConfig::default() };
    let set = run(&input, &dir.0.join("out"), &config).unwrap();
    let frame = &set.frames[0];
    assert_eq!(frame.width.max(frame.height), 300);
    let mask = image::open(frame.mask.as_ref().unwrap()).unwrap().to_luma8();
    assert_eq!(mask.dimensions(), (frame.width, frame.height));
    // Orientation 3 is a half turn: the corner goes to the opposite one.
    let (x, y) = centroid(&mask);
    assert!(x > 0.8 * f64::from(frame.width) && y > 0.8 * f64::from(frame.height), "{x} {y}");
}

#[test]
fn deep_transparent_mixed_and_unreadable_photos_are_handled() {
    let dir = Scratch::new("mixed");
    let input = dir.0.join("in");
    std::fs::create_dir_all(&input).unwrap();
    image::ImageBuffer::<Rgb<u16>, Vec<u16>>::from_pixel(40, 30, Rgb([65535, 32768, 0]))
        .save(input.join("deep.png"))
        .unwrap();
    photo(7).save(input.join("plain.png")).unwrap();
    photo(7).save(input.join("scan.tif")).unwrap();
    std::fs::write(input.join("broken.jpg"), b"\xff\xd8\xff\xe0 not a picture").unwrap();
    std::fs::write(input.join("phone.heic"), b"x").unwrap();
    let bytes = std::fs::read(input.join("plain.png")).unwrap();
    std::fs::write(input.join("truncated.png"), &bytes[..bytes.len() / 2]).unwrap();
    let set = run(&input, &dir.0.join("out"), &FrameConfig::default()).unwrap();
    let names: Vec<_> = set.frames.iter().map(|f| (f.name.as_str(), f.camera_group)).collect();
    assert_eq!(names, [("deep.png", 0), ("plain.png", 1), ("scan.png", 1)], "{:?}", set.notes);
    assert_eq!(image::open(&set.frames[0].path).unwrap().to_rgb8().get_pixel(3, 3).0, [255, 128, 0]);
    for word in ["broken.jpg", "truncated.png", ".heic", "2 cameras"] {
        assert!(set.notes.iter().any(|n| n.contains(word)), "{word}: {:?}", set.notes);
    }
}

#[test]
fn links_out_of_the_folder_and_folders_without_images_are_refused() {
    let dir = Scratch::new("links");
    let input = dir.0.join("in");
    std::fs::create_dir_all(&input).unwrap();
    photo(7).save(dir.0.join("secret.png")).unwrap();
    std::os::unix::fs::symlink(dir.0.join("secret.png"), input.join("a.png")).unwrap();
    let out = dir.0.join("out");
    assert!(matches!(run(&input, &out, &FrameConfig::default()), Err(PreprocessError::NoImages { .. })));
    std::fs::write(input.join("b.png"), b"no").unwrap();
    let error = run(&input, &out, &FrameConfig::default()).unwrap_err();
    assert!(error.to_string().contains("b.png"), "{error}");
    assert!(matches!(
        run(&dir.0.join("none"), &out, &FrameConfig::default()),
        Err(PreprocessError::NotFound { .. })
    ));
    assert!(matches!(
        run(&dir.0.join("secret.png"), &out, &FrameConfig::default()),
        Err(PreprocessError::WrongKind { .. })
    ));
    assert!(dir.list("out").is_empty());
}

#[test]
fn real_captures_come_through() {
    let dir = Scratch::new("real");
    let count = |name: &str| {
        let folder = shared(name)?;
        let set = run(&folder, &dir.0.join(name), &FrameConfig { max_size: 320, ..FrameConfig::default() })
            .unwrap();
        println!("{name}: {} {:?}", set.len(), set.notes);
        Some(set)
    };
    if let Some(set) = count("temple_ring") {
        assert_eq!(set.len(), 47);
    }
    if let Some(set) = count("fountain_p11") {
        assert_eq!(set.len(), 11);
    }
    if let Some(set) = count("bad_media") {
        assert!(set.len() >= 10);
    }
}

/// The pictures of scene/tests/fixtures/heif, in a folder of their own.
fn heif(dir: &Scratch, names: &[&str]) -> std::path::PathBuf {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scene/tests/fixtures/heif");
    let input = dir.0.join("in");
    std::fs::create_dir_all(&input).unwrap();
    for name in names {
        std::fs::copy(fixtures.join(name), input.join(name)).unwrap();
    }
    input
}

#[test]
fn heic_and_avif_photos_look_as_libheif_shows_them() {
    let dir = Scratch::new("heif");
    let input = heif(&dir, &["alpha.avif", "grid.heic", "turned.heic"]);
    // A name that lies: phones' files are renamed.
    std::fs::rename(input.join("turned.heic"), input.join("turned.jpg")).unwrap();
    let set = run(&input, &dir.0.join("out"), &FrameConfig::default()).unwrap();
    let sizes: Vec<_> = set.frames.iter().map(|f| (f.name.as_str(), f.width, f.height)).collect();
    assert_eq!(
        sizes,
        [("alpha.png", 80, 60), ("grid.png", 150, 100), ("turned.png", 64, 96)],
        "{:?}",
        set.notes
    );
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scene/tests/fixtures/heif");
    for frame in &set.frames {
        let [ours, theirs] =
            [frame.path.clone(), fixtures.join(&frame.name)].map(|p| image::open(p).unwrap().to_rgb8());
        let off: u64 = ours.iter().zip(theirs.iter()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
        let mean = off as f64 / ours.len() as f64;
        assert!(mean < 2.0, "{}: {mean} levels from libheif's", frame.name);
    }
    let focal = set.frames[2].focal_prior_px.unwrap();
    assert!((focal - 26.0 * 96_f64.hypot(64.0) / 36_f64.hypot(24.0)).abs() < 1e-9, "{focal}");
    let mask = image::open(set.frames[0].mask.as_ref().unwrap()).unwrap().to_luma8();
    assert_eq!((mask.get_pixel(40, 25)[0], mask.get_pixel(5, 5)[0]), (255, 0));
    assert_eq!(dir.list("out"), ["images", "masks"], "nothing temporary stays");
}

#[test]
fn damaged_heic_photos_are_left_out_and_say_why() {
    let dir = Scratch::new("badheif");
    let input = heif(&dir, &["grid.heic", "turned.heic"]);
    photo(7).save(input.join("whole.png")).unwrap();
    let whole = std::fs::read(input.join("grid.heic")).unwrap();
    std::fs::write(input.join("grid.heic"), &whole[..whole.len() - 900]).unwrap();
    let mut bytes = std::fs::read(input.join("turned.heic")).unwrap();
    let at = bytes.windows(4).position(|w| w == b"mdat").unwrap();
    bytes[at + 12..].fill(0);
    std::fs::write(input.join("turned.heic"), bytes).unwrap();
    let set = run(&input, &dir.0.join("out"), &FrameConfig::default()).unwrap();
    assert_eq!(set.len(), 1, "{:?}", set.notes);
    assert!(set.notes.iter().any(|n| n.contains("grid.heic") && n.contains("cut off")), "{:?}", set.notes);
    let cannot = set.notes.iter().find(|n| n.contains("turned.heic")).unwrap();
    assert!(cannot.contains("ffmpeg cannot decode its HEVC") && cannot.contains("convert it"), "{cannot}");
}

#[test]
fn webp_photos_are_read_with_their_alpha() {
    let dir = Scratch::new("webp");
    let input = dir.0.join("in");
    std::fs::create_dir_all(&input).unwrap();
    let cut = RgbaImage::from_fn(32, 24, |x, y| {
        Rgba([(x * 8) as u8, (y * 10) as u8, 90, if x < 16 { 255 } else { 0 }])
    });
    let file = std::fs::File::create(input.join("a.webp")).unwrap();
    let encoder = image::codecs::webp::WebPEncoder::new_lossless(file);
    encoder.encode(&cut, 32, 24, image::ExtendedColorType::Rgba8).unwrap();
    let set = run(&input, &dir.0.join("out"), &FrameConfig::default()).unwrap();
    let picture = image::open(&set.frames[0].path).unwrap().to_rgb8();
    assert_eq!((set.frames[0].name.as_str(), picture.get_pixel(9, 5).0), ("a.png", [72, 50, 90]));
    let mask = image::open(set.frames[0].mask.as_ref().unwrap()).unwrap().to_luma8();
    assert_eq!((mask.get_pixel(3, 3)[0], mask.get_pixel(30, 3)[0]), (255, 0));
}
