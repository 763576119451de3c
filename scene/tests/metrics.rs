//! PSNR and SSIM against scikit-image (fixtures by `tests/oracle/metrics.py`).

use image::{GrayImage, Luma, Rgb, RgbImage};
use scene::metrics::{psnr, ssim};

#[derive(serde::Deserialize)]
struct Case {
    width: u32,
    height: u32,
    kind: String,
    psnr: f64,
    ssim: f64,
    psnr_masked: f64,
    ssim_masked: f64,
}

fn pattern(width: u32, height: u32, kind: &str) -> [RgbImage; 2] {
    let base = |x: i64, y: i64, c: i64| (x * 3 + y * 5 + c * 40 + (x * y) / 7) % 256;
    let hashed = |x: i64, y: i64, c: i64| ((x * 73_856_093) ^ (y * 19_349_663) ^ (c * 83_492_791)) % 65_521;
    let image = |f: &dyn Fn(i64, i64, i64) -> i64| {
        let value = |x, y, c| f(i64::from(x), i64::from(y), c).clamp(0, 255) as u8;
        RgbImage::from_fn(width, height, |x, y| Rgb([0, 1, 2].map(|c| value(x, y, c))))
    };
    match kind {
        "noise" => [image(&base), image(&|x, y, c| base(x, y, c) + hashed(x, y, c) % 21 - 10)],
        "shift" => [image(&base), image(&|x, y, c| base(x + 1, y, c))],
        "dark" => {
            let dark = |x: i64, y: i64, c: i64| base(x, y, c) / 16;
            [image(&dark), image(&|x, y, c| dark(x, y, c) + hashed(x, y, c) % 5 - 2)]
        }
        _ => [image(&base), image(&|x, y, c| hashed(x, y, c) % 256)],
    }
}

#[test]
fn psnr_and_ssim_equal_scikit_image_to_1e_minus_4() {
    let cases: Vec<Case> = serde_json::from_str(include_str!("fixtures/metrics.json")).unwrap();
    assert!(cases.len() >= 5);
    for c in cases {
        let [a, b] = pattern(c.width, c.height, &c.kind);
        let (w, h) = (f64::from(c.width), f64::from(c.height));
        let mask = GrayImage::from_fn(c.width, c.height, |x, y| {
            let inside = (f64::from(x) - w / 2.0).powi(2) + (f64::from(y) - h / 2.0).powi(2)
                < (w.min(h) / 3.0).powi(2);
            Luma([if inside { 255 } else { 0 }])
        });
        let found = [
            (psnr(&a, &b, None), c.psnr),
            (ssim(&a, &b, None), c.ssim),
            (psnr(&a, &b, Some(&mask)), c.psnr_masked),
            (ssim(&a, &b, Some(&mask)), c.ssim_masked),
        ];
        for (i, (found, expected)) in found.into_iter().enumerate() {
            let found = found.unwrap();
            assert!(
                (found - expected).abs() < 1e-4,
                "{} {}x{}, number {i}: {found} {expected}",
                c.kind,
                c.width,
                c.height
            );
        }
    }
}
