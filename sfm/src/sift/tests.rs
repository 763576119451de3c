use super::*;
use crate::matching::{MatchConfig, match_features};
use rand::Rng;
use std::path::PathBuf;

/// Gaussian spots on grey: (x, y, σ, height), pixels; sampled at pixel centres.
fn spots(width: usize, height: usize, spots: &[(f64, f64, f64, f64)]) -> FloatImage {
    let mut image = FloatImage::zeros(width, height, 1);
    for (i, v) in image.data.iter_mut().enumerate() {
        let (x, y) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        let sum: f64 = spots
            .iter()
            .map(|&(cx, cy, s, h)| h * (-((x - cx).powi(2) + (y - cy).powi(2)) / (2.0 * s * s)).exp())
            .sum();
        *v = (0.4 + sum) as f32;
    }
    image
}

/// 60 spots within a circle, turned by `angle` and scaled about the centre of a 256×256 image.
fn constellation(angle: f64, scale: f64) -> FloatImage {
    let mut r = scene::rng::rng(3, "constellation", 0);
    let list: Vec<_> = (0..60)
        .map(|_| {
            let (d, a) = (70.0 * r.random::<f64>().sqrt(), r.random_range(0.0..std::f64::consts::TAU));
            let (s, h) = (r.random_range(1.8..4.0), r.random_range(-0.35..0.35));
            let (d, a) = (d * scale, a + angle);
            (128.0 + d * a.cos(), 128.0 + d * a.sin(), s * scale, h)
        })
        .collect();
    spots(256, 256, &list)
}

fn data(path: &str) -> Option<PathBuf> {
    let shared = std::env::var("SAT_RECON_SHARED")
        .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared").to_owned());
    let found = Path::new(&shared).join("data").join(path);
    if found.exists() {
        return Some(found);
    }
    assert!(std::env::var("CI").as_deref() != Ok("true"), "{} is missing", found.display());
    eprintln!("SKIPPED: {} is missing", found.display());
    None
}

fn temple(index: usize) -> Option<FloatImage> {
    let path = data(&format!("temple_ring/images/templeR{index:04}.png"))?;
    Some(FloatImage::luma(&image::open(path).unwrap().to_rgb8()))
}

/// Gain, then Gaussian noise of σ grey levels, then 8 bits.
fn degraded(image: &FloatImage, gain: f32, noise: f32) -> FloatImage {
    let mut r = scene::rng::rng(5, "noise", 0);
    let mut normal = || {
        let (u, v): (f32, f32) = (1.0 - r.random::<f32>(), r.random());
        (-2.0 * u.ln()).sqrt() * (std::f32::consts::TAU * v).cos()
    };
    let mut out = image.clone();
    for v in &mut out.data {
        *v = (*v * gain * 255.0 + noise * normal()).round().clamp(0.0, 255.0) / 255.0;
    }
    out
}

/// Share of the keypoints of `a` that `b` has within `px`.
fn repeated(a: &Features, b: &Features, px: f64) -> f64 {
    let has = |k: &&Keypoint| b.keypoints.iter().any(|o| o.position().distance(k.position()) < px);
    a.keypoints.iter().filter(has).count() as f64 / a.len().max(1) as f64
}

#[test]
fn finds_spots_at_their_subpixel_position_and_scale() {
    for case in 0..40 {
        let mut r = scene::rng::rng(11, "spot", case);
        let (x, y) = (r.random_range(60.0..68.0), r.random_range(60.0..68.0));
        let (s, h) = (r.random_range(1.6..7.0), if case % 2 == 0 { 0.4 } else { -0.3 });
        for doubling in [Doubling::Always, Doubling::Never] {
            let s = if doubling == Doubling::Never { s + 1.5 } else { s };
            let config = SiftConfig { doubling, ..SiftConfig::default() };
            let features = extract(&spots(128, 128, &[(x, y, s, h)]), None, &config);
            let error = |k: &Keypoint| (f64::from(k.x) - x).hypot(f64::from(k.y) - y);
            let best = features.keypoints.iter().min_by(|a, b| error(a).total_cmp(&error(b)));
            let k = best.unwrap_or_else(|| panic!("case {case}: nothing found, σ {s}"));
            assert!(error(k) < 0.03, "case {case} {doubling:?}: {x} {y} σ {s} found at {} {}", k.x, k.y);
            // The difference of σ and 2^⅓ σ responds most where their geometric mean is the spot's
            // size.
            let expected = (s * s * 2.0_f64.powf(-1.0 / 3.0) + 0.25).sqrt();
            let ratio = f64::from(k.scale) / expected;
            assert!((0.88..1.12).contains(&ratio), "case {case} {doubling:?}: σ {s} found as {}", k.scale);
        }
    }
}

#[test]
fn keypoints_turn_and_grow_with_the_image() {
    let config = SiftConfig::default();
    let base = extract(&constellation(0.0, 1.0), None, &config);
    assert!(base.len() > 40, "{}", base.len());
    for (angle, scale) in [(0.6, 1.0), (2.5, 1.0), (-1.1, 1.4), (0.0, 0.75), (3.0, 1.25)] {
        let other = extract(&constellation(angle, scale), None, &config);
        let matches = match_features(&base, &other, &MatchConfig::default());
        let right = |m: &&[u32; 2]| {
            let (a, b) = (base.keypoints[m[0] as usize], other.keypoints[m[1] as usize]);
            let d = (a.position() - 128.0) * scale;
            let expected = glam::DVec2::from_angle(angle).rotate(d) + 128.0;
            let turn = (f64::from(b.angle - a.angle) - angle).rem_euclid(std::f64::consts::TAU);
            let turn = turn.min(std::f64::consts::TAU - turn);
            let growth = f64::from(b.scale / a.scale) / scale;
            b.position().distance(expected) < 1.0 && turn < 0.2 && (0.85..1.18).contains(&growth)
        };
        let correct = matches.iter().filter(right).count();
        assert!(matches.len() > base.len() / 3, "{angle} {scale}: {} of {}", matches.len(), base.len());
        assert!(correct * 100 >= matches.len() * 88, "{angle} {scale}: {correct} of {}", matches.len());
    }
}

#[test]
fn upright_features_have_no_angle() {
    let config = SiftConfig { upright: true, ..SiftConfig::default() };
    let features = extract(&constellation(0.4, 1.0), None, &config);
    assert!(!features.is_empty() && features.keypoints.iter().all(|k| k.angle == 0.0));
}

#[test]
fn descriptors_have_the_length_that_colmap_gives_them() {
    let features = extract(&constellation(0.0, 1.0), None, &SiftConfig::default());
    for i in 0..features.len() {
        let square: f64 = features.descriptor(i).iter().map(|&d| f64::from(d).powi(2)).sum();
        assert!((square.sqrt() - 512.0).abs() < 8.0, "{}", square.sqrt());
    }
}

#[test]
fn a_dark_image_keeps_its_features() {
    let Some(bright) = temple(1) else { return };
    let config = SiftConfig::default();
    let full = extract(&bright, None, &config);
    let dark = extract(&degraded(&bright, 0.1, 0.0), None, &config);
    assert!(dark.len() * 10 > full.len() * 7, "{} of {}", dark.len(), full.len());
    assert!(dark.len() < full.len() * 2, "{} of {}", dark.len(), full.len());
    assert!(repeated(&dark, &full, 1.5) > 0.6, "{}", repeated(&dark, &full, 1.5));
    let clipped = extract(&degraded(&bright, 2.0, 0.0), None, &config);
    assert!(repeated(&full, &clipped, 1.5) > 0.5, "{}", repeated(&full, &clipped, 1.5));
}

#[test]
fn noise_does_not_flood_an_image() {
    let config = SiftConfig::default();
    let mut flat = FloatImage::zeros(320, 240, 1);
    flat.data.fill(0.5);
    let noise = extract(&degraded(&flat, 1.0, 3.0), None, &config);
    assert!(noise.len() < 40, "{} features of pure noise", noise.len());
    let Some(bright) = temple(1) else { return };
    let full = extract(&bright, None, &config);
    let noisy = extract(&degraded(&bright, 0.1, 3.0), None, &config);
    assert!(noisy.len() > 50 && noisy.len() < full.len(), "{} against {}", noisy.len(), full.len());
    assert!(repeated(&noisy, &full, 3.0) > 0.5, "{}", repeated(&noisy, &full, 3.0));
}

#[test]
fn a_real_image_turned_by_a_quarter_matches_itself() {
    let Some(upright) = temple(5) else { return };
    let (w, h) = (upright.width, upright.height);
    let mut turned = FloatImage::zeros(h, w, 1);
    for y in 0..w {
        for x in 0..h {
            turned.data[y * h + x] = upright.data[(h - 1 - x) * w + y]; // clockwise: (x, y) ← (y, h − x)
        }
    }
    let config = SiftConfig::default();
    let (a, b) = (extract(&upright, None, &config), extract(&turned, None, &config));
    let matches = match_features(&a, &b, &MatchConfig::default());
    assert!(matches.len() * 10 > a.len() * 8, "{} of {}", matches.len(), a.len());
    let error = |&[i, j]: &[u32; 2]| {
        let (p, q) = (a.keypoints[i as usize].position(), b.keypoints[j as usize].position());
        q.distance(glam::DVec2::new(h as f64 - p.y, p.x)) / f64::from(a.keypoints[i as usize].scale)
    };
    let mut errors: Vec<f64> = matches.iter().map(error).collect();
    errors.sort_by(f64::total_cmp);
    let quantile = |q: f64| errors[(errors.len() as f64 * q) as usize];
    // Coarse octaves keep every second sample from the first on, so a turn moves their grid: no
    // half pixel is lost.
    assert!(quantile(0.5) < 0.01, "median {} of the scale", quantile(0.5));
    assert!(quantile(0.97) < 0.25, "97 %: {} of the scale", quantile(0.97));
}

#[test]
fn empty_flat_tiny_and_broken_images_have_few_features_or_none() {
    let config = SiftConfig::default();
    for value in [0.0, 1.0, 0.37, f32::NAN, f32::INFINITY] {
        let mut image = FloatImage::zeros(64, 48, 1);
        image.data.fill(value);
        assert!(extract(&image, None, &config).is_empty(), "{value}");
    }
    for (w, h) in [(0, 0), (1, 1), (1, 500), (7, 7), (16, 16), (32, 32)] {
        let mut image = FloatImage::zeros(w, h, 1);
        image.data.iter_mut().enumerate().for_each(|(i, v)| *v = (i * 7919 % 256) as f32 / 255.0);
        let features = extract(&image, None, &config);
        assert!(features.keypoints.iter().all(|k| k.x >= 0.0 && k.x <= w as f32 && k.y <= h as f32));
    }
    let mut image = constellation(0.0, 1.0);
    let whole = extract(&image, None, &config);
    image.data[40 * 256 + 40] = f32::NAN;
    let holed = extract(&image, None, &config);
    assert!(repeated(&whole, &holed, 0.5) > 0.8);
    assert!(holed.keypoints.iter().all(|k| k.position().is_finite() && k.scale > 0.0 && k.angle.is_finite()));
}

#[test]
fn masked_keypoints_go_and_the_mask_makes_no_edges() {
    let image = constellation(0.0, 1.0);
    let left = GrayImage::from_fn(256, 256, |x, _| image::Luma([if x < 128 { 255 } else { 0 }]));
    let config = SiftConfig::default();
    let (all, kept) = (extract(&image, None, &config), extract(&image, Some(&left), &config));
    assert!(!kept.is_empty() && kept.len() < all.len());
    assert!(kept.keypoints.iter().all(|k| k.x < 128.0));
    assert!(repeated(&kept, &all, 1e-3) > 0.9, "the rest is as without a mask");
    let black = GrayImage::new(256, 256);
    assert!(extract(&image, Some(&black), &config).is_empty());
    let mut flat = FloatImage::zeros(256, 256, 1);
    flat.data.fill(0.6);
    assert!(extract(&flat, Some(&left), &config).is_empty());
}

#[test]
fn a_small_white_part_of_a_mask_far_from_the_corner_gives_what_the_whole_image_gives_there() {
    // The spots about (428, 328) of an image that is much larger than what the mask keeps.
    let (small, mut image) = (constellation(0.0, 1.0), FloatImage::zeros(640, 480, 1));
    image.data.fill(small.data[0]);
    for y in 0..256 {
        let from = (y + 200) * 640 + 300;
        image.data[from..from + 256].copy_from_slice(&small.data[y * 256..(y + 1) * 256]);
    }
    let inside = |x: u32, y: u32| (348..508).contains(&x) && (248..408).contains(&y);
    let mask = GrayImage::from_fn(640, 480, |x, y| image::Luma([if inside(x, y) { 255 } else { 0 }]));
    // With two corners white nothing can be left out.
    let mut whole = mask.clone();
    [(0, 0), (639, 479)].into_iter().for_each(|(x, y)| whole.put_pixel(x, y, image::Luma([255])));
    let config = SiftConfig::default();
    let (all, kept) = (extract(&image, Some(&whole), &config), extract(&image, Some(&mask), &config));
    assert!(kept.len() > 50 && kept.len() * 50 > all.len() * 49, "{} of {}", kept.len(), all.len());
    assert!(repeated(&kept, &all, 1e-2) > 0.98, "{}", repeated(&kept, &all, 1e-2));
}

#[test]
fn a_huge_image_is_searched_in_bounded_memory_and_reported_in_its_own_pixels() {
    let list: Vec<_> = (0..12).map(|i| (500.0 + 1000.0 * f64::from(i), 300.0, 40.0, 0.4)).collect();
    // Cheap: the spots touch few pixels, so only those are computed.
    let (w, h) = (12_000, 600);
    let mut image = FloatImage::zeros(w, h, 1);
    image.data.fill(0.4);
    for &(cx, cy, s, height) in &list {
        for y in 0..h {
            for x in (cx - 250.0) as usize..(cx + 250.0) as usize {
                let r2 = (x as f64 + 0.5 - cx).powi(2) + (y as f64 + 0.5 - cy).powi(2);
                image.data[y * w + x] += (height * (-r2 / (2.0 * s * s)).exp()) as f32;
            }
        }
    }
    let features = extract(&image, None, &SiftConfig::default());
    for (cx, cy, s, _) in list {
        let near = |k: &&Keypoint| (f64::from(k.x) - cx).hypot(f64::from(k.y) - cy) < 0.5;
        let k = features.keypoints.iter().find(near).unwrap_or_else(|| panic!("nothing at {cx}"));
        assert!((0.8..1.0).contains(&(f64::from(k.scale) / s)), "{}", k.scale);
    }
}

#[test]
fn a_cap_keeps_features_everywhere() {
    let Some(image) = temple(1) else { return };
    let all = extract(&image, None, &SiftConfig::default());
    let few = extract(&image, None, &SiftConfig { max_features: 200, ..SiftConfig::default() });
    assert_eq!(few.len(), 200);
    let cells = |f: &Features| {
        let cell = |k: &Keypoint| ((k.x / 40.0) as u32, (k.y / 40.0) as u32);
        f.keypoints.iter().map(cell).collect::<std::collections::BTreeSet<_>>().len()
    };
    assert!(cells(&few) * 10 >= cells(&all) * 6, "{} of {} cells", cells(&few), cells(&all));
    // Directions are found for those alone that may stay: nothing else may come of it.
    assert!(few.keypoints.iter().all(|k| all.keypoints.contains(k)));
}

/// Parts of a row, blocks and single samples, borders nearer than the filter reaches: all by the
/// definition.
#[test]
fn a_blur_is_the_weighted_sum_at_every_size() {
    let mut rng = scene::rng::rng(1, "blur", 0);
    for (width, height) in [(1, 1), (9, 40), (63, 3), (64, 5), (65, 2), (500, 4), (577, 3), (1100, 2)] {
        let data: Vec<f32> = (0..width * height).map(|_| rng.random()).collect();
        let plane = LumaPlane { width, height, data };
        for sigma in [0.4, 1.6, 3.1, 20.0_f32, 90.0] {
            let mut out = LumaPlane::default();
            blur::gaussian_blur(&plane, sigma, &mut out);
            let kernel = blur::half_kernel(sigma);
            let radius = kernel.len() as isize - 1;
            let weight = |k: isize| f64::from(kernel[k.unsigned_abs()]);
            let inside = |at: usize, k: isize, n: usize| (at as isize + k).clamp(0, n as isize - 1) as usize;
            let columns: Vec<f64> = (0..width * height)
                .map(|i| {
                    let tap = |k| weight(k) * f64::from(plane.at(i % width, inside(i / width, k, height)));
                    (-radius..=radius).map(tap).sum()
                })
                .collect();
            for (i, &found) in out.data.iter().enumerate() {
                let (x, y) = (i % width, i / width);
                let tap = |k| weight(k) * columns[y * width + inside(x, k, width)];
                let expected: f64 = (-radius..=radius).map(tap).sum();
                assert!(
                    (f64::from(found) - expected).abs() < 2e-6,
                    "{width}×{height}, σ {sigma}, at {x} {y}"
                );
            }
        }
    }
}

#[test]
fn frames_give_the_same_features_with_one_thread_and_two() {
    let Some(folder) = data("temple_ring/images") else { return };
    let frame = |i: usize| {
        let name = format!("templeR{i:04}.png");
        Frame { path: folder.join(&name), name, width: 480, height: 640, ..Frame::default() }
    };
    let frames = FrameSet { frames: (1..4).map(frame).collect(), ..FrameSet::default() };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| extract_all(&frames, &SiftConfig::default(), &Progress::silent())).unwrap()
    };
    assert_eq!(run(1), run(2));
}

#[test]
fn a_missing_or_missized_file_is_named() {
    let one = |path: PathBuf, width| {
        let frame = Frame { path, width, height: 640, ..Frame::default() };
        let frames = FrameSet { frames: vec![frame], ..FrameSet::default() };
        extract_all(&frames, &SiftConfig::default(), &Progress::silent()).unwrap_err().to_string()
    };
    assert!(one("no/such/file.png".into(), 480).contains("no/such/file.png"));
    let Some(path) = data("temple_ring/images/templeR0001.png") else { return };
    assert!(one(path, 10).contains("expected 10×640"));
}
