//! How alike the patch around a pixel looks in other views, were it on a plane.
//!
//! One minus the normalised cross-correlation; samples weigh less the more they differ in
//! brightness from the middle and the farther they are from it (the bilateral weights of
//! Schönberger et al., ECCV 2016, section 4.2), and nothing outside the mask. The variances have
//! the noise's added, so that a patch without contrast is like any other.

use crate::level::LevelImage;
use crate::pair::PixelMap;

/// Samples of a patch. Source: two vectors of the widest registers.
pub(crate) const SAMPLES: usize = 32;
/// Cost of a plane that the other view cannot see. Source: that of the opposite patch.
pub(crate) const WORST: f32 = 2.0;
/// Standard deviation of the weights in the picture, pixels. Source: the half side of the patch, as
/// Schönberger et al. have it.
const SIGMA_PX: f32 = 5.0;
/// Samples inside the mask, without which a patch says nothing. Source: docs/decisions/21.
const LEAST_SAMPLES: usize = 4;

/// Samples: every second pixel of 11 × 11 in each direction, without the corners. Source: the patch
/// of Schönberger et al.
const OFFSETS: [[i32; 2]; SAMPLES] = offsets();
const fn offsets() -> [[i32; 2]; SAMPLES] {
    let (mut all, mut n, mut i) = ([[0; 2]; SAMPLES], 0, 0);
    while i < 36 {
        let (x, y) = (2 * (i % 6) - 5, 2 * (i / 6) - 5);
        if x * x + y * y < 50 {
            all[n] = [x, y];
            n += 1;
        }
        i += 1;
    }
    all
}

/// The patch around a pixel.
pub(crate) struct Patch {
    /// Sum 1.
    weight: [f32; SAMPLES],
    /// Brightness less its mean, times the weight.
    centred: [f32; SAMPLES],
    /// Of the brightness, with the noise's.
    variance: f32,
    noise: f32,
}

impl Patch {
    /// Around a pixel of the mask; none where too little of it is inside.
    pub(crate) fn new(image: &LevelImage, x: usize, y: usize, sigma_grey: f32, noise: f32) -> Option<Self> {
        let middle = image.grey(y * image.width + x);
        let (mut grey, mut weight, mut count) = ([0.0; SAMPLES], [0.0; SAMPLES], 0);
        for (k, [dx, dy]) in OFFSETS.into_iter().enumerate() {
            let (u, v) = (x as i32 + dx, y as i32 + dy);
            if u < 0 || v < 0 || u as usize >= image.width || v as usize >= image.height {
                continue;
            }
            let i = v as usize * image.width + u as usize;
            if image.inside[i] {
                grey[k] = image.grey(i);
                let (off, away) = ((grey[k] - middle) / sigma_grey, (dx * dx + dy * dy) as f32);
                weight[k] = (-0.5 * (off * off + away / (SIGMA_PX * SIGMA_PX))).exp();
                count += 1;
            }
        }
        if count < LEAST_SAMPLES {
            return None;
        }
        let sum: f32 = weight.iter().sum();
        if !(sum > 0.0) {
            return None;
        }
        weight.iter_mut().for_each(|w| *w /= sum);
        let mean: f32 = weight.iter().zip(&grey).map(|(w, g)| w * g).sum();
        let centred: [f32; SAMPLES] = std::array::from_fn(|k| weight[k] * (grey[k] - mean));
        let variance: f32 = centred.iter().zip(&grey).map(|(c, g)| c * (g - mean)).sum();
        let noise = noise * noise;
        Some(Self { weight, centred, variance: variance + noise, noise })
    }
}

impl Patch {
    /// How much of the variance is the noise's: near 0 where there is texture, 1 where there is
    /// none.
    #[inline]
    pub(crate) fn blankness(&self) -> f32 {
        (BLANK * self.noise / self.variance).min(1.0)
    }
}

/// A view in which patches are looked for.
#[derive(Clone, Copy)]
pub(crate) struct Sight<'a> {
    pub(crate) image: &'a LevelImage,
    pub(crate) map: PixelMap,
}

/// A plane through the point that a pixel sees.
#[derive(Clone, Copy)]
pub(crate) struct PlaneAt {
    /// The pixel's middle.
    pub(crate) pixel: [f32; 2],
    /// Its depth.
    pub(crate) depth: f32,
    /// `nᵀ K⁻¹ / d`: times a pixel it is one over the depth there.
    pub(crate) row: [f32; 3],
}

scene::dispatch! {
    /// The cost of a plane in each view.
    pub(crate) fn costs(patch: &Patch, plane: &PlaneAt, sights: &[Sight], out: &mut [f32]) {
        for (sight, out) in sights.iter().zip(out) {
            *out = cost(patch, plane, sight);
        }
    }
}

#[inline(always)]
fn cost(patch: &Patch, plane: &PlaneAt, sight: &Sight) -> f32 {
    let (a, b, m) = (&sight.map.a, &sight.map.b, &plane.row);
    let (width, height) = (sight.image.width as f32, sight.image.height as f32);
    let ([u, v], z) = sight.map.apply(plane.pixel, plane.depth);
    if !(z > 0.0 && u >= 0.0 && v >= 0.0 && u < width && v < height) {
        return WORST;
    }
    // The homography at the pixel (divided by its depth there) and its steps.
    let w = 1.0 / plane.depth;
    let at = [u * z * w, v * z * w, z * w];
    let right = [a[0] + b[0] * m[0], a[3] + b[1] * m[0], a[6] + b[2] * m[0]];
    let down = [a[1] + b[0] * m[1], a[4] + b[1] * m[1], a[7] + b[2] * m[1]];
    let (mut index, mut fx, mut fy) = ([0_i32; SAMPLES], [0.0_f32; SAMPLES], [0.0_f32; SAMPLES]);
    let columns = sight.image.width as i32;
    for k in 0..SAMPLES {
        let [dx, dy] = [OFFSETS[k][0] as f32, OFFSETS[k][1] as f32];
        let inverse = 1.0 / (at[2] + dx * right[2] + dy * down[2]);
        let u = (at[0] + dx * right[0] + dy * down[0]) * inverse - 0.5;
        let v = (at[1] + dx * right[1] + dy * down[1]) * inverse - 0.5;
        let (u, v) = (u.max(0.0).min(width - 1.0), v.max(0.0).min(height - 1.0));
        let (i, j) = (u as i32, v as i32);
        fx[k] = u - i as f32;
        fy[k] = v - j as f32;
        index[k] = j * columns + i;
    }
    let packed: [u32; SAMPLES] = std::array::from_fn(|k| sight.image.packed[index[k] as usize]);
    let (mut mean, mut square, mut cross) = ([0.0_f32; LANES], [0.0_f32; LANES], [0.0_f32; LANES]);
    for half in 0..SAMPLES / LANES {
        for l in 0..LANES {
            let k = half * LANES + l;
            let p = packed[k];
            let (a, b) = ((p & 255) as f32, (p >> 8 & 255) as f32);
            let (c, d) = ((p >> 16 & 255) as f32, (p >> 24) as f32);
            let above = a + (b - a) * fx[k];
            let below = c + (d - c) * fx[k];
            let g = above + (below - above) * fy[k];
            let weighted = patch.weight[k] * g;
            mean[l] += weighted;
            square[l] += weighted * g;
            cross[l] += patch.centred[k] * g;
        }
    }
    let [mean, square, cross] = [sum(mean), sum(square), sum(cross)];
    let variance = (square - mean * mean).max(0.0) + patch.noise;
    1.0 - cross / (variance * patch.variance).sqrt()
}

/// A patch is blank if its variance is not more than so many times the noise's. Source:
/// docs/decisions/21.
const BLANK: f32 = 4.0;
/// Numbers that are added side by side. Source: [`SAMPLES`] are two of it.
const LANES: usize = 16;

#[inline(always)]
fn sum(mut v: [f32; LANES]) -> f32 {
    let mut half = LANES / 2;
    while half > 0 {
        for l in 0..half {
            v[l] += v[l + half];
        }
        half /= 2;
    }
    v[0]
}
