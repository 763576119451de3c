//! LPIPS against the `lpips` package, both with weights from the same formula
//! (`tests/oracle/lpips_distances.py`).

mod patterns;

use image::{GrayImage, Luma, RgbImage};
use patterns::pattern;
use scene::lpips::{Backbone, Lpips};
use scene::metrics::MetricsError;
use std::convert::Infallible;

#[derive(serde::Deserialize)]
struct Case {
    net: String,
    width: u32,
    height: u32,
    kind: String,
    distance: f64,
}

/// The numbers that the oracle fills tensor `seed` with.
fn formula(seed: u64, shape: &[usize]) -> Vec<f32> {
    let count: usize = shape.iter().product();
    let fan_in: usize = shape[1..].iter().product();
    let range = (6.0 / fan_in as f64).sqrt() as f32;
    let number = |i: u64| {
        let mut h = (i * 2_654_435_761 + seed * 40_503 + 12_345) & 0xFFFF_FFFF;
        h = ((h ^ (h >> 16)) * 2_246_822_519) & 0xFFFF_FFFF;
        h ^= h >> 13;
        let unit = (h % 65_536) as f32 / 32_768.0 - 1.0;
        match shape {
            [1, ..] => (unit + 1.0) / 2.0,
            [_, _, _, _] => unit * range,
            _ => unit * 0.1,
        }
    };
    (0..count as u64).map(number).collect()
}

fn network(backbone: Backbone) -> Lpips {
    let (mut convolution, mut linear) = (0, 100);
    let network = Lpips::build(backbone, |name, shape| {
        let counter = if name.starts_with("lin") { &mut linear } else { &mut convolution };
        *counter += 1;
        Ok::<_, Infallible>(formula(*counter - 1, shape))
    });
    network.unwrap_or_else(|never| match never {})
}

#[test]
fn distances_equal_the_lpips_package_to_1e_minus_4() {
    let cases: Vec<Case> = serde_json::from_str(include_str!("fixtures/lpips.json")).unwrap();
    for backbone in [Backbone::Alex, Backbone::Vgg] {
        let network = network(backbone);
        let mut seen = 0;
        for case in cases.iter().filter(|c| c.net == backbone.name()) {
            let [a, b] = pattern(case.width, case.height, &case.kind);
            let found = network.distance(&a, &b, None).unwrap();
            let error = (found - case.distance).abs();
            assert!(error < 1e-4, "{} {}: {found} {}", case.net, case.kind, case.distance);
            seen += 1;
        }
        assert!(seen >= 4);
    }
}

#[test]
fn equal_images_have_no_distance_and_a_mask_looks_only_where_it_is_white() {
    let network = network(Backbone::Alex);
    let [a, _] = pattern(96, 80, "noise");
    assert_eq!(network.distance(&a, &a, None), Ok(0.0));
    let mut b = a.clone();
    (0..30).for_each(|y| (0..24).for_each(|x| b.put_pixel(x, y, image::Rgb([255, 0, 0]))));
    let mask = |far: bool| GrayImage::from_fn(96, 80, |x, _| Luma([if (x >= 80) == far { 255 } else { 0 }]));
    let distance = |m| network.distance(&a, &b, Some(&m)).unwrap();
    assert!(distance(mask(true)) < 0.2 * distance(mask(false)));
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let network = network(Backbone::Alex);
    let (small, large) = (RgbImage::new(20, 20), RgbImage::new(64, 64));
    assert!(matches!(network.distance(&small, &small, None), Err(MetricsError::TooSmall { .. })));
    assert!(matches!(network.distance(&small, &large, None), Err(MetricsError::SizesDiffer(..))));
    let nothing = GrayImage::new(64, 64);
    assert_eq!(network.distance(&large, &large, Some(&nothing)), Err(MetricsError::EmptyMask));
}

#[test]
fn a_weights_file_of_the_wrong_kind_or_shape_is_refused_by_name() {
    let folder = std::env::temp_dir().join(format!("sat-recon-lpips-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("weights.safetensors");
    let said = || Lpips::load(&path).err().unwrap().to_string();
    assert!(said().contains("weights.safetensors"), "missing");
    let header = |text: &str| [&(text.len() as u64).to_le_bytes()[..], text.as_bytes()].concat();
    let wrong = header(r#"{"features.0.weight":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}}"#);
    let claim = u64::MAX.to_le_bytes().to_vec();
    for (content, word) in [
        (b"no tensors".to_vec(), "safetensors"),
        (claim, "safetensors"),
        ([wrong, vec![0; 8]].concat(), "features.0.weight"),
    ] {
        std::fs::write(&path, content).unwrap();
        assert!(said().contains(word) && said().contains("weights.safetensors"), "{}", said());
    }
    std::fs::remove_dir_all(folder).unwrap();
}
