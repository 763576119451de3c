use super::kernel::{portable_top_two, top_two};
use super::*;
use glam::{DMat3, DVec3};
use rand::Rng;
use scene::{Keypoint, rng};

/// [`guided_match_prepared`] of features.
fn guided_match(a: &Features, b: &Features, f: &DMat3, px: f64, config: &MatchConfig) -> Vec<[u32; 2]> {
    let [left, right] = [a, b].map(PreparedFeatures::new);
    guided_match_prepared((a, &left), (b, &right), f, px, config)
}

/// Descriptors of random directions, as RootSIFT stores them.
fn random(n: usize, stream: &str) -> Features {
    let mut r = rng::rng(9, stream, n as u64);
    let mut features = Features { keypoints: vec![Keypoint::default(); n], descriptors: Vec::new() };
    for _ in 0..n {
        let h: Vec<f32> = (0..Features::DIM).map(|_| r.random::<f32>().powi(3)).collect();
        let sum: f32 = h.iter().sum();
        features.descriptors.extend(h.iter().map(|v| (512.0 * (v / sum).sqrt()).round().min(255.0) as u8));
    }
    features
}

/// The same features in another order, each number changed by up to `noise`.
fn shuffled(features: &Features, step: usize, noise: i16) -> Features {
    let n = features.len();
    let mut r = rng::rng(9, "shuffled", n as u64);
    let mut out = Features { keypoints: features.keypoints.clone(), descriptors: Vec::new() };
    for i in 0..n {
        let row = features.descriptor(i * step % n).to_vec();
        let moved = row.iter().map(|&d| (i16::from(d) + r.random_range(-noise..=noise)).clamp(0, 255) as u8);
        out.descriptors.extend(moved);
    }
    out
}

/// The definition: all distances in f64, ratio and mutual test.
fn by_definition(a: &Features, b: &Features, config: &MatchConfig) -> Vec<[u32; 2]> {
    let distance = |x: &[u8], y: &[u8]| {
        let dot =
            |x: &[u8], y: &[u8]| x.iter().zip(y).map(|(&x, &y)| f64::from(x) * f64::from(y)).sum::<f64>();
        (2.0 - 2.0 * dot(x, y) / (dot(x, x) * dot(y, y)).sqrt()).max(0.0).sqrt()
    };
    let best = |x: &[u8], other: &Features| {
        let mut all: Vec<_> = (0..other.len()).map(|j| (distance(x, other.descriptor(j)), j)).collect();
        all.sort_by(|p, q| p.0.total_cmp(&q.0));
        let second = all.get(1).map_or(f64::INFINITY, |s| s.0);
        let (d, j) = all[0];
        (d < f64::from(config.match_ratio) * second && d <= f64::from(config.match_max_distance)).then_some(j)
    };
    let back: Vec<_> = (0..b.len()).map(|j| best(b.descriptor(j), a)).collect();
    let forth = (0..a.len()).filter_map(|i| Some((i, best(a.descriptor(i), b)?)));
    forth.filter(|&(i, j)| back[j] == Some(i)).map(|(i, j)| [i as u32, j as u32]).collect()
}

#[test]
fn finds_what_the_definition_finds() {
    let config = MatchConfig::default();
    for n in [1, 2, 15, 16, 17, 33, 100, 257] {
        let a = random(n, "a");
        let b = shuffled(&a, 7, 12);
        let (found, expected) = (match_features(&a, &b, &config), by_definition(&a, &b, &config));
        // Seven bits may turn a ratio that lies on the threshold.
        let common = found.iter().filter(|m| expected.contains(m)).count();
        assert!(
            common + 2 >= expected.len() && common + 2 >= found.len(),
            "{n}: {} {}",
            found.len(),
            expected.len()
        );
    }
}

#[test]
fn every_kernel_gives_the_same_matches() {
    for (n, m) in [(1, 1), (3, 40), (64, 64), (65, 1), (130, 1100), (1100, 130), (31, 33)] {
        let a = random(n, "left");
        let mut b = random(m, "right");
        let shared = n.min(m) / 2 * Features::DIM;
        b.descriptors[..shared].copy_from_slice(&shuffled(&a, 1, 20).descriptors[..shared]);
        for (floor, group) in [0, 20_000, 45_000].into_iter().flat_map(|f| [1, 2, 4].map(|g| (f, g))) {
            let (a, b) = (PreparedFeatures::with_group(&a, group), PreparedFeatures::with_group(&b, group));
            let (fast, plain) = (top_two(&a, &b, floor), portable_top_two(&a, &b, floor));
            for (x, y) in [(&fast.0, &plain.0), (&fast.1, &plain.1)] {
                assert_eq!(x.best, y.best, "{n} {m} {floor}");
                assert_eq!(x.second, y.second, "{n} {m} {floor}");
                assert_eq!(x.index, y.index, "{n} {m} {floor}");
            }
        }
    }
}

#[test]
fn twins_fail_the_ratio_test_and_strangers_the_distance() {
    let a = random(20, "a");
    let mut twins = a.clone();
    twins.keypoints.extend_from_slice(&a.keypoints);
    twins.descriptors.extend_from_slice(&a.descriptors);
    assert!(match_features(&a, &twins, &MatchConfig::default()).is_empty());
    assert_eq!(match_features(&a, &a, &MatchConfig::default()).len(), 20);
    let tight = MatchConfig { match_max_distance: 1e-3, ..MatchConfig::default() };
    assert!(match_features(&a, &random(50, "strangers"), &tight).is_empty());
}

#[test]
fn empty_zero_and_saturated_descriptors_do_no_harm() {
    let config = MatchConfig::default();
    let (none, some) = (Features::default(), random(5, "a"));
    assert!(match_features(&none, &some, &config).is_empty());
    assert!(match_features(&some, &none, &config).is_empty());
    for byte in [0, 255] {
        let flat = Features { keypoints: some.keypoints.clone(), descriptors: vec![byte; 5 * Features::DIM] };
        assert!(match_features(&flat, &flat, &config).is_empty(), "all alike");
        match_features(&flat, &some, &config);
    }
    for ratio in [0.0, -1.0, f32::NAN, 2.0] {
        let config = MatchConfig { match_ratio: ratio, ..MatchConfig::default() };
        match_features(&some, &some, &config);
    }
}

#[test]
fn pairs_come_back_in_order_for_any_number_of_threads() {
    let base = random(60, "a");
    let images: Vec<Features> = (1..6).map(|i| shuffled(&base, [1, 7, 11, 13, 17][i - 1], 10)).collect();
    let pairs = [(0, 1), (3, 2), (1, 4), (0, 9)];
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| match_pairs(&images, &pairs, &MatchConfig::default(), &Progress::silent())).unwrap()
    };
    let found = run(1);
    assert_eq!(found, run(2));
    assert_eq!(found.iter().map(|p| (p.0, p.1)).collect::<Vec<_>>(), pairs);
    assert!(found[..3].iter().all(|p| p.2.len() > 50) && found[3].2.is_empty());
}

/// Keypoints of two images with a sideways baseline: rows agree, columns differ.
fn stereo(n: usize) -> (Features, Features, DMat3) {
    let mut a = random(n, "stereo");
    let mut b = shuffled(&a, 1, 14);
    let mut r = rng::rng(2, "stereo", 0);
    for i in 0..n {
        let (x, y) = (r.random_range(0.0..640.0_f32), r.random_range(0.0..480.0_f32));
        a.keypoints[i] = Keypoint { x, y, scale: 2.0, angle: 0.0 };
        b.keypoints[i] =
            Keypoint { x: x - r.random_range(0.0..90.0), y: y + r.random_range(-0.4..0.4), ..a.keypoints[i] };
    }
    let f = DMat3::from_cols(DVec3::ZERO, DVec3::new(0.0, 0.0, 1.0), DVec3::new(0.0, -1.0, 0.0));
    (a, b, f)
}

#[test]
fn guided_matching_finds_partners_along_the_lines_even_where_twins_hide_them() {
    let (mut a, mut b, f) = stereo(300);
    // Every descriptor exists twice, in another row: without the geometry nothing is distinct.
    let (far_a, far_b) = (a.clone(), b.clone());
    a.descriptors.extend_from_slice(&far_a.descriptors);
    b.descriptors.extend_from_slice(&far_b.descriptors);
    let moved = |k: &Keypoint| Keypoint { y: k.y + 600.0, ..*k };
    a.keypoints.extend(far_a.keypoints.iter().map(moved));
    b.keypoints.extend(far_b.keypoints.iter().map(moved));
    assert!(match_features(&a, &b, &MatchConfig::default()).is_empty());
    for turn in [DMat3::IDENTITY, DMat3::from_cols(DVec3::Y, -DVec3::X, DVec3::Z)] {
        // The same with both images turned by a quarter: steep lines.
        let turned = |features: &Features| {
            let mut out = features.clone();
            for k in &mut out.keypoints {
                let p = turn * k.position().extend(1.0);
                (k.x, k.y) = (p.x as f32, p.y as f32);
            }
            out
        };
        let f = turn.inverse().transpose() * f * turn.inverse();
        let matches = guided_match(&turned(&a), &turned(&b), &f, 2.0, &MatchConfig::default());
        assert!(matches.len() > 560, "{}", matches.len());
        assert!(matches.iter().all(|m| m[0] == m[1]));
    }
}

#[test]
fn guided_matching_without_a_geometry_finds_nothing() {
    let (a, b, f) = stereo(20);
    let config = MatchConfig::default();
    assert!(guided_match(&a, &b, &DMat3::ZERO, 2.0, &config).is_empty());
    assert!(guided_match(&a, &b, &DMat3::from_diagonal(DVec3::NAN), 2.0, &config).is_empty());
    assert!(guided_match(&a, &Features::default(), &f, 2.0, &config).is_empty());
    assert!(guided_match(&a, &b, &f, f64::NAN, &config).is_empty());
    assert!(guided_match(&a, &b, &(f * 1e-200), 2.0, &config).len() <= 20);
}
