//! Whole reconstructions from synthesised keypoints: right answers, the same bytes for any number
//! of threads, and at the extremes either a right answer or a clean "no model".

use glam::{DVec2, DVec3};
use scene::decision::{Choice, MapperKind, Measurement, Quantity, Subject};
use scene::sim3::{PoseErrors, compare_poses};
use scene::synthetic::{
    CameraPath, SceneShape, SyntheticOptions, SyntheticScene, default_camera, synthetic_scene,
};
use scene::{Camera, CameraModel, Features, Frame, FrameSet, Keypoint, Progress};
use sfm::{MapperChoice, SfmConfig, SfmResult, reconstruct_features};

fn frames_of(names: impl Iterator<Item = String>, width: u32, height: u32) -> FrameSet {
    let frame = |name| Frame { name, width, height, ..Frame::default() };
    FrameSet { frames: names.map(frame).collect(), ..FrameSet::default() }
}

fn solve(scene: &SyntheticScene, config: &SfmConfig) -> SfmResult {
    let camera = scene.truth.cameras.values().next().unwrap();
    let names = scene.truth.images.values().map(|i| i.name.clone());
    let frames = frames_of(names, camera.width, camera.height);
    reconstruct_features(&frames, scene.features.clone(), config, &Progress::silent()).unwrap()
}

fn with_mapper(mapper: MapperChoice) -> SfmConfig {
    let mut config = SfmConfig::default();
    config.mapper.mapper = mapper;
    config
}

fn errors(scene: &SyntheticScene, config: &SfmConfig) -> PoseErrors {
    let result = solve(scene, config);
    compare_poses(result.reconstruction.as_ref().expect(&result.reason), &scene.truth)
}

/// A noisy ring with wrong observations and clutter.
fn ring(cameras: usize) -> SyntheticScene {
    let options = SyntheticOptions {
        num_cameras: cameras,
        num_points: 600,
        noise_px: 0.4,
        outliers: 0.15,
        clutter: 60,
        camera: default_camera(CameraModel::SimplePinhole, 640, 480),
        ..SyntheticOptions::default()
    };
    synthetic_scene(&options, 11)
}

#[test]
fn both_mappers_find_a_noisy_ring_with_wrong_matches() {
    let scene = ring(16);
    for mapper in [MapperChoice::Incremental, MapperChoice::Global] {
        let e = errors(&scene, &with_mapper(mapper));
        assert_eq!(e.registered, 16, "{mapper:?}");
        assert!(e.centre_pct.unwrap().max < 0.5 && e.rotation_deg.unwrap().max < 0.5, "{mapper:?} {e:?}");
    }
}

#[test]
fn the_global_mapper_says_so_and_needs_no_order() {
    let result = solve(&ring(9), &with_mapper(MapperChoice::Global));
    let decision = result.decisions.iter().find(|d| d.subject == Subject::Mapper).expect("a decision");
    assert_eq!(decision.choice, Choice::Mapper(MapperKind::Global));
    let images = Measurement::count(Quantity::RegisteredImages, 9);
    assert!(decision.alternatives[0].scores.contains(&images), "{decision:?}");
}

#[test]
fn the_same_seed_gives_the_same_bytes_for_one_thread_and_two() {
    let scene = ring(10);
    for mapper in [MapperChoice::Incremental, MapperChoice::Global] {
        let written = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let model = pool.install(|| solve(&scene, &with_mapper(mapper))).reconstruction.unwrap();
            let name = format!("sat-recon-bytes-{}-{mapper:?}-{threads}", std::process::id());
            let folder = std::env::temp_dir().join(name);
            scene::io::write_model_bin(&model, &folder).unwrap();
            let files = ["cameras.bin", "images.bin", "points3D.bin"];
            let bytes = files.map(|f| std::fs::read(folder.join(f)).unwrap());
            std::fs::remove_dir_all(folder).unwrap();
            bytes
        };
        let one = written(1);
        assert!(one.iter().all(|b| b.len() > 50));
        assert!(one == written(2), "{mapper:?}: two threads give another model");
        assert!(one == written(1), "{mapper:?}: a second run gives another model");
    }
}

/// A right answer, or none: whatever is registered is near the truth.
fn right_or_none(what: &str, scene: &SyntheticScene, config: &SfmConfig, centre_pct: f64) -> usize {
    let result = solve(scene, config);
    let Some(model) = &result.reconstruction else {
        assert!(!result.reason.is_empty(), "{what}: no model, and no reason");
        return 0;
    };
    model.validate().unwrap_or_else(|e| panic!("{what}: {e}"));
    let finite = model.images.values().all(|i| i.pose.is_finite())
        && model.points.values().all(|p| p.position.is_finite())
        && model.cameras.values().all(|c| c.params.iter().all(|p| p.is_finite()));
    assert!(finite, "{what}: a number is not finite");
    let e = compare_poses(model, &scene.truth);
    if let (Some(c), true) = (e.centre_pct, e.registered >= 4) {
        assert!(c.max < centre_pct, "{what}: {e:?}");
    }
    e.registered
}

fn options(width: u32, height: u32, focal: f64) -> SyntheticOptions {
    SyntheticOptions {
        camera: Camera::centred(1, CameraModel::SimplePinhole, width, height, focal),
        noise_px: 0.2,
        ..SyntheticOptions::default()
    }
}

#[test]
fn focal_lengths_from_a_fifth_to_fifty_image_widths_are_solved() {
    // A distance at which the object fills the image; nothing is said about the focal length but at
    // the ends, where perspective says nothing of it (50) and no ordinary lens is that wide (0.2).
    for (widths, given) in [(0.2, true), (0.6, false), (1.2, false), (3.0, false), (10.0, true), (50.0, true)]
    {
        let focal = 640.0 * widths;
        let mut o = options(640, 480, focal);
        o.distance = (4.4 * widths).max(1.6);
        let scene = synthetic_scene(&o, 3);
        let config =
            SfmConfig { intrinsics: given.then(|| vec![focal, 320.0, 240.0]), ..SfmConfig::default() };
        let found = right_or_none(&format!("{widths} image widths"), &scene, &config, 2.0);
        assert_eq!(found, 12, "{widths} image widths");
    }
}

#[test]
fn images_of_32_and_of_12000_pixels_are_solved() {
    for (width, noise) in [(32, 0.01), (12_000, 3.0)] {
        let mut o = options(width, width * 3 / 4, f64::from(width));
        o.noise_px = noise;
        let found =
            right_or_none(&format!("{width} px"), &synthetic_scene(&o, 4), &SfmConfig::default(), 2.0);
        assert!(found >= 10, "{width} px: {found} of 12");
    }
}

#[test]
fn wrong_observations_up_to_seventy_percent_leave_a_right_model_or_none() {
    for percent in [0, 30, 50, 70, 90] {
        let o = SyntheticOptions {
            outliers: f64::from(percent) / 100.0,
            num_points: 800,
            ..options(640, 480, 600.0)
        };
        let scene = synthetic_scene(&o, 5);
        let found = right_or_none(&format!("{percent} % outliers"), &scene, &SfmConfig::default(), 2.0);
        assert!(found == 12 || percent > 50, "{percent} % outliers: {found} of 12");
    }
}

#[test]
fn planes_and_near_planes_leave_a_right_model_or_none() {
    for (shape, squeeze) in [(SceneShape::Plane, 1.0), (SceneShape::Box, 1e-3)] {
        let o = SyntheticOptions { shape, path: CameraPath::Random, ..options(640, 480, 600.0) };
        let mut scene = synthetic_scene(&o, 6);
        if squeeze < 1.0 {
            flatten(&mut scene, |x| DVec3::new(x.x, x.y, x.z * squeeze));
        }
        let given = SfmConfig { intrinsics: Some(vec![600.0, 320.0, 240.0]), ..SfmConfig::default() };
        right_or_none(&format!("{shape:?}, calibrated"), &scene, &given, 5.0);
    }
}

#[test]
fn near_collinear_points_leave_a_right_model_or_none() {
    for squeeze in [1e-2, 1e-4, 0.0] {
        let mut scene = synthetic_scene(&options(640, 480, 600.0), 7);
        flatten(&mut scene, |x| DVec3::new(x.x * squeeze, x.y * squeeze, x.z));
        let given = SfmConfig { intrinsics: Some(vec![600.0, 320.0, 240.0]), ..SfmConfig::default() };
        // A line determines no pose; what is said must be finite, and none of it is held against
        // the truth.
        right_or_none(&format!("squeezed by {squeeze}"), &scene, &given, f64::INFINITY);
    }
}

/// Moves the points that the keypoints show, and shows them again (exactly).
fn flatten(scene: &mut SyntheticScene, change: impl Fn(DVec3) -> DVec3) {
    let camera = scene.truth.cameras.values().next().unwrap().clone();
    for (i, image) in scene.truth.images.values().enumerate() {
        for (k, claim) in scene.claims[i].iter().enumerate() {
            let Some(point) = claim.and_then(|id| scene.truth.points.get(&id)) else { continue };
            if let Some(pixel) = camera.project(image.pose.transform(change(point.position))) {
                let keypoint = &mut scene.features[i].keypoints[k];
                (keypoint.x, keypoint.y) = (pixel.x as f32, pixel.y as f32);
            }
        }
    }
}

#[test]
fn baselines_of_a_ten_thousandth_of_the_depth_and_points_at_infinity_are_no_model() {
    for (what, distance) in [("baseline 1e-4 of the depth", 1e-4), ("no baseline", 0.0)] {
        let mut scene = synthetic_scene(&options(640, 480, 600.0), 8);
        let poses: Vec<_> = scene.truth.images.values().map(|i| i.pose).collect();
        let camera = scene.truth.cameras.values().next().unwrap().clone();
        // All stand about where the first one does and look where it looks.
        for (i, image) in scene.truth.images.values_mut().enumerate() {
            let centre =
                poses[0].centre() + DVec3::new(i as f64, (i * i % 5) as f64, 0.0) * (distance * 4.0 / 12.0);
            image.pose = scene::Pose::from_centre(poses[0].rotation, centre);
        }
        let first: Vec<(Features, Vec<Option<u64>>)> =
            vec![(scene.features[0].clone(), scene.claims[0].clone()); poses.len()];
        for (i, (mut features, claims)) in first.into_iter().enumerate() {
            let pose = scene.truth.images[&(i as u32 + 1)].pose;
            for (keypoint, claim) in features.keypoints.iter_mut().zip(&claims) {
                let Some(point) = claim.and_then(|id| scene.truth.points.get(&id)) else { continue };
                if let Some(pixel) = camera.project(pose.transform(point.position)) {
                    (keypoint.x, keypoint.y) = (pixel.x as f32, pixel.y as f32);
                }
            }
            (scene.features[i], scene.claims[i]) = (features, claims);
        }
        let result = solve(&scene, &SfmConfig::default());
        assert!(result.reconstruction.is_none() && !result.reason.is_empty(), "{what}");
    }
}

#[test]
fn images_given_twice_do_no_harm() {
    let mut scene = ring(12);
    for i in [3, 7] {
        let id = scene.truth.images.len() as u32 + 1;
        let mut image = scene.truth.images[&(i as u32 + 1)].clone();
        (image.id, image.name) = (id, format!("again_{i}.png"));
        scene.truth.images.insert(id, image);
        scene.features.push(scene.features[i].clone());
        scene.claims.push(scene.claims[i].clone());
        scene.outliers.push(scene.outliers[i].clone());
    }
    assert_eq!(right_or_none("two images twice", &scene, &SfmConfig::default(), 1.0), 14);
}

#[test]
fn keypoints_that_are_nowhere_and_images_without_any_do_no_harm() {
    let mut scene = ring(10);
    let size = scene.features[0].keypoints.len();
    for (i, place) in
        [(0, DVec2::NAN), (1, DVec2::INFINITY), (2, DVec2::splat(1e30)), (3, DVec2::splat(-5.0))]
    {
        for keypoint in &mut scene.features[i].keypoints[size - 40..] {
            *keypoint = Keypoint { x: place.x as f32, y: place.y as f32, ..*keypoint };
        }
    }
    scene.features[9] = Features::default();
    scene.claims[9].clear();
    assert_eq!(right_or_none("bad keypoints", &scene, &SfmConfig::default(), 1.0), 9);
    let frames = frames_of((0..3).map(|i| format!("{i}.png")), 640, 480);
    let nothing = reconstruct_features(
        &frames,
        vec![Features::default(); 3],
        &SfmConfig::default(),
        &Progress::silent(),
    );
    assert!(nothing.unwrap().reconstruction.is_none());
    let too_few = reconstruct_features(
        &frames,
        vec![Features::default(); 2],
        &SfmConfig::default(),
        &Progress::silent(),
    );
    assert!(too_few.is_err());
}

/// Poses of a ring whose images are of two groups, the second's focal length by `factor` another.
fn two_groups(factor: f64) -> SfmResult {
    let mut scene = ring(16);
    let camera = default_camera(CameraModel::SimplePinhole, 640, 480);
    for features in scene.features.iter_mut().skip(1).step_by(2) {
        let centre = camera.principal_point();
        for k in &mut features.keypoints {
            let p = centre + factor * (k.position() - centre);
            (k.x, k.y) = (p.x as f32, p.y as f32);
        }
    }
    let names = scene.truth.images.values().map(|i| i.name.clone());
    let mut frames = frames_of(names, 640, 480);
    for (i, frame) in frames.frames.iter_mut().enumerate() {
        frame.camera_group = i as u32 % 2;
    }
    reconstruct_features(&frames, scene.features, &SfmConfig::default(), &Progress::silent()).unwrap()
}

#[test]
fn groups_of_images_share_a_camera_unless_the_evidence_tells_them_apart() {
    let cameras = |result: &SfmResult| {
        let decision = result
            .decisions
            .iter()
            .find(|d| d.subject == Subject::SharedCameras)
            .expect("a decision")
            .clone();
        let model = result.reconstruction.as_ref().expect(&result.reason);
        let focals: Vec<f64> = model.cameras.values().map(Camera::mean_focal).collect();
        assert_eq!(model.images.len(), 16);
        (decision, focals)
    };
    let (decision, focals) = cameras(&two_groups(1.0));
    assert_eq!(focals.len(), 1, "{decision:?}");
    assert_eq!(decision.choice, Choice::share(1, 2));
    let (decision, focals) = cameras(&two_groups(1.15));
    assert_eq!(decision.choice, Choice::share(2, 2), "{decision:?}");
    assert!((focals[1] / focals[0] - 1.15).abs() < 0.01, "{focals:?}");
}

#[test]
fn intrinsics_known_within_deviations_are_corrected_and_exact_ones_are_kept() {
    let scene = ring(16);
    let truth = scene.truth.cameras.values().next().unwrap().params.clone();
    let focal = |sigma: Option<f64>| {
        let mut given = truth.clone();
        given[0] *= 1.01;
        let intrinsics_sigma = sigma.map(|s| vec![s * given[0], 0.0, 0.0]);
        let config = SfmConfig { intrinsics: Some(given), intrinsics_sigma, ..SfmConfig::default() };
        let result = solve(&scene, &config);
        let model = result.reconstruction.expect("a model");
        assert_eq!(model.images.len(), 16);
        let camera = model.cameras.values().next().unwrap();
        assert_eq!(camera.params[1..], truth[1..], "what has no deviation is exact");
        camera.params[0] / truth[0] - 1.0
    };
    assert!((focal(None) - 0.01).abs() < 1e-12);
    assert!((focal(Some(1e-5)) - 0.01).abs() < 1e-3);
    assert!(focal(Some(0.05)).abs() < 0.004, "{}", focal(Some(0.05)));
}

/// The probability that a model is right, and whether it is called doubtful.
fn plausibility(result: &SfmResult) -> (f64, bool) {
    let found = result.decisions.iter().find(|d| d.subject == Subject::Plausibility).expect("a decision");
    let Choice::Value(probability) = found.choice else { panic!("{found:?}") };
    (probability.value, found.is_doubt())
}

#[test]
fn a_ring_is_believed_and_one_with_half_of_its_images_mirrored_is_not() {
    let right = ring(16);
    let (probability, doubtful) = plausibility(&solve(&right, &SfmConfig::default()));
    assert!(probability > 0.9 && !doubtful, "{probability}");
    let mut mirrored = right;
    for features in mirrored.features.iter_mut().step_by(2) {
        features.keypoints.iter_mut().for_each(|k| k.x = 640.0 - k.x);
    }
    let result = solve(&mirrored, &SfmConfig::default());
    let Some(model) = &result.reconstruction else { return };
    let (probability, doubtful) = plausibility(&result);
    let images = model.images.len();
    assert!(doubtful || images <= 9, "{images} images, probability {probability}");
}
