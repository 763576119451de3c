//! Image quality of 8-bit images: PSNR and SSIM, full frame or inside a mask.
//!
//! Both work on what a file holds: round a render to 8 bits ([`crate::FloatImage::to_rgb8`]) before
//! it is judged.

use image::{GrayImage, RgbImage};
use rayon::prelude::*;

/// Why two images cannot be compared.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MetricsError {
    /// The sizes differ.
    #[error(
        "the images to compare have different sizes: {0} × {1}, {2} × {3}; render at the size of the photo"
    )]
    SizesDiffer(u32, u32, u32, u32),
    /// An image without pixels, or, for SSIM, smaller than its window.
    #[error("an image of {width} × {height} pixels is too small; at least {needed} × {needed} are needed")]
    TooSmall {
        /// Width.
        width: u32,
        /// Height.
        height: u32,
        /// Least side.
        needed: u32,
    },
    /// The mask keeps nothing.
    #[error("the mask keeps no pixel, so there is nothing to compare")]
    EmptyMask,
}

pub(crate) fn check(
    a: &RgbImage,
    b: &RgbImage,
    mask: Option<&GrayImage>,
    needed: u32,
) -> Result<(), MetricsError> {
    let (width, height) = a.dimensions();
    for (w, h) in [Some(b.dimensions()), mask.map(GrayImage::dimensions)].into_iter().flatten() {
        if (w, h) != (width, height) {
            return Err(MetricsError::SizesDiffer(width, height, w, h));
        }
    }
    if width < needed || height < needed {
        return Err(MetricsError::TooSmall { width, height, needed });
    }
    Ok(())
}

/// Whether a mask value means "keep".
fn keeps(value: u8) -> bool {
    value >= 128
}

/// Peak signal-to-noise ratio, dB: `−10 log10(MSE)` with the mean over pixels and channels of
/// squared differences of values in [0, 1]; infinite for equal images. With a mask: over the pixels
/// it keeps (≥ 128).
pub fn psnr(a: &RgbImage, b: &RgbImage, mask: Option<&GrayImage>) -> Result<f64, MetricsError> {
    check(a, b, mask, 1)?;
    let square =
        |p: &[u8], q: &[u8]| -> u64 { p.iter().zip(q).map(|(&p, &q)| u64::from(p.abs_diff(q)).pow(2)).sum() };
    let (sum, pixels) = match mask {
        None => (square(a.as_raw(), b.as_raw()), u64::from(a.width()) * u64::from(a.height())),
        Some(mask) => {
            let kept = a.as_raw().chunks_exact(3).zip(b.as_raw().chunks_exact(3)).zip(mask.as_raw());
            kept.filter(|(_, m)| keeps(**m)).fold((0, 0), |(sum, n), ((p, q), _)| (sum + square(p, q), n + 1))
        }
    };
    if pixels == 0 {
        return Err(MetricsError::EmptyMask);
    }
    let mse = sum as f64 / (pixels * 3) as f64 / (255.0 * 255.0);
    Ok(-10.0 * mse.log10())
}

/// Side of SSIM's window, pixels. Source: Wang et al., TIP 2004, section III-B.
pub const SSIM_WINDOW: usize = 11;
/// Standard deviation of SSIM's window, pixels. Source: Wang et al., TIP 2004, section III-B.
pub const SSIM_SIGMA: f64 = 1.5;
/// Pixels from the window's middle to its side. Source: derived from [`SSIM_WINDOW`].
pub const SSIM_REACH: usize = SSIM_WINDOW / 2;
/// K₁ and K₂ of the stabilising constants C = (K L)², L the range of values.
/// Source: Wang et al., TIP 2004, section III-B.
pub const SSIM_K: [f64; 2] = [0.01, 0.03];

fn window() -> [f64; SSIM_WINDOW] {
    let weights: [f64; SSIM_WINDOW] = std::array::from_fn(|i| {
        (-(i as f64 - SSIM_REACH as f64).powi(2) / (2.0 * SSIM_SIGMA * SSIM_SIGMA)).exp()
    });
    let sum: f64 = weights.iter().sum();
    weights.map(|w| w / sum)
}

/// Structural similarity (Wang et al. 2004): 11 × 11 Gaussian window with σ 1.5, C1 = 0.01², C2 =
/// 0.03² for values in [0, 1], computed for each channel and averaged over all pixels whose window
/// lies inside the image (a border of 5 pixels is left out). Equals scikit-image's
/// `structural_similarity(gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
/// data_range=1)`; kornia's `ssim` with `padding="valid"` takes the same pixels, with its default
/// `"same"` it adds the border with reflected windows, and the 3DGS paper's adds it with zeros.
/// With a mask: the mean over the same pixels as far as the mask keeps them (windows may reach
/// outside the mask).
pub fn ssim(a: &RgbImage, b: &RgbImage, mask: Option<&GrayImage>) -> Result<f64, MetricsError> {
    check(a, b, mask, SSIM_WINDOW as u32)?;
    let (width, height) = (a.width() as usize, a.height() as usize);
    let rows = height - 2 * SSIM_REACH;
    let results: Vec<(f64, usize)> = (0..rows)
        .into_par_iter()
        .map_init(
            || RowBuffers::new(width * 3),
            |buffers, y| {
                let at = (y + SSIM_REACH) * width + SSIM_REACH;
                match mask.map(|m| &m.as_raw()[at..at + width - 2 * SSIM_REACH]) {
                    Some(kept) if !kept.iter().any(|&v| keeps(v)) => (0.0, 0),
                    kept => buffers.row(a.as_raw(), b.as_raw(), y, kept),
                }
            },
        )
        .collect();
    let (sum, n) = results.iter().fold((0.0, 0), |(s, n), r| (s + r.0, n + r.1));
    if n == 0 { Err(MetricsError::EmptyMask) } else { Ok(sum / (3 * n) as f64) }
}

/// Vertically filtered rows (f64: in f32 the variances of bright flat areas drown in rounding) of
/// `u = a + b`, `v = a − b`, `u²`, `v²`. These four are enough: `2 μa μb = (μu² − μv²)/2`, `μa² +
/// μb² = (μu² + μv²)/2`, and likewise for the variances.
struct RowBuffers {
    weights: [f64; SSIM_WINDOW],
    filtered: [Vec<f64>; 4],
}

impl RowBuffers {
    fn new(stride: usize) -> Self {
        Self { weights: window(), filtered: std::array::from_fn(|_| vec![0.0; stride]) }
    }

    /// Sum of SSIM over the pixels of output row `y` (input rows y to y + 10) and channels, and
    /// number of pixels.
    fn row(&mut self, a: &[u8], b: &[u8], y: usize, kept: Option<&[u8]>) -> (f64, usize) {
        let stride = self.filtered[0].len();
        self.filtered.iter_mut().for_each(|f| f.fill(0.0));
        let [fu, fv, fuu, fvv] = &mut self.filtered;
        for (i, &w) in self.weights.iter().enumerate() {
            let at = (y + i) * stride;
            let (ra, rb) = (&a[at..at + stride], &b[at..at + stride]);
            for x in 0..stride {
                let (p, q) = (f64::from(ra[x]), f64::from(rb[x]));
                let (u, v) = (p + q, p - q);
                fu[x] += w * u;
                fv[x] += w * v;
                fuu[x] += w * u * u;
                fvv[x] += w * v * v;
            }
        }
        let n = stride - 6 * SSIM_REACH;
        let mut sum = 0.0;
        let mut pixels = 0;
        let mut values = [0.0_f64; 3 * CHUNK];
        for start in (0..n).step_by(3 * CHUNK) {
            let len = (n - start).min(3 * CHUNK);
            self.horizontal(start, &mut values[..len]);
            for (x, pixel) in values[..len].chunks_exact(3).enumerate() {
                if kept.is_none_or(|k| keeps(k[start / 3 + x])) {
                    sum += pixel.iter().sum::<f64>();
                    pixels += 1;
                }
            }
        }
        (sum, pixels)
    }

    /// SSIM of the samples from `start` on.
    fn horizontal(&self, start: usize, out: &mut [f64]) {
        let [c1, c2] = SSIM_K.map(|k| (k * 255.0) * (k * 255.0));
        let mut means = [[0.0_f64; 3 * CHUNK]; 4];
        for (mean, filtered) in means.iter_mut().zip(&self.filtered) {
            for (i, &w) in self.weights.iter().enumerate() {
                let source = &filtered[start + 3 * i..start + 3 * i + out.len()];
                mean[..out.len()].iter_mut().zip(source).for_each(|(m, &s)| *m += w * s);
            }
        }
        let [mu, mv, muu, mvv] = &means;
        for (x, value) in out.iter_mut().enumerate() {
            let (uu, vv) = (mu[x] * mu[x], mv[x] * mv[x]);
            let (su, sv) = (muu[x] - uu, mvv[x] - vv);
            let numerator = ((uu - vv) / 2.0 + c1) * ((su - sv) / 2.0 + c2);
            *value = numerator / (((uu + vv) / 2.0 + c1) * ((su + sv) / 2.0 + c2));
        }
    }
}

/// Pixels that are filtered at once. Source: chosen by hand, never measured.
const CHUNK: usize = 64;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_images_are_perfect_and_a_step_of_one_level_has_its_known_psnr() {
        let a = RgbImage::from_fn(31, 17, |x, y| image::Rgb([(x * 8) as u8, (y * 9) as u8, 100]));
        assert_eq!(psnr(&a, &a, None), Ok(f64::INFINITY));
        assert!((ssim(&a, &a, None).unwrap() - 1.0).abs() < 1e-6);
        let mut b = a.clone();
        b.iter_mut().for_each(|v| *v += 1);
        assert!((psnr(&a, &b, None).unwrap() - 20.0 * 255f64.log10()).abs() < 1e-12);
    }

    #[test]
    fn constant_images_have_the_ssim_of_the_formula() {
        for (p, q) in [(0_u8, 0_u8), (0, 255), (255, 255), (10, 20), (200, 100)] {
            let (a, b) = (
                RgbImage::from_pixel(20, 15, image::Rgb([p; 3])),
                RgbImage::from_pixel(20, 15, image::Rgb([q; 3])),
            );
            let (x, y) = (f64::from(p) / 255.0, f64::from(q) / 255.0);
            let expected = (2.0 * x * y + 1e-4) / (x * x + y * y + 1e-4);
            assert!((ssim(&a, &b, None).unwrap() - expected).abs() < 1e-10, "{p} {q}");
        }
    }

    #[test]
    fn a_mask_takes_the_damage_outside_it_out_of_the_score() {
        let a = RgbImage::from_fn(60, 40, |x, y| image::Rgb([(x * 4) as u8, (y * 6) as u8, (x * y) as u8]));
        let mut b = a.clone();
        (0..40).for_each(|y| b.put_pixel(50, y, image::Rgb([255, 0, 0])));
        let left = GrayImage::from_fn(60, 40, |x, _| image::Luma([if x < 40 { 255 } else { 0 }]));
        assert_eq!(psnr(&a, &b, Some(&left)), Ok(f64::INFINITY));
        assert!((ssim(&a, &b, Some(&left)).unwrap() - 1.0).abs() < 1e-6);
        assert!(ssim(&a, &b, None).unwrap() < 0.99);
        let nothing = GrayImage::new(60, 40);
        assert_eq!(psnr(&a, &b, Some(&nothing)), Err(MetricsError::EmptyMask));
        assert_eq!(ssim(&a, &b, Some(&nothing)), Err(MetricsError::EmptyMask));
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused() {
        let (a, b) = (RgbImage::new(20, 20), RgbImage::new(20, 21));
        assert_eq!(psnr(&a, &b, None), Err(MetricsError::SizesDiffer(20, 20, 20, 21)));
        let tiny = RgbImage::new(10, 20);
        assert_eq!(
            ssim(&tiny, &tiny, None),
            Err(MetricsError::TooSmall { width: 10, height: 20, needed: 11 })
        );
        assert!(psnr(&RgbImage::new(0, 0), &RgbImage::new(0, 0), None).is_err());
    }
}
