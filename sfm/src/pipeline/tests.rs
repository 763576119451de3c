use super::*;
use scene::pose::rotation_angle;
use scene::synthetic::{CameraPath, Shape, SyntheticOptions, SyntheticScene, synthetic_scene};
use scene::{Frame, Pose};

fn frames_of(scene: &SyntheticScene) -> FrameSet {
    let camera = scene.truth.cameras.values().next().unwrap();
    let frame = |name: &String| Frame {
        name: name.clone(),
        width: camera.width,
        height: camera.height,
        ..Frame::default()
    };
    FrameSet { frames: scene.truth.images.values().map(|i| frame(&i.name)).collect(), ..FrameSet::default() }
}

/// Verification and mapping of a synthetic scene's claimed matches.
fn mapped(scene: &SyntheticScene, config: &SfmConfig) -> Option<Solved> {
    let setup = Setup::new(&frames_of(scene), config).unwrap();
    let n = scene.features.len();
    let pairs = (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b)));
    let matches = pairs.map(|(a, b)| (a, b, scene.matches(a, b))).collect();
    let (cameras, silent) = (setup.of_frames(), Progress::silent());
    let verified =
        two_view::verify_pairs(&scene.features, &cameras, matches, &config.two_view, config.seed, &silent)
            .unwrap();
    solve(config, &setup, &scene.features, &verified, &silent).unwrap()
}

/// Largest error of a relative rotation between neighbouring images, degrees; needs no alignment.
fn worst_rotation_deg(scene: &SyntheticScene, solved: &Solved) -> f64 {
    let truth: Vec<Pose> = scene.truth.images.values().map(|i| i.pose).collect();
    let step = |i: usize| {
        let (a, b) = (solved.state.poses[i - 1]?, solved.state.poses[i]?);
        let found = b.compose(&a.inverse()).rotation;
        Some(rotation_angle(found, truth[i].compose(&truth[i - 1].inverse()).rotation).to_degrees())
    };
    (1..truth.len()).filter_map(step).fold(0.0, f64::max)
}

#[test]
fn a_ring_with_noise_and_wrong_matches_is_solved_with_nothing_known() {
    let options = SyntheticOptions { noise_px: 0.3, outliers: 0.1, ..SyntheticOptions::default() };
    let scene = synthetic_scene(&options, 1);
    let solved = mapped(&scene, &SfmConfig::default()).unwrap();
    assert_eq!(solved.state.registered(), 12);
    assert!(worst_rotation_deg(&scene, &solved) < 0.3, "{}", worst_rotation_deg(&scene, &solved));
    let focal = solved.state.cameras[0].mean_focal();
    assert!((focal / options.camera.mean_focal() - 1.0).abs() < 0.02, "{focal}");
    let uncertainty = solved.uncertainty.unwrap();
    assert!((0.15..0.6).contains(&uncertainty.sigma_px), "{}", uncertainty.sigma_px);
}

#[test]
fn the_unit_of_the_scene_does_not_matter_and_the_seed_repeats_to_the_bit() {
    let solve = |unit: f64| {
        let options = SyntheticOptions { noise_px: 0.3, num_cameras: 6, unit, ..SyntheticOptions::default() };
        let scene = synthetic_scene(&options, 2);
        let solved = mapped(&scene, &SfmConfig::default()).unwrap();
        assert_eq!(solved.state.registered(), 6, "unit {unit}");
        solved
            .state
            .poses
            .iter()
            .flatten()
            .flat_map(|p| p.translation.to_array())
            .map(f64::to_bits)
            .collect::<Vec<_>>()
    };
    let first = solve(1.0);
    assert_eq!(first, solve(1.0));
    solve(1e-6);
    solve(1e6);
}

#[test]
fn cameras_that_only_turn_have_no_model_or_none_that_claims_a_baseline() {
    let options =
        SyntheticOptions { num_cameras: 6, path: CameraPath::Arc(40.0), ..SyntheticOptions::default() };
    let scene = synthetic_scene(&options, 3);
    // All images are given the keypoints of the first: nothing moves.
    let still = SyntheticScene {
        features: vec![scene.features[0].clone(); 6],
        claims: vec![scene.claims[0].clone(); 6],
        ..scene
    };
    assert!(mapped(&still, &SfmConfig::default()).is_none());
}

#[test]
fn a_plane_seen_from_all_sides_ends_in_a_model_or_cleanly_in_none() {
    let options = SyntheticOptions {
        shape: Shape::Plane,
        path: CameraPath::Random,
        noise_px: 0.2,
        num_cameras: 8,
        ..SyntheticOptions::default()
    };
    let scene = synthetic_scene(&options, 4);
    let known = SfmConfig { intrinsics: Some(options.camera.params.clone()), ..SfmConfig::default() };
    if let Some(solved) = mapped(&scene, &known) {
        assert!(worst_rotation_deg(&scene, &solved) < 1.0, "{}", worst_rotation_deg(&scene, &solved));
    }
    if let Some(solved) = mapped(&scene, &SfmConfig::default()) {
        assert!(solved.state.poses.iter().flatten().all(Pose::is_finite));
    }
}

#[test]
fn one_image_is_an_error_and_images_without_features_are_no_model() {
    let one =
        FrameSet { frames: vec![Frame { width: 64, height: 64, ..Frame::default() }], ..FrameSet::default() };
    let result = reconstruct(&one, &SfmConfig::default(), &Progress::silent());
    assert!(matches!(result, Err(SfmError::TooFewImages { found: 1, .. })));
    let folder = std::env::temp_dir().join(format!("sat-recon-black-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("black.png");
    image::RgbImage::new(64, 64).save(&path).unwrap();
    let frame = |name: &str| Frame {
        name: name.into(),
        path: path.clone(),
        width: 64,
        height: 64,
        ..Frame::default()
    };
    let black = FrameSet { frames: vec![frame("a.png"), frame("b.png")], ..FrameSet::default() };
    let result = reconstruct(&black, &SfmConfig::default(), &Progress::silent()).unwrap();
    assert!(result.reconstruction.is_none() && result.reason.contains("features"), "{}", result.reason);
    std::fs::remove_dir_all(folder).unwrap();
}
