use super::*;
use crate::solvers::testing::{Shape, normal, rotation, two_views};
use glam::{DVec2, DVec3};
use scene::pose::rotation_angle;
use scene::{Camera, CameraModel, Pose};

const FOCAL: f64 = 700.0;

fn config(seed: u64) -> RansacConfig {
    RansacConfig { seed, max_iterations: 20_000, ..RansacConfig::default() }
}

/// World points and their noisy pixels; the first `outliers` pixels are random.
fn resection(seed: u64, n: usize, outliers: usize, unit: f64) -> (Pose, Vec<DVec2>, Vec<DVec3>) {
    let mut r = rng(seed, "resection", 0);
    let pose = Pose::new(rotation(&mut r, 2.0), DVec3::new(0.3, -0.2, 5.0) * unit);
    let mut pixels = Vec::new();
    let mut points = Vec::new();
    for i in 0..n {
        let mut axis = || r.random_range(-1.5..1.5);
        let x = DVec3::new(axis(), axis(), axis()) * unit;
        let c = pose.transform(x);
        let exact = c.truncate() / c.z * FOCAL + DVec2::new(320.0, 240.0);
        let noise = DVec2::new(normal(&mut r), normal(&mut r)) * 0.5;
        let random = DVec2::new(r.random_range(0.0..640.0), r.random_range(0.0..480.0));
        pixels.push(if i < outliers { random } else { exact + noise });
        points.push(x);
    }
    (pose, pixels, points)
}

fn camera() -> Camera {
    Camera::centred(1, CameraModel::SimplePinhole, 640, 480, FOCAL)
}

#[test]
fn finds_the_camera_with_zero_to_ninety_percent_outliers_in_any_unit() {
    for seed in 0..30 {
        for outliers in [0, 100, 160, 180] {
            let unit = [1e-6, 1.0, 1e6][seed as usize % 3];
            let (truth, pixels, points) = resection(seed, 200, outliers, unit);
            let found = estimate_absolute_pose(&camera(), &pixels, &points, &config(seed), 0)
                .unwrap_or_else(|| panic!("seed {seed}, {outliers} outliers"));
            let angle = rotation_angle(found.model.rotation, truth.rotation).to_degrees();
            let distance = found.model.centre().distance(truth.centre()) / unit;
            let tolerance = if outliers == 180 { 1.0 } else { 0.3 };
            assert!(angle < tolerance, "seed {seed}, {outliers} outliers: {angle}°");
            assert!(distance < 0.1 * tolerance, "seed {seed}, {outliers} outliers: {distance}");
            assert!(found.inliers.len() >= 200 - outliers - 1, "seed {seed}, {outliers} outliers");
            assert!(found.inliers.is_sorted());
        }
    }
}

#[test]
fn the_result_is_the_same_each_time() {
    let (_, pixels, points) = resection(1, 100, 60, 1.0);
    let run = |stream| estimate_absolute_pose(&camera(), &pixels, &points, &config(3), stream).unwrap();
    assert_eq!(format!("{:?}", run(4)), format!("{:?}", run(4)));
}

#[test]
fn what_is_not_finite_is_an_outlier_and_nothing_at_all_is_none() {
    let (truth, mut pixels, mut points) = resection(2, 60, 0, 1.0);
    pixels[3] = DVec2::NAN;
    points[5] = DVec3::splat(f64::INFINITY);
    let found = estimate_absolute_pose(&camera(), &pixels, &points, &config(1), 0).unwrap();
    assert!(!found.inliers.contains(&3) && !found.inliers.contains(&5));
    assert!(rotation_angle(found.model.rotation, truth.rotation) < 0.01);
    assert!(estimate_absolute_pose(&camera(), &[], &[], &config(1), 0).is_none());
    assert!(estimate_absolute_pose(&camera(), &pixels[..2], &points, &config(1), 0).is_none());
    let same = vec![DVec3::ONE; 60];
    assert!(estimate_absolute_pose(&camera(), &pixels, &same, &config(1), 0).is_none());
    let zero = RansacConfig { threshold: 0.0, ..config(1) };
    assert!(estimate_absolute_pose(&camera(), &pixels, &points, &zero, 0).is_none());
}

#[test]
fn essential_fundamental_and_homography_survive_outliers() {
    for seed in 0..20 {
        let outliers = [0, 50, 100][seed as usize % 3];
        let general = two_views(seed, 100, Shape::General, 1.0);
        let plane = two_views(seed, 100, Shape::Plane, 1.0);
        let mut r = rng(seed, "outliers", 0);
        let mut spoil = |points: &[DVec2]| {
            let mut all: Vec<DVec2> = points.iter().map(|p| *p * FOCAL).collect();
            all.extend(
                (0..outliers)
                    .map(|_| DVec2::new(r.random_range(-320.0..320.0), r.random_range(-240.0..240.0))),
            );
            all
        };
        let (a, b) = (spoil(&general.a), spoil(&general.b));
        let essential = EssentialEstimator::new(a.clone(), b.clone(), [FOCAL; 2], 1.0);
        let found = ransac(&essential, &config(seed), 0).unwrap_or_else(|| panic!("E, seed {seed}"));
        assert!(found.inliers.iter().filter(|&&i| i < 100).count() >= 99, "E, seed {seed}");
        let scaled = |v: &[DVec2]| v.iter().map(|p| *p / 640.0).collect::<Vec<_>>();
        let unit = RansacConfig { threshold: 4.0 / 640.0, ..config(seed) };
        let fundamental = FundamentalEstimator { a: scaled(&a), b: scaled(&b), loss_scale: 1.0 / 640.0 };
        let found = ransac(&fundamental, &unit, 0).unwrap_or_else(|| panic!("F, seed {seed}"));
        assert!(found.inliers.iter().filter(|&&i| i < 100).count() >= 99, "F, seed {seed}");
        let homography = HomographyEstimator { a: spoil(&plane.a), b: spoil(&plane.b) };
        let found = ransac(&homography, &config(seed), 0).unwrap_or_else(|| panic!("H, seed {seed}"));
        assert!(found.inliers.iter().filter(|&&i| i < 100).count() >= 99, "H, seed {seed}");
    }
}

/// Of models whose data are inliers with the probability given: the share that the test rejects,
/// and how many of 500 data it looked at in the mean.
fn rejected(inliers: f64, best: usize, confidence: f64) -> (f64, f64) {
    const COUNT: usize = 500;
    let tries = 4000;
    let config = RansacConfig { confidence, min_inliers: 8, ..RansacConfig::default() };
    let mut random = rng(7, "sequential test", best as u64);
    let (mut rejected, mut looks) = (0, 0);
    for _ in 0..tries {
        let mut test = SequentialTest::new(&config, COUNT);
        test.note_best(best);
        let mut doubt = 0.0;
        let last = (0..COUNT).find(|_| {
            doubt += if random.random_bool(inliers) { test.inlier } else { test.outlier };
            doubt > test.most
        });
        rejected += usize::from(last.is_some());
        looks += last.map_or(COUNT, |at| at + 1);
    }
    (rejected as f64 / f64::from(tries), looks as f64 / f64::from(tries))
}

#[test]
fn the_sequential_test_rejects_good_models_as_rarely_as_it_says_and_wrong_ones_soon() {
    for (ratio, best) in [(0.2, 100), (0.5, 250), (0.9, 450), (1.0, 500)] {
        assert!(rejected(ratio, best, 0.99).0 <= 0.012, "{ratio}: {:?}", rejected(ratio, best, 0.99));
    }
    for (best, most) in [(100, 120.0), (250, 25.0), (450, 10.0), (500, 5.0)] {
        let (share, looks) = rejected(0.05, best, 0.9999);
        assert!(share > 0.99 && looks < most, "{best} inliers: {share}, {looks} data");
    }
    // Wrong models that fit as many data as the best one are not told apart.
    assert_eq!(rejected(0.05, 8, 0.9999).0, 0.0);
}
