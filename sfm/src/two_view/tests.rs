use super::*;
use crate::solvers::testing::{Shape, angle, normal, two_views};
use glam::DVec2;
use rand::Rng as _;
use scene::pose::rotation_angle;
use scene::rng::rng;
use scene::{CameraModel, Keypoint, Pose};

const FOCAL: f64 = 700.0;

struct Pair {
    features: [Features; 2],
    cameras: [Camera; 2],
    matches: Vec<[u32; 2]>,
    truth: Pose,
}

fn camera() -> Camera {
    Camera::centred(1, CameraModel::SimplePinhole, 640, 480, FOCAL)
}

fn features_at(pixels: &[DVec2]) -> Features {
    let keypoints =
        pixels.iter().map(|p| Keypoint { x: p.x as f32, y: p.y as f32, scale: 2.0, angle: 0.0 }).collect();
    Features { keypoints, descriptors: Vec::new() }
}

/// `n` true matches with noise, then `outliers` random ones; feature `i` of a matches feature `i`
/// of b.
fn pair(seed: u64, n: usize, outliers: usize, shape: Shape, noise_px: f64) -> Pair {
    let s = two_views(seed, n, shape, 1.0);
    let mut r = rng(seed, "pair", 0);
    let middle = camera().principal_point();
    let mut noisy = |u: &DVec2| *u * FOCAL + middle + DVec2::new(normal(&mut r), normal(&mut r)) * noise_px;
    let mut a: Vec<DVec2> = s.a.iter().map(&mut noisy).collect();
    let mut b: Vec<DVec2> = s.b.iter().map(&mut noisy).collect();
    for _ in 0..outliers {
        a.push(DVec2::new(r.random_range(0.0..640.0), r.random_range(0.0..480.0)));
        b.push(DVec2::new(r.random_range(0.0..640.0), r.random_range(0.0..480.0)));
    }
    let matches = (0..a.len() as u32).map(|i| [i, i]).collect();
    Pair {
        features: [features_at(&a), features_at(&b)],
        cameras: [camera(), camera()],
        matches,
        truth: s.b_from_a,
    }
}

fn verify(p: &Pair) -> TwoViewGeometry {
    let [a, b] = &p.features;
    verify_pair(0, 1, a, b, &p.cameras[0], &p.cameras[1], &p.matches, &TwoViewConfig::default(), 1)
}

fn rotation_error(g: &TwoViewGeometry, truth: &Pose) -> f64 {
    rotation_angle(g.b_from_a.unwrap().rotation, truth.rotation).to_degrees()
}

#[test]
fn recovers_the_pose_from_noisy_matches_with_up_to_sixty_percent_outliers() {
    for seed in 0..40 {
        let outliers = [0, 60, 150][seed as usize % 3];
        let p = pair(seed, 100, outliers, Shape::General, 0.5);
        let g = verify(&p);
        let counts = (g.kind, g.inliers.len(), outliers);
        assert_eq!(g.kind, TwoViewKind::Calibrated, "seed {seed}: {counts:?}");
        assert!(rotation_error(&g, &p.truth) < 1.0, "seed {seed}: {}", rotation_error(&g, &p.truth));
        let direction = angle(g.b_from_a.unwrap().translation, p.truth.translation).to_degrees();
        assert!(direction < 3.0, "seed {seed}: {direction}");
        assert!(g.inliers.iter().filter(|m| m[0] < 100).count() >= 98, "seed {seed}");
        assert!((g.b_from_a.unwrap().translation.length() - 1.0).abs() < 1e-9, "seed {seed}");
        assert!(g.median_angle > 0.05 && g.median_angle < 0.7, "seed {seed}: {}", g.median_angle);
    }
}

#[test]
fn a_focal_length_that_is_thirty_percent_off_still_verifies_the_pair() {
    for seed in 0..20 {
        let mut p = pair(seed, 100, 40, Shape::General, 0.5);
        for factor in [0.7, 1.3] {
            p.cameras =
                [(); 2].map(|()| Camera::centred(1, CameraModel::SimplePinhole, 640, 480, FOCAL * factor));
            let g = verify(&p);
            assert!(g.inliers.len() >= 90, "seed {seed} × {factor}: {:?} {}", g.kind, g.inliers.len());
            assert!(g.b_from_a.is_some(), "seed {seed} × {factor}");
        }
    }
}

#[test]
fn a_plane_is_planar_and_one_place_is_panoramic() {
    for seed in 0..20 {
        let p = pair(seed, 100, 30, Shape::Plane, 0.3);
        let g = verify(&p);
        assert_eq!(g.kind, TwoViewKind::Planar, "seed {seed}");
        assert!(g.inliers.len() >= 95, "seed {seed}");
        let p = pair(seed, 100, 30, Shape::NoBaseline, 0.3);
        let g = verify(&p);
        assert_eq!(g.kind, TwoViewKind::Panoramic, "seed {seed}");
        assert_eq!(g.b_from_a.unwrap().translation, glam::DVec3::ZERO, "seed {seed}");
        assert!(rotation_error(&g, &p.truth) < 0.5, "seed {seed}");
    }
}

#[test]
fn a_watermark_does_not_win_over_what_moves() {
    for seed in 0..20 {
        let mut p = pair(seed, 60, 20, Shape::General, 0.3);
        let mut r = rng(seed, "watermark", 0);
        for _ in 0..90 {
            let at = Keypoint {
                x: r.random_range(5.0..200.0),
                y: r.random_range(5.0..60.0),
                ..Keypoint::default()
            };
            p.matches.push([p.features[0].len() as u32, p.features[1].len() as u32]);
            p.features[0].keypoints.push(at);
            p.features[1].keypoints.push(Keypoint { x: at.x + 0.2, ..at });
        }
        let g = verify(&p);
        assert_eq!(g.kind, TwoViewKind::Calibrated, "seed {seed}");
        assert!(g.inliers.iter().all(|m| m[0] < 80), "seed {seed}: a static match was kept");
        assert!(rotation_error(&g, &p.truth) < 2.0, "seed {seed}: {}", rotation_error(&g, &p.truth));
        let moving = p.matches.len() - 90;
        p.matches.drain(..moving);
        assert_eq!(verify(&p).kind, TwoViewKind::Watermark, "seed {seed}");
    }
}

#[test]
fn random_matches_are_no_pair() {
    let mut accepted = Vec::new();
    for seed in 0..30 {
        for n in [15, 30, 60, 200] {
            let g = verify(&pair(seed, 0, n, Shape::General, 0.0));
            if !g.inliers.is_empty() {
                accepted.push((seed, n, g.kind, g.inliers.len()));
            }
        }
    }
    assert!(accepted.len() <= 1, "{accepted:?}");
}

#[test]
fn senseless_input_is_degenerate_and_never_panics() {
    let p = pair(0, 50, 0, Shape::General, 0.0);
    let none = |p: &Pair| {
        let g = verify(p);
        assert_eq!(g.kind, TwoViewKind::Degenerate);
        assert!(g.inliers.is_empty());
    };
    none(&Pair { matches: Vec::new(), ..pair(0, 50, 0, Shape::General, 0.0) });
    none(&Pair { matches: vec![[900, 900]; 50], ..pair(0, 50, 0, Shape::General, 0.0) });
    none(&Pair { matches: vec![[0, 0]; 50], ..pair(0, 50, 0, Shape::General, 0.0) });
    for bad in [f32::NAN, f32::INFINITY, f32::MAX] {
        let keypoint = Keypoint { x: bad, y: bad, scale: 1.0, angle: 0.0 };
        let features = || Features { keypoints: vec![keypoint; 50], descriptors: Vec::new() };
        let g = verify(&Pair {
            features: [features(), p.features[1].clone()],
            ..pair(0, 50, 0, Shape::General, 0.0)
        });
        assert!(g.b_from_a.is_none_or(|pose| pose.is_finite()), "{bad}");
        let same =
            verify(&Pair { features: [features(), features()], ..pair(0, 50, 0, Shape::General, 0.0) });
        assert!(same.b_from_a.is_none_or(|pose| pose.is_finite()), "{bad}");
    }
    let line = verify(&pair(3, 50, 0, Shape::Line, 0.0));
    assert!(line.b_from_a.is_none_or(|pose| pose.is_finite()));
}

#[test]
fn extreme_focal_lengths_are_verified() {
    for seed in 0..10 {
        for widths in [0.2, 50.0] {
            let mut p = pair(seed, 100, 30, Shape::General, 0.0);
            let focal = 640.0 * widths;
            // The same scene through other lenses: pixels follow from the points of normalised
            // coordinates.
            let s = two_views(seed, 100, Shape::General, 1.0);
            for (features, points) in p.features.iter_mut().zip([&s.a, &s.b]) {
                for (k, u) in features.keypoints.iter_mut().zip(points) {
                    let pixel = *u * focal + camera().principal_point();
                    (k.x, k.y) = (pixel.x as f32, pixel.y as f32);
                }
            }
            p.cameras = [(); 2].map(|()| Camera::centred(1, CameraModel::SimplePinhole, 640, 480, focal));
            // The same angle as 4 px of a common lens.
            let config = TwoViewConfig { max_error_px: 4.0 * focal / FOCAL, ..TwoViewConfig::default() };
            let [a, b] = &p.features;
            let g = verify_pair(0, 1, a, b, &p.cameras[0], &p.cameras[1], &p.matches, &config, 1);
            assert!(g.inliers.len() >= 95, "seed {seed} × {widths}: {:?} {}", g.kind, g.inliers.len());
            assert!(
                rotation_error(&g, &p.truth) < 2.0,
                "seed {seed} × {widths}: {}",
                rotation_error(&g, &p.truth)
            );
        }
    }
}

#[test]
fn pairs_come_sorted_and_do_not_depend_on_the_number_of_threads() {
    let p = pair(5, 80, 60, Shape::General, 0.5);
    let [a, b] = p.features.clone();
    let features = vec![a.clone(), b.clone(), a.clone(), b];
    let cameras = vec![camera(); 4];
    let turned: Vec<[u32; 2]> = p.matches.iter().map(|m| [m[1], m[0]]).collect();
    let matches = || {
        vec![
            (2, 3, p.matches.clone()),
            (3, 0, turned.clone()),
            (0, 1, p.matches.clone()),
            (1, 1, p.matches.clone()),
            (0, 9, p.matches.clone()),
            (1, 2, p.matches[..5].to_vec()),
        ]
    };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let config = TwoViewConfig::default();
            verify_pairs(&features, &cameras, matches(), &config, 7, &Progress::silent()).unwrap()
        })
    };
    let (one, three) = (run(1), run(3));
    assert_eq!(one.iter().map(|g| (g.a, g.b)).collect::<Vec<_>>(), [(0, 1), (0, 3), (2, 3)]);
    assert_eq!(format!("{one:?}"), format!("{three:?}"));
}

#[test]
fn merging_guided_matches_keeps_the_good_and_drops_the_rest() {
    let p = pair(6, 120, 0, Shape::General, 0.3);
    let first = Pair { matches: p.matches[..60].to_vec(), ..pair(6, 120, 0, Shape::General, 0.3) };
    let geometry = verify(&first);
    let mut more = p.matches[60..].to_vec();
    more.extend((0..30).map(|i| [i, 119 - i]));
    let features = [&p.features[0], &p.features[1]];
    let cameras = [&p.cameras[0], &p.cameras[1]];
    let merged = merge_guided(&geometry, features, cameras, &more, &TwoViewConfig::default(), 1);
    assert!(merged.inliers.len() >= 115, "{}", merged.inliers.len());
    assert!(merged.inliers.iter().filter(|m| m[0] == m[1]).count() >= 115);
    let unchanged = merge_guided(&geometry, features, cameras, &[[999, 999]], &TwoViewConfig::default(), 1);
    assert_eq!(unchanged.inliers, geometry.inliers);
}

#[test]
fn with_known_intrinsics_few_matches_are_a_pair_and_random_ones_are_not() {
    let look = |seed: u64, n: usize, outliers: usize| {
        let mut p = pair(seed, n, outliers, Shape::General, 0.3);
        let mut r = rng(seed, "descriptors", 0);
        let descriptors: Vec<u8> =
            (0..p.matches.len() * Features::DIM).map(|_| r.random_range(0..90)).collect();
        p.features.iter_mut().for_each(|f| f.descriptors.clone_from(&descriptors));
        let matching = MatchConfig::default();
        let configs = (&matching, &TwoViewConfig::default());
        let found = second_look(&p.features, &p.cameras, &[(0, 1)], configs, 1, &Progress::silent());
        (found.unwrap(), p.truth)
    };
    for seed in 0..10 {
        let (found, truth) = look(seed, 22, 14);
        assert_eq!(found.len(), 1, "seed {seed}");
        assert!(found[0].inliers.iter().filter(|m| m[0] < 22).count() >= 18, "seed {seed}");
        assert!(
            rotation_error(&found[0], &truth) < 2.0,
            "seed {seed}: {}",
            rotation_error(&found[0], &truth)
        );
        let [a, b] =
            [0, 1].map(|i| pair(seed, 22, 14, Shape::General, 0.3).features[i].keypoints[3].position());
        assert!(sampson_sq(&found[0].f.unwrap(), a, b) < 4.0, "F refers to pixels, seed {seed}");
        assert!(look(seed, 0, 36).0.is_empty(), "seed {seed}");
    }
}
