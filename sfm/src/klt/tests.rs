use super::*;
use scene::FloatImage;

const SIZE: (usize, usize) = (300, 260);

/// [`track`] of images in memory.
fn track_images(images: &[FloatImage]) -> Vec<KltTrack> {
    let config = KltConfig::default();
    let mut tracker = Tracker::new(&config);
    for (i, image) in images.iter().enumerate() {
        tracker.advance(i, KltPicture { pyramid: Pyramid::new(image, LEVELS), mask: None });
    }
    tracker.finish()
}

/// Smooth random texture at a place.
fn value(p: DVec2) -> f32 {
    let waves =
        [(0.31, 0.12, 0.3), (-0.21, 0.27, 1.1), (0.11, -0.35, 2.0), (0.41, 0.38, 0.7), (0.05, 0.22, 4.0)];
    let v: f64 = waves.iter().map(|(a, b, c)| (a * p.x + b * p.y + c).sin()).sum();
    0.5 + 0.08 * v as f32
}

/// Smooth random texture, moved by a sub-pixel shift and lit differently.
fn texture(shift: DVec2, gain: f32, offset: f32) -> FloatImage {
    let (width, height) = (SIZE.0, SIZE.1);
    let mut image = FloatImage::zeros(width, height, 1);
    for y in 0..height {
        for x in 0..width {
            let p = DVec2::new(x as f64 + 0.5, y as f64 + 0.5) - shift;
            image.data[y * width + x] = gain * value(p) + offset;
        }
    }
    image
}

#[test]
fn follows_shifts_to_a_part_of_a_pixel_whatever_the_light() {
    let shift = |i: usize| DVec2::new(2.37 * i as f64, -1.21 * i as f64);
    let images: Vec<FloatImage> =
        (0..5).map(|i| texture(shift(i), 1.0 - 0.15 * i as f32, 0.05 * i as f32)).collect();
    let tracks = track_images(&images);
    let whole: Vec<&KltTrack> = tracks.iter().filter(|t| t.positions.len() == 5).collect();
    assert!(whole.len() > 100, "{} of {}", whole.len(), tracks.len());
    for t in whole {
        for (i, p) in t.positions.iter().enumerate() {
            let off = (*p - t.positions[0] - shift(i)).length();
            assert!(off < 0.08, "{off} at {p} frame {i}");
        }
    }
}

#[test]
fn far_jumps_are_found_through_the_pyramid() {
    let images = [
        texture(DVec2::ZERO, 1.0, 0.0),
        texture(DVec2::new(4.5, 3.0), 1.0, 0.0),
        texture(DVec2::new(12.0, -3.0), 1.0, 0.0),
    ];
    let tracks = track_images(&images);
    let right = |t: &&KltTrack| (t.positions[2] - t.positions[0] - DVec2::new(12.0, -3.0)).length() < 0.05;
    assert!(
        tracks.len() > 50 && tracks.iter().filter(right).count() * 10 >= tracks.len() * 8,
        "{}",
        tracks.len()
    );
}

#[test]
fn flat_and_unrelated_images_give_no_tracks() {
    let flat = FloatImage { data: vec![0.5; SIZE.0 * SIZE.1], ..FloatImage::zeros(SIZE.0, SIZE.1, 1) };
    assert!(track_images(&[flat.clone(), flat.clone(), flat.clone()]).is_empty());
    let tiny = FloatImage::zeros(8, 8, 1);
    assert!(track_images(&[tiny.clone(), tiny.clone(), tiny]).is_empty());
    let images = [texture(DVec2::ZERO, 1.0, 0.0), flat.clone(), texture(DVec2::ZERO, 1.0, 0.0)];
    assert!(track_images(&images).is_empty());
    assert!(track_images(&[]).is_empty());
}

#[test]
fn nothing_is_tracked_in_the_black_of_a_mask() {
    let folder = std::env::temp_dir().join(format!("sat-recon-klt-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let mut frames = FrameSet { is_video: true, ..FrameSet::default() };
    for i in 0..3 {
        let (path, mask) = (folder.join(format!("{i}.png")), folder.join(format!("m{i}.png")));
        texture(DVec2::new(f64::from(i), 0.0), 1.0, 0.0).to_rgb8().save(&path).unwrap();
        GrayImage::from_fn(SIZE.0 as u32, SIZE.1 as u32, |x, _| image::Luma([if x < 100 { 255 } else { 0 }]))
            .save(&mask)
            .unwrap();
        frames.frames.push(Frame {
            path,
            mask: Some(mask),
            width: SIZE.0 as u32,
            height: SIZE.1 as u32,
            ..Frame::default()
        });
    }
    let tracks = track(&frames, &KltConfig::default(), &Progress::silent()).unwrap();
    assert!(tracks.len() > 40, "{}", tracks.len());
    assert!(tracks.iter().flat_map(|t| &t.positions).all(|p| p.x < 100.5));
    frames.frames[1].path = folder.join("missing.png");
    assert!(matches!(
        track(&frames, &KltConfig::default(), &Progress::silent()),
        Err(SfmError::UnreadableImage { .. })
    ));
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn windows_that_shear_and_stretch_are_found_at_their_true_place() {
    let (a, t) =
        (glam::DMat2::from_cols(DVec2::new(0.85, 0.08), DVec2::new(-0.05, 1.1)), DVec2::new(21.3, -12.6));
    let first = texture(DVec2::ZERO, 1.0, 0.0);
    let mut second = first.clone();
    let back = a.inverse();
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let q = back * (DVec2::new(x as f64 + 0.5, y as f64 + 0.5) - t);
            second.data[y * SIZE.0 + x] = 0.8 * value(q) + 0.1;
        }
    }
    let levels = [&first, &second].map(pyramid::PyramidLevel::smooth);
    let mut found = 0;
    for k in 0..100 {
        let p = DVec2::new(60.0 + f64::from(k % 10) * 15.0, 60.0 + f64::from(k / 10) * 12.0);
        let reference = Reference::new(&levels[0], p).unwrap();
        let start = Warp { shape: DMat2::IDENTITY, place: a * p + t + DVec2::new(0.6, -0.5) };
        let Some((warp, correlation)) = reference.find(&levels[1], start) else { continue };
        found += 1;
        assert!((warp.place - a * p - t).length() < 0.08, "{p}: {}", warp.place - a * p - t);
        assert!(correlation > 0.99, "{correlation}");
    }
    assert!(found > 90, "{found}");
}
