//! PSNR and SSIM against scikit-image (fixtures by `tests/oracle/metrics.py`).

mod patterns;

use image::{GrayImage, Luma};
use patterns::pattern;
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
