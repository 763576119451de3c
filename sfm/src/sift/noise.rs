//! How strong a response must be, told by the image itself: its range of brightness and its noise.

use super::blur::LumaPlane;
use super::pyramid::NOMINAL_BLUR;

/// Side of the blocks whose noise is looked at, pixels.
/// Source: measured: see `spread`, with which both were halved and doubled.
const BLOCK: usize = 16;
/// Share of the blocks that are assumed to hold nothing but noise at the finest scale.
/// Source: measured: see `spread`, with which both were halved and doubled.
const QUIET_SHARE: f64 = 0.1;

/// What thresholds are made from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ImageStatistics {
    /// Difference of the 0.999 and 0.001 quantiles of brightness.
    pub range: f32,
    /// Standard deviation of the noise of a pixel.
    pub noise: f32,
    /// Standard deviation of the blur that was given to the image after its noise was measured,
    /// pixels.
    pub pre_blur: f32,
}

impl ImageStatistics {
    /// Of the pixels for which `keep(x, y)` holds.
    pub(super) fn measure(image: &LumaPlane, keep: impl Fn(usize, usize) -> bool) -> Self {
        Self { range: brightness_range(image, &keep), noise: noise_sigma(image, &keep), pre_blur: 0.0 }
    }

    /// Standard deviation that the noise has in a difference of Gaussians of blurs `fine` and
    /// `coarse` (pixels of the image): the image's own blur is no filter, so it is taken off,
    /// `pre_blur` is one, and for white noise `‖G_a − G_b‖² = (1/a² + 1/b² − 4/(a² + b²)) / 4π`.
    pub(super) fn dog_noise(&self, fine: f32, coarse: f32) -> f32 {
        let own = NOMINAL_BLUR * NOMINAL_BLUR;
        let before = self.pre_blur * self.pre_blur;
        let a = (fine * fine - own).max(0.05) + before;
        let b = (coarse * coarse - own).max(0.05) + before;
        let power = (1.0 / a + 1.0 / b - 4.0 / (a + b)) / (4.0 * std::f32::consts::PI);
        self.noise * power.max(0.0).sqrt()
    }
}

/// Spread between the 0.001 and 0.999 quantiles, from a histogram of 4096 bins over [0, 1].
fn brightness_range(image: &LumaPlane, keep: &impl Fn(usize, usize) -> bool) -> f32 {
    /// Source: derived: a sixteenth of a grey level of eight bits.
    const BINS: usize = 16 * 256;
    let mut histogram = vec![0_u32; BINS];
    let mut total = 0_u32;
    let stride = 1 + image.data.len() / 4_000_000; // quantiles of a big image need no more than that
    for y in (0..image.height).step_by(stride) {
        for (x, v) in image.row(y).iter().enumerate() {
            if keep(x, y) {
                histogram[((v.clamp(0.0, 1.0) * BINS as f32) as usize).min(BINS - 1)] += 1;
                total += 1;
            }
        }
    }
    let [low, high] = [0.001, 0.999].map(|share| {
        let wanted = (share * f64::from(total)) as u32;
        let mut seen = 0;
        let bin = histogram.iter().position(|&n| {
            seen += n;
            seen > wanted
        });
        bin.unwrap_or(0) as f32 / BINS as f32
    });
    high - low
}

/// Noise from the diagonal second difference `(a − b − c + d) / 2` of 2×2 pixels (the finest Haar
/// detail, Donoho 1995), block by block; the quietest blocks are those without texture. Clipped
/// pixels (0 or 1) say nothing of noise.
fn noise_sigma(image: &LumaPlane, keep: &impl Fn(usize, usize) -> bool) -> f32 {
    let mut blocks = Vec::new();
    for by in 0..image.height / BLOCK {
        for bx in 0..image.width / BLOCK {
            if !keep(bx * BLOCK + BLOCK / 2, by * BLOCK + BLOCK / 2) {
                continue;
            }
            let (mut sum, mut count) = (0.0_f32, 0_u32);
            for y in by * BLOCK..(by + 1) * BLOCK - 1 {
                let x = bx * BLOCK..(bx + 1) * BLOCK;
                let (above, below) = (&image.row(y)[x.clone()], &image.row(y + 1)[x]);
                for (a, b) in above.windows(2).zip(below.windows(2)) {
                    let (low, high) =
                        (a[0].min(a[1]).min(b[0]).min(b[1]), a[0].max(a[1]).max(b[0]).max(b[1]));
                    if low > 0.0 && high < 1.0 {
                        sum += (a[0] - a[1] - b[0] + b[1]).abs() / 2.0;
                        count += 1;
                    }
                }
            }
            if count as usize > BLOCK * BLOCK / 2 {
                // The mean of |N(0, σ)| is σ √(2/π).
                blocks.push(sum / count as f32 * (std::f32::consts::PI / 2.0).sqrt());
            }
        }
    }
    let quiet = (blocks.len() as f64 * QUIET_SHARE) as usize;
    let sigma = if blocks.is_empty() { 0.0 } else { *blocks.select_nth_unstable_by(quiet, f32::total_cmp).1 };
    // Rounding three channels to 8 bits leaves √(0.299² + 0.587² + 0.114²) / (255 √12) in luma.
    sigma.max(0.669 / (255.0 * 12.0_f32.sqrt()))
}
