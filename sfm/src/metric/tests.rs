use super::*;
use scene::io::exif::GpsPosition;
use scene::sim3::Sim3;
use scene::synthetic::{SyntheticOptions, synthetic_scene};
use scene::{Camera, CameraModel, Frame, Pose};

/// A solved model whose units are 0.04 m, of points in a box of 3 × 1 × 0.5 m, and its frames.
fn box_of_points() -> (Reconstruction, FrameSet) {
    let options = SyntheticOptions { num_points: 2000, num_cameras: 12, ..SyntheticOptions::default() };
    let mut model = synthetic_scene(&options, 5).truth;
    let count = model.points.len();
    for (i, point) in model.points.values_mut().enumerate() {
        let share = |step: f64| (i as f64 * step).fract() - 0.5;
        point.position = DVec3::new(i as f64 / count as f64 - 0.5, share(0.7548), share(0.5698))
            * DVec3::new(3.0, 1.0, 0.5)
            / 0.04;
    }
    let names = model.images.values().map(|i| i.name.clone());
    let frames = names.map(|name| Frame { name, ..Frame::default() }).collect();
    (model, FrameSet { frames, ..FrameSet::default() })
}

fn scale_of(model: &Reconstruction, frames: &FrameSet, config: &ScaleConfig) -> MetricScale {
    metric_scale(model, frames, config, &Progress::silent()).unwrap().unwrap()
}

#[test]
fn the_longest_extent_of_an_object_is_its_known_length() {
    let (mut model, frames) = box_of_points();
    let config = ScaleConfig { known_length: Some(3.0), ..ScaleConfig::default() };
    // Its longest way is the diagonal; nothing lies just in the corners.
    let found = scale_of(&model, &frames, &config);
    assert_eq!(found.evidence, ScaleEvidence::LongestExtent);
    assert!((found.metres_per_unit / 0.04 - 1.0).abs() < 0.06, "{found:?}");
    let before = found.metres_per_unit;
    for (far, point) in model.points.values_mut().take(2).enumerate() {
        point.position = DVec3::new(0.0, 1e4 * (far as f64 - 0.5), 0.0);
    }
    let found = scale_of(&model, &frames, &config);
    assert!((found.metres_per_unit / before - 1.0).abs() < 0.02, "two outliers: {found:?}");
}

/// Pixels of a point in two images, as a flag has them.
fn marks(model: &Reconstruction, ends: [DVec3; 2]) -> Vec<LengthEnds> {
    let seen = |image: &PosedImage| {
        let camera = &model.cameras[&image.camera];
        let pixels = ends.map(|x| camera.project(image.pose.transform(x)).unwrap());
        let [a, b] = pixels.map(|p| (p * 4.0).round() / 4.0);
        format!("{},{},{},{},{}", image.name, a.x, a.y, b.x, b.y).parse().unwrap()
    };
    model.images.values().step_by(4).map(seen).collect()
}

#[test]
fn ends_marked_in_three_images_give_the_scale_and_wrong_marks_an_error() {
    let (model, frames) = box_of_points();
    let scene = synthetic_scene(&SyntheticOptions { num_points: 50, ..SyntheticOptions::default() }, 1);
    let (a, b) = (scene.truth.points[&1].position, scene.truth.points[&9].position);
    let length_ends = marks(&model, [a, b]);
    let mut config = ScaleConfig { known_length: Some(0.25), length_ends, tag_size: None };
    let found = scale_of(&model, &frames, &config);
    let expected = 0.25 / a.distance(b);
    assert!((found.metres_per_unit / expected - 1.0).abs() < 0.02, "{found:?} {expected}");
    config.length_ends[0].pixels = [[10_000.0, 0.0], [0.0, 10_000.0]];
    config.length_ends.truncate(2);
    let error = metric_scale(&model, &frames, &config, &Progress::silent()).unwrap_err();
    assert!(error.to_string().contains("meet in no point"), "{error}");
    config.length_ends[0].image = "none.jpg".to_owned();
    let error = metric_scale(&model, &frames, &config, &Progress::silent()).unwrap_err();
    assert!(error.to_string().contains("none.jpg has no pose"), "{error}");
    for text in ["a.jpg", "a.jpg,1,2,3", "a.jpg,1,2,3,x", ",1,2,3,4", "a.jpg,1,2,3,nan"] {
        assert!(text.parse::<LengthEnds>().is_err(), "{text}");
    }
    assert_eq!("a,b.jpg,1,2,3,4".parse::<LengthEnds>().unwrap().image, "a,b.jpg");
}

fn codes() -> Vec<u32> {
    let hex = include_str!("tags/aruco_4x4_50.txt").lines();
    hex.map(|l| u32::from_str_radix(l, 16).unwrap()).collect()
}

/// Grey value of a wall with two tags in margins of white, their sides two units; `wide`: their
/// width over their height.
fn wall(codes: &[u32], x: f64, y: f64, wide: f64) -> f64 {
    for (id, left) in [(7, -2.5 * wide), (23, 0.5 * wide)] {
        let cell = DVec2::new((x - left) / wide, y + 1.0) * 3.0;
        if cell.min_element() < -1.0 || cell.max_element() > 7.0 {
            continue;
        }
        let (column, row) = (cell.x.floor() as i32, cell.y.floor() as i32);
        let outside = column.min(row) < 0 || column.max(row) > 5;
        let border = column.min(row) == 0 || column.max(row) == 5;
        let white = outside || !border && codes[id] >> (15 - (4 * (row - 1) + column - 1)) & 1 == 1;
        return if white { 220.0 } else { 30.0 };
    }
    120.0
}

/// Pictures of the wall from five places, and their poses.
fn filmed_wall(folder: &std::path::Path, wide: f64) -> (Reconstruction, FrameSet) {
    std::fs::create_dir_all(folder).unwrap();
    let codes = codes();
    let camera = Camera {
        params: vec![500.0, 240.0, 135.0],
        ..Camera::centred(1, CameraModel::SimplePinhole, 480, 270, 1.0)
    };
    let (mut model, mut frames) = (Reconstruction::default(), FrameSet::default());
    for id in 1..=5_u32 {
        let eye = DVec3::new(2.0 * (f64::from(id) - 3.0), f64::from(id % 2), -9.0);
        let pose = Pose::look_at(eye, DVec3::ZERO, DVec3::NEG_Y);
        let seen = |pixel: DVec2| {
            let ray = pose.rotation.conjugate() * camera.ray(pixel);
            let hit = eye - ray * (eye.z / ray.z);
            wall(&codes, hit.x, hit.y, wide)
        };
        let picture = image::GrayImage::from_fn(480, 270, |x, y| {
            let parts = (0..16).map(|k| {
                let within = DVec2::new(f64::from(k % 4) + 0.5, f64::from(k / 4) + 0.5) / 4.0;
                seen(DVec2::new(f64::from(x), f64::from(y)) + within)
            });
            image::Luma([(parts.sum::<f64>() / 16.0).round() as u8])
        });
        let name = format!("{id}.png");
        let path = folder.join(&name);
        picture.save(&path).unwrap();
        frames.frames.push(Frame { name: name.clone(), path, width: 480, height: 270, ..Frame::default() });
        model.images.insert(id, PosedImage { id, camera: 1, name, pose, observations: vec![] });
    }
    model.cameras.insert(1, camera);
    (model, frames)
}

#[test]
fn tags_of_known_size_give_the_scale_to_a_thousandth() {
    let folder = std::env::temp_dir().join(format!("sat-recon-tags-{}", std::process::id()));
    let (model, frames) = filmed_wall(&folder, 1.0);
    let config = ScaleConfig { tag_size: Some(0.1), ..ScaleConfig::default() };
    let found = scale_of(&model, &frames, &config);
    assert_eq!(found.evidence, ScaleEvidence::Tags(2));
    assert!((found.metres_per_unit / 0.05 - 1.0).abs() < 1e-3, "{found:?}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn tags_that_are_no_squares_in_the_model_are_not_believed() {
    let folder = std::env::temp_dir().join(format!("sat-recon-wide-{}", std::process::id()));
    let (model, frames) = filmed_wall(&folder, 1.4);
    let config = ScaleConfig { tag_size: Some(0.1), ..ScaleConfig::default() };
    let error = metric_scale(&model, &frames, &config, &Progress::silent()).unwrap_err().to_string();
    assert!(error.contains("square") && error.contains("number 23"), "{error}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn places_of_a_flight_give_the_scale_and_those_about_a_table_do_not() {
    let (model, mut frames) = box_of_points();
    let sim = Sim3 { scale: 7.0, rotation: glam::DQuat::from_rotation_x(0.4), translation: DVec3::ONE };
    let radius = model.images.values().map(|i| i.pose.centre().length()).fold(0.0, f64::max);
    let mut give = |metres: f64| {
        for (k, frame) in frames.frames.iter_mut().enumerate() {
            let image = model.images.values().find(|i| i.name == frame.name).unwrap();
            let at = sim.transform(image.pose.centre()) * (metres / (sim.scale * radius));
            // Two metres of error, as of a phone under open sky.
            let error = 2.0 * (1.7 * k as f64).sin();
            let north = ((at.y + error) / 6_371_000.8).to_degrees();
            let east = ((at.x - error) / 6_371_000.8 / 0.6_f64).to_degrees();
            let latitude_deg = 0.6_f64.acos().to_degrees() + north;
            let altitude_m = Some(100.0 + at.z + error);
            frame.gps = Some(GpsPosition { latitude_deg, longitude_deg: 9.0 + east, altitude_m });
        }
        metric_scale(&model, &frames, &ScaleConfig::default(), &Progress::silent()).unwrap()
    };
    let found = give(80.0).unwrap();
    assert_eq!(found.evidence, ScaleEvidence::Gps(12));
    let expected = 80.0 / radius;
    let off = found.metres_per_unit / expected - 1.0;
    assert!(off.abs() < 4.0 * found.relative_deviation.unwrap().max(0.005), "{off} {found:?}");
    assert_eq!(give(2.0), None, "errors of two metres about a table");
}
