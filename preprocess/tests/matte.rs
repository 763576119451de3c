//! Mattes of a simulated screen against their truth, and captures that have no screen.

mod common;
#[path = "common/screen.rs"]
#[allow(dead_code)]
mod screen;

use common::{Scratch, shared};
use image::{GrayImage, Rgb, RgbImage};
use preprocess::matting::Background;
use preprocess::{
    FrameConfig, KeyConfig, PreprocessError, contact_sheet, matte_frames, photo_frames, video_frames,
};
use scene::decision::{MatteKind, Remark};
use scene::{FrameSet, Progress};
use screen::{CLOTHS, Cloth, LIGHTS, Light, Score, Shot, cut_outs, encode, film, score};
use std::path::Path;

fn matte(set: &FrameSet, out: &Path, config: &KeyConfig) -> Result<FrameSet, PreprocessError> {
    matte_frames(set, out, config, &Progress::silent())
}

fn filmed(cut_outs: &[image::RgbaImage], light: Light, cloth: Cloth, folder: &Path) -> (Vec<Shot>, FrameSet) {
    let shots: Vec<Shot> =
        cut_outs.iter().enumerate().map(|(i, c)| film(c, light, cloth, i as u64)).collect();
    encode(&shots, &folder.join("video.mp4"));
    let all = FrameConfig { every: Some(1), duplicate_levels: 0.0, ..FrameConfig::default() };
    let set =
        video_frames(&folder.join("video.mp4"), &folder.join("frames"), &all, &Progress::silent()).unwrap();
    (shots, set)
}

/// Whether the frames were left as they are.
fn is_refused(out: &FrameSet) -> bool {
    matches!(&out.decisions[..], [d] if d.choice == MatteKind::Nothing.into())
}

#[test]
fn mattes_of_a_noisy_screen_with_spill_meet_their_truth() {
    let mut errors = Vec::new();
    for (name, step) in [("lego400", 25), ("temple_ring", 16)] {
        let Some(folder) = shared(name) else { return };
        let cut_outs = cut_outs(&folder, step);
        for (light, cloth) in LIGHTS.into_iter().flat_map(|l| CLOTHS.map(|c| (l, c))) {
            let dir = Scratch::new(&format!("matte-{name}-{}-{}", cloth.name, light.gain));
            let (shots, set) = filmed(&cut_outs, light, cloth, &dir.0);
            let keyed = matte(&set, &dir.0.join("out"), &KeyConfig::with_key("auto")).unwrap();
            let scores: Vec<Score> = keyed
                .frames
                .iter()
                .zip(&shots)
                .map(|(f, s)| {
                    score(
                        &image::open(f.mask.as_ref().unwrap()).unwrap().to_luma8(),
                        &image::open(&f.path).unwrap().to_rgb8(),
                        s,
                    )
                })
                .collect();
            let s = Score::mean(&scores);
            let least = if light.gain < 1.0 { 0.98 } else { 0.99 };
            println!("{name} {} {}: {s:?} {:?}", cloth.name, light.name, keyed.notes);
            assert!(
                s.iou >= least && s.alpha_error <= 0.01 && s.boundary_f >= 0.95 && s.spill <= 2.0,
                "{name} {} {}: {s:?}",
                cloth.name,
                light.name
            );
            errors.push(s.alpha_error);
        }
    }
    // The formula alone does not reach this: it takes the network of the outline.
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    assert!(mean <= 0.0014, "mean error of alpha {mean}");
}

/// Coded as videos are, with a pole: the sample of the test bed, of which every sixth frame has a
/// true matte.
#[test]
fn mattes_of_the_sample_video_meet_their_truth() {
    let (dir, every) = (Scratch::new("matte-sample"), 6);
    let case = Path::new(env!("CARGO_MANIFEST_DIR")).join("../data/testbed/case3");
    let all = FrameConfig { every: Some(1), duplicate_levels: 0.0, ..FrameConfig::default() };
    let mut set =
        video_frames(&case.join("video.mp4"), &dir.0.join("frames"), &all, &Progress::silent()).unwrap();
    set.frames = set.frames.into_iter().step_by(every).collect();
    let keyed = matte(&set, &dir.0.join("out"), &KeyConfig::with_key("auto")).unwrap();
    let scores: Vec<Score> = keyed
        .frames
        .iter()
        .enumerate()
        .map(|(k, frame)| {
            let truth = case.join(format!("mattes/frame_{:06}.png", k * every));
            let filmed = image::open(&set.frames[k].path).unwrap().to_rgb8();
            let (width, height) = filmed.dimensions();
            let shot = Shot {
                filmed,
                alpha: image::open(truth).unwrap().to_luma8(),
                clean: RgbImage::new(width, height),
                channel: 1,
            };
            let mask = image::open(frame.mask.as_ref().unwrap()).unwrap().to_luma8();
            score(&mask, &image::open(&frame.path).unwrap().to_rgb8(), &shot)
        })
        .collect();
    let s = Score::mean(&scores);
    assert_eq!(scores.len(), 36);
    // A network that has learnt from frames coded one by one has 0.9888 and 0.0013 here.
    assert!(s.iou >= 0.989 && s.alpha_error <= 0.0012 && s.boundary_f >= 0.95, "{s:?}");
}

#[test]
fn captures_without_a_screen_come_back_untouched_with_the_evidence() {
    let small = FrameConfig { max_size: 320, ..FrameConfig::default() };
    for name in ["fox", "temple_ring", "fountain_p11", "oxford_dino"] {
        let Some(folder) = shared(name) else { return };
        let dir = Scratch::new(&format!("off-{name}"));
        let set = photo_frames(&folder, &dir.0.join("in"), &small, &Progress::silent()).unwrap();
        let out = matte(&set, &dir.0.join("out"), &KeyConfig::with_key("auto")).unwrap();
        println!("{name}: {:?}", out.decisions);
        assert_eq!(out.frames, set.frames, "{name}");
        assert!(is_refused(&out) && !dir.0.join("out").exists());
    }
    for name in ["can_orbit", "checkerboard_rotated"] {
        let Some(video) = shared(&format!("phone_video/{name}.mp4")) else { return };
        let dir = Scratch::new(&format!("off-{name}"));
        let config = FrameConfig { frames: Some(12), end: Some(6.0), ..small.clone() };
        let set = video_frames(&video, &dir.0.join("in"), &config, &Progress::silent()).unwrap();
        let out = matte(&set, &dir.0.join("out"), &KeyConfig::with_key("auto")).unwrap();
        println!("{name}: {:?}", out.decisions);
        assert_eq!(out.frames, set.frames, "{name}: {:?}", out.notes);
    }
}

#[test]
fn real_screens_are_found_whatever_their_hue() {
    for (name, share) in [("plane", 2.0..25.0), ("shark", 1.0..25.0), ("lion_olive_key", 10.0..50.0)] {
        let Some(video) = shared(&format!("greenscreen/{name}.mp4")) else { return };
        let dir = Scratch::new(&format!("screen-{name}"));
        let config = FrameConfig { frames: Some(12), max_size: 640, ..FrameConfig::default() };
        let set = video_frames(&video, &dir.0.join("in"), &config, &Progress::silent()).unwrap();
        let out = matte(
            &set,
            &dir.0.join("out"),
            &KeyConfig { background: Background::Black, ..KeyConfig::with_key("auto") },
        )
        .unwrap();
        println!("{name}: {:?}", out.decisions);
        let kept: f64 = out
            .frames
            .iter()
            .map(|f| mean(&image::open(f.mask.as_ref().unwrap()).unwrap().to_luma8()))
            .sum::<f64>()
            / out.len() as f64;
        assert!(share.contains(&(100.0 * kept)), "{name}: {kept}");
        contact_sheet(&out, &dir.0.join("sheet.png")).unwrap();
        assert!(image::open(dir.0.join("sheet.png")).unwrap().width() > 200);
    }
}

fn mean(mask: &GrayImage) -> f64 {
    mask.iter().map(|v| f64::from(*v) / 255.0).sum::<f64>() / mask.len() as f64
}

/// Photos of a green wall with a grey box, a rod two pixels thick and garbage at the right.
fn painted(dir: &Path, count: u32) -> FrameSet {
    std::fs::create_dir_all(dir).unwrap();
    for i in 0..count {
        let image = RgbImage::from_fn(320, 240, |x, y| {
            let noise = ((x * 73 + y * 151 + i * 37) % 5) as u8;
            let shade = 150 + (x / 8) as u8 + noise;
            if x >= 290 {
                Rgb([90, 70 + noise, 110])
            } else if (120..180).contains(&x) && (80..160).contains(&y) {
                Rgb([120 + noise, 118, 125])
            } else if (60 + i..62 + i).contains(&x) && (60..200).contains(&y)
                || (60..120).contains(&x) && (118..120).contains(&y)
            {
                Rgb([40, 38, 42])
            } else {
                Rgb([30, shade, 50])
            }
        });
        image.save(dir.join(format!("{i:02}.png"))).unwrap();
    }
    photo_frames(dir, &dir.with_extension("out"), &FrameConfig::default(), &Progress::silent()).unwrap()
}

#[test]
fn thin_rods_stay_and_garbage_beside_the_screen_goes() {
    let dir = Scratch::new("rods");
    let set = painted(&dir.0.join("in"), 3);
    let out = matte(&set, &dir.0.join("out"), &KeyConfig::with_key("auto")).unwrap();
    let mask = image::open(out.frames[1].mask.as_ref().unwrap()).unwrap().to_luma8();
    let rod = (62..198).map(|y| mask.get_pixel(61, y)[0].max(mask.get_pixel(62, y)[0])).min().unwrap();
    assert!(rod > 200, "{rod}");
    assert!(mask.get_pixel(150, 120)[0] == 255 && mask.get_pixel(20, 20)[0] == 0);
    let garbage = (5..235).map(|y| mask.get_pixel(310, y)[0]).max().unwrap();
    assert_eq!(garbage, 0);
}

#[test]
fn keys_and_backgrounds_do_what_they_say() {
    let dir = Scratch::new("modes");
    let set = painted(&dir.0.join("in"), 2);
    let run = |key: &str, background| {
        let config = KeyConfig { key: key.to_owned(), background, ..KeyConfig::default() };
        matte(&set, &dir.0.join("out"), &config)
    };
    let out = run("green", Background::Black).unwrap();
    assert_eq!(image::open(&out.frames[0].path).unwrap().to_rgb8().get_pixel(20, 20).0, [0, 0, 0]);
    let out = run("auto", Background::Transparent).unwrap();
    let image = image::open(&out.frames[0].path).unwrap();
    assert_eq!((image.color(), image.to_rgba8().get_pixel(20, 20)[3]), (image::ColorType::Rgba8, 0));
    let out = run("auto", Background::Keep).unwrap();
    assert_eq!(
        image::open(&out.frames[0].path).unwrap().to_rgb8().get_pixel(20, 20),
        image::open(&set.frames[0].path).unwrap().to_rgb8().get_pixel(20, 20)
    );
    assert_eq!(run("off", Background::Keep).unwrap().frames, set.frames);
    // A lit room is not keyed by light: the object would be cut to pieces.
    let out = run("black", Background::Black).unwrap();
    assert_eq!(out.frames, set.frames);
    assert_eq!(out.decisions[0].remarks, [Remark::NotKeyableByLight]);
    assert!(is_refused(&run("#00ffff", Background::Keep).unwrap()));
    assert!(run("grene", Background::Keep).is_err());
    assert!(contact_sheet(&FrameSet::default(), &dir.0.join("x.png")).is_err());
}

#[test]
fn a_screen_before_which_nothing_stands_is_left_alone_and_one_frame_is_enough_for_a_matte() {
    let dir = Scratch::new("nothing");
    let folder = dir.0.join("in");
    std::fs::create_dir_all(&folder).unwrap();
    for i in 0..3 {
        let noise = |x: u32, y: u32| ((x * 31 + y * 17 + i) % 4) as u8;
        let image = RgbImage::from_fn(160, 120, |x, y| Rgb([25, 150 + noise(x, y), 45]));
        image.save(folder.join(format!("{i}.png"))).unwrap();
    }
    let load = |from: &str| {
        let to = dir.0.join(format!("{from}.out"));
        photo_frames(&dir.0.join(from), &to, &FrameConfig::default(), &Progress::silent()).unwrap()
    };
    let set = load("in");
    let out = matte(&set, &dir.0.join("out"), &KeyConfig::default()).unwrap();
    assert_eq!(out.frames, set.frames, "{:?}", out.notes);
    assert!(is_refused(&out) && out.decisions[0].remarks == [Remark::EmptyFrames], "{:?}", out.decisions);
    let one = painted(&dir.0.join("one"), 1);
    let out = matte(&one, &dir.0.join("out1"), &KeyConfig::default()).unwrap();
    let mask = image::open(out.frames[0].mask.as_ref().unwrap()).unwrap().to_luma8();
    assert!(mask.get_pixel(150, 120)[0] == 255 && mask.get_pixel(20, 20)[0] == 0);
}

#[test]
fn black_white_and_tiny_frames_do_no_harm() {
    let dir = Scratch::new("extremes");
    for (i, (size, shade)) in
        [((1, 1), 0), ((3, 50), 255), ((40, 30), 0), ((64, 64), 128)].into_iter().enumerate()
    {
        let folder = dir.0.join(format!("{i}"));
        std::fs::create_dir_all(&folder).unwrap();
        RgbImage::from_pixel(size.0, size.1, Rgb([shade, 255 - shade / 2, 10]))
            .save(folder.join("a.png"))
            .unwrap();
        let set =
            photo_frames(&folder, &dir.0.join("in"), &FrameConfig::default(), &Progress::silent()).unwrap();
        for key in ["auto", "green", "black", "#ff0000"] {
            let out =
                matte(&set, &dir.0.join("out"), &KeyConfig { key: key.to_owned(), ..KeyConfig::default() })
                    .unwrap();
            assert_eq!(out.len(), 1, "{key}");
        }
    }
    assert!(
        matte(&FrameSet::default(), &dir.0.join("out"), &KeyConfig::with_key("auto")).unwrap().is_empty()
    );
}

/// A video of a standing camera before a green wall: a box that swings, and some frames in which
/// nothing can be told.
fn interrupted(dir: &Path) -> FrameSet {
    std::fs::create_dir_all(dir).unwrap();
    for i in 0..24_u32 {
        let image = RgbImage::from_fn(160, 120, |x, y| {
            let noise = ((x * 73 + y * 151 + i * 37) % 5) as u8;
            let screen = [30, 150 + (x / 8) as u8 + noise, 50];
            let boxed = (40 + i..90 + i).contains(&x) && (40..80).contains(&y);
            Rgb(match i {
                3 => [0; 3],
                7 => [255; 3],
                11 => [255, (x % 2) as u8, (y % 2) as u8],
                15 => screen,
                19 if boxed => screen.map(|v| v.saturating_add(3)),
                _ if boxed => [120 + noise, 60, 125],
                _ if x >= 150 => [90, 70 + noise, 110],
                _ => screen,
            })
        });
        image.save(dir.join(format!("{i:02}.png"))).unwrap();
    }
    let out = dir.with_extension("out");
    let config = FrameConfig { duplicate_levels: 0.0, ..FrameConfig::default() };
    FrameSet { is_video: true, ..photo_frames(dir, &out, &config, &Progress::silent()).unwrap() }
}

#[test]
fn blackouts_flashes_and_an_object_of_the_colour_of_the_screen_spoil_no_other_frame() {
    let dir = Scratch::new("interrupted");
    let set = interrupted(&dir.0.join("in"));
    for key in ["auto", "green", "black"] {
        let out = matte(&set, &dir.0.join("out"), &KeyConfig::with_key(key)).unwrap();
        assert_eq!(out.len(), 24);
        if key == "black" {
            continue;
        }
        for (i, frame) in out.frames.iter().enumerate() {
            let mask = image::open(frame.mask.as_ref().unwrap()).unwrap().to_luma8();
            let kept = mean(&mask);
            match i {
                3 | 7 | 11 | 15 => assert!(kept < 0.01, "{key} {i}: {kept}"),
                19 => assert!(kept < 0.12, "{key} {i}: {kept}"),
                _ => {
                    let i = i as u32;
                    let wanted = |x: u32, y: u32| (40 + i..90 + i).contains(&x) && (40..80).contains(&y);
                    let wrong = mask.enumerate_pixels().filter(|(x, y, p)| (p[0] >= 128) != wanted(*x, *y));
                    assert!(wrong.count() < 120, "{key} {i}: kept {kept}");
                }
            }
        }
        assert!(out.notes.iter().any(|n| n.contains("mattes are empty")), "{:?}", out.notes);
    }
}
