//! loss: `(1 − λ) mean|C − G| + λ (1 − SSIM)` and its gradient dL/dC.
//! in: colour and target as \[3\] planes (rows padded to whole tiles), optional weights. out: gradient planes, loss, squared error.
//!
//! SSIM: Wang et al. 2004, 11 × 11 Gaussian window with σ = 1.5, zero padding, per channel. The window is separable;
//! gradients go back through the same (symmetric) window. Lines are filtered down first, which reads the planes where they
//! lie and several lines at once, then across; a band's derivatives of SSIM stay in the second-level cache.

use super::sort::TILE;
use super::rasterise::Tile;
use super::simd::{Isa, Simd, simd_kernel};
use rayon::prelude::*;
use std::cell::RefCell;

const C1: f32 = 0.0001;
const C2: f32 = 0.0009;
/// Reach of the window, pixels.
pub const RADIUS: usize = 5;
const TAPS: usize = 11;
/// Zeros on both sides of a line.
const BORDER: usize = 16;
/// Rows a task works on. The derivatives of the ten rows around them are worked out by their neighbours too.
const BAND: usize = 64;
/// Most rows that are filtered at once.
const ROWS: usize = 4;

/// The window's weights, exp(−x² / (2 · 1.5²)) normalised, between `ROWS − 1` zeros.
fn window() -> [f32; TAPS + 2 * (ROWS - 1)] {
    let raw: [f64; TAPS] = std::array::from_fn(|i| (-(i as f64 - RADIUS as f64).powi(2) / 4.5).exp());
    let sum: f64 = raw.iter().sum();
    let mut padded = [0.0; TAPS + 2 * (ROWS - 1)];
    for (tap, w) in padded[ROWS - 1..].iter_mut().zip(raw) {
        *tap = (w / sum) as f32;
    }
    padded
}

/// Size of an image whose planes are padded to whole tiles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Shape {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
}

impl Shape {
    /// Pixels from row to row.
    pub fn stride(&self) -> usize {
        self.width.div_ceil(TILE) * TILE
    }

    /// Pixels of a plane.
    pub fn plane(&self) -> usize {
        self.stride() * self.height.div_ceil(TILE) * TILE
    }

    /// Tile number `t`, row by row.
    pub fn tile(&self, t: usize) -> Tile {
        let tiles_x = self.stride() / TILE;
        let (x, y) = (t % tiles_x * TILE, t / tiles_x * TILE);
        Tile {
            x,
            y,
            width: TILE.min(self.width - x),
            height: TILE.min(self.height - y),
            stride: self.stride(),
        }
    }

    fn line(&self) -> usize {
        self.stride() + 2 * BORDER
    }
}

/// Result of the loss.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LossValue {
    /// The loss.
    pub loss: f32,
    /// Mean squared error.
    pub mse: f32,
}

/// What the loss compares.
pub struct LossInput<'a> {
    /// Size.
    pub shape: Shape,
    /// Rendered colour.
    pub rgb: &'a [Vec<f32>; 3],
    /// What it should be.
    pub target: &'a [Vec<f32>; 3],
    /// Weight of each pixel; all 1 if missing. Pixels of weight 0 must have equal colour and target.
    pub weight: Option<&'a [f32]>,
    /// λ.
    pub lambda: f32,
}

thread_local! {
    static LINES: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
}

/// The loss; fills `gradient` (planes like `rgb`, zero outside the image). `parts` is scratch space, kept by the caller.
pub fn loss(
    isa: Isa,
    input: &LossInput,
    gradient: &mut [Vec<f32>; 3],
    parts: &mut Vec<[f64; 3]>,
) -> LossValue {
    let shape = input.shape;
    let count = match input.weight {
        Some(w) => rows(&shape).map(|r| w[r].iter().map(|&v| f64::from(v)).sum::<f64>()).sum::<f64>(),
        None => (shape.width * shape.height) as f64,
    };
    let scale = if count > 0.0 { (1.0 / (3.0 * count)) as f32 } else { 0.0 };
    let window = window();
    let bands = shape.height.div_ceil(BAND);
    parts.clear();
    parts.resize(3 * bands, [0.0; 3]);
    let run = |channel: usize, (b, (out, part)): (usize, (&mut [f32], &mut [f64; 3]))| {
        let y0 = b * BAND;
        let mut a = Band { input, channel, y0, window: &window, scale, out, ssim: 0.0, l1: 0.0, l2: 0.0 };
        band(isa, &mut a);
        *part = [a.ssim, a.l1, a.l2];
    };
    let planes = gradient.par_iter_mut().zip(parts.par_chunks_mut(bands.max(1))).enumerate();
    planes.for_each(|(channel, (plane, parts))| {
        let lines = plane.par_chunks_mut(shape.stride() * BAND).zip(parts).enumerate();
        lines.for_each(|job| run(channel, job));
    });
    let [ssim, l1, l2] = parts.iter().fold([0.0; 3], |s, p| [s[0] + p[0], s[1] + p[1], s[2] + p[2]]);
    let mean = |sum: f64| if count > 0.0 { sum / (3.0 * count) } else { 0.0 };
    let lambda = f64::from(input.lambda);
    let d_ssim = if count > 0.0 && input.lambda > 0.0 { 1.0 - mean(ssim) } else { 0.0 };
    LossValue { loss: ((1.0 - lambda) * mean(l1) + lambda * d_ssim) as f32, mse: mean(l2) as f32 }
}

fn rows(shape: &Shape) -> impl Iterator<Item = std::ops::Range<usize>> + use<> {
    let (stride, width) = (shape.stride(), shape.width);
    (0..shape.height).map(move |y| y * stride..y * stride + width)
}

/// `BAND` rows of one channel.
struct Band<'a> {
    input: &'a LossInput<'a>,
    channel: usize,
    y0: usize,
    window: &'a [f32; TAPS + 2 * (ROWS - 1)],
    scale: f32,
    /// The gradient's rows.
    out: &'a mut [f32],
    ssim: f64,
    l1: f64,
    l2: f64,
}

simd_kernel!(fn band(arguments: &mut Band) = band_generic);

#[inline(always)]
fn band_generic<S: Simd>(a: &mut Band) {
    // Four sums a row have to fit into the registers: 16 of AVX2, 32 of AVX-512 and NEON.
    if S::LANES == 8 { band_of::<S, 2>(a) } else { band_of::<S, ROWS>(a) }
}

#[inline(always)]
fn band_of<S: Simd, const R: usize>(a: &mut Band) {
    let shape = a.input.shape;
    let (line, stride) = (shape.line(), shape.stride());
    let y1 = (a.y0 + BAND).min(shape.height);
    let around = a.y0.saturating_sub(RADIUS)..(y1 + RADIUS).min(shape.height);
    let mut buffer = LINES.take();
    let size = 4 * R * line + 3 * (BAND + 2 * RADIUS) * stride + BORDER;
    if buffer.len() < size {
        buffer.resize(size, 0.0);
    }
    // Loads that straddle cache lines cost twice.
    let aligned = buffer.as_ptr().align_offset(64).min(BORDER);
    let (lines, maps) = buffer[aligned..].split_at_mut(4 * R * line);
    for line in lines.chunks_exact_mut(line) {
        line[..BORDER].fill(0.0);
        line[BORDER + stride..].fill(0.0);
    }
    let dissimilar = a.input.lambda > 0.0;
    if !dissimilar {
        lines.fill(0.0);
    }
    let mut across = [S::splat(0.0); RADIUS + 1];
    for (tap, &w) in across.iter_mut().zip(&a.window[ROWS - 1..]) {
        *tap = S::splat(w);
    }
    if dissimilar {
        for y in around.clone().step_by(R) {
            unsafe { moments_down::<S, R>(a, y, lines) };
            for j in 0..R.min(around.end - y) {
                let out = &mut maps[(y + j - around.start) * 3 * stride..][..3 * stride];
                unsafe {
                    similarity_line::<S>(a, y + j, &lines[4 * j * line..4 * (j + 1) * line], out, &across)
                };
            }
        }
    }
    a.out.fill(0.0);
    for y in (a.y0..y1).step_by(R) {
        if dissimilar {
            unsafe { derivatives_down::<S, R>(a, y, &around, maps, lines) };
        }
        for j in 0..R.min(y1 - y) {
            unsafe { gradient_line::<S>(a, y + j, &lines[4 * j * line..4 * (j + 1) * line], &across) };
        }
    }
    LINES.set(buffer);
}

/// Σ w_k src[x + k − 5]; `src` points to a bordered line's first pixel, `w` are the window's first half and its middle.
/// # Safety
/// The line has at least 5 values before `src` and 5 + LANES after `src + x`.
#[inline(always)]
unsafe fn across<S: Simd>(src: *const f32, x: usize, w: &[S; RADIUS + 1]) -> S {
    unsafe {
        let first = src.add(x).sub(RADIUS);
        let mut sum = S::load(first.add(RADIUS)).mul(w[RADIUS]);
        for (k, &tap) in w[..RADIUS].iter().enumerate() {
            sum = S::load(first.add(k)).add(S::load(first.add(2 * RADIUS - k))).fma(tap, sum);
        }
        sum
    }
}

/// Lines `y` to `y + R` of colour, target, the sum of their squares and their product, filtered down: four bordered lines each.
#[inline(always)]
unsafe fn moments_down<S: Simd, const R: usize>(a: &Band, y: usize, out: &mut [f32]) {
    let shape = a.input.shape;
    let (line, stride) = (shape.line(), shape.stride());
    let rows = y.saturating_sub(RADIUS)..(y + R + RADIUS).min(shape.height);
    let (rgb, target) = (&a.input.rgb[a.channel], &a.input.target[a.channel]);
    for i in (0..stride).step_by(S::LANES) {
        let inside = S::iota().lt(S::splat(shape.width as f32 - i as f32));
        let mut e = [[S::splat(0.0); 4]; R];
        // What the next lines add to these.
        for r in (rows.end..rows.end + R).take_while(|&r| r < shape.height) {
            S::prefetch(rgb.as_ptr().wrapping_add(r * stride + i).cast());
            S::prefetch(target.as_ptr().wrapping_add(r * stride + i).cast());
        }
        for r in rows.clone() {
            unsafe {
                let (x, t) =
                    (S::load(rgb.as_ptr().add(r * stride + i)), S::load(target.as_ptr().add(r * stride + i)));
                let (squares, product) = (x.fma(x, t.mul(t)), x.mul(t));
                // The weight of row r for output row y + j; 0 where it is out of reach.
                let tap = a.window.as_ptr().add(ROWS - 1 + r + RADIUS - y);
                for (j, e) in e.iter_mut().enumerate() {
                    let tap = S::splat(*tap.sub(j));
                    e[0] = x.fma(tap, e[0]);
                    e[1] = t.fma(tap, e[1]);
                    e[2] = squares.fma(tap, e[2]);
                    e[3] = product.fma(tap, e[3]);
                }
            }
        }
        for (j, e) in e.iter().enumerate() {
            for (map, e) in e.iter().enumerate() {
                unsafe { e.keep(inside).store(out.as_mut_ptr().add((4 * j + map) * line + BORDER + i)) };
            }
        }
    }
}

/// SSIM of line `y` and its derivatives by E[x], E[x² + y²] and E[xy], three lines of `out`.
#[inline(always)]
unsafe fn similarity_line<S: Simd>(
    a: &mut Band,
    y: usize,
    moments: &[f32],
    out: &mut [f32],
    w: &[S; RADIUS + 1],
) {
    let shape = a.input.shape;
    let (line, stride, width) = (shape.line(), shape.stride(), shape.width);
    let (c1, c2, one, two) = (S::splat(C1), S::splat(C2), S::splat(1.0), S::splat(2.0));
    let mut sum = S::splat(0.0);
    let out = out.as_mut_ptr();
    for i in (0..stride).step_by(S::LANES) {
        unsafe {
            let p = moments.as_ptr().add(BORDER);
            let (mx, my) = (across(p, i, w), across(p.add(line), i, w));
            let (squares, product) = (across(p.add(2 * line), i, w), across(p.add(3 * line), i, w));
            let means = mx.mul(my);
            let mean_squares = mx.fma(mx, my.mul(my));
            let (a1, b1) = (means.fma(two, c1), mean_squares.add(c1));
            let (a2, b2) = (product.sub(means).fma(two, c2), squares.sub(mean_squares).add(c2));
            let inverse = one.div(b1.mul(b2));
            let ssim = a1.mul(a2).mul(inverse);
            let mut weight = S::splat((width as f32) - i as f32).sub(S::iota()).max(S::splat(0.0)).min(one);
            if let Some(plane) = a.input.weight {
                weight = weight.mul(S::load(plane.as_ptr().add(y * stride + i)));
            }
            sum = ssim.fma(weight, sum);
            let by_square = S::splat(0.0).sub(ssim.mul(b1).mul(inverse));
            let by_product = two.mul(a1).mul(inverse);
            // d/dmx: through A1, A2, B1 and B2 (1 / B1 = B2 · inverse).
            let cross = two.mul(my).mul(a2.sub(a1)).mul(inverse);
            let own = two.mul(mx).mul(ssim).mul(b1.sub(b2)).mul(inverse);
            cross.add(own).mul(weight).store(out.add(i));
            by_square.mul(weight).store(out.add(stride + i));
            by_product.mul(weight).store(out.add(2 * stride + i));
        }
    }
    if (a.y0..a.y0 + BAND).contains(&y) {
        a.ssim += f64::from(sum.sum());
    }
}

/// Lines `y` to `y + R` of the derivatives, filtered down: three of four bordered lines each.
#[inline(always)]
unsafe fn derivatives_down<S: Simd, const R: usize>(
    a: &Band,
    y: usize,
    around: &std::ops::Range<usize>,
    maps: &[f32],
    out: &mut [f32],
) {
    let (line, stride) = (a.input.shape.line(), a.input.shape.stride());
    let rows = y.saturating_sub(RADIUS)..(y + R + RADIUS).min(around.end);
    for i in (0..stride).step_by(S::LANES) {
        let mut e = [[S::splat(0.0); 3]; R];
        for r in rows.clone() {
            unsafe {
                let p = maps.as_ptr().add((r - around.start) * 3 * stride + i);
                let m = [S::load(p), S::load(p.add(stride)), S::load(p.add(2 * stride))];
                let tap = a.window.as_ptr().add(ROWS - 1 + r + RADIUS - y);
                for (j, e) in e.iter_mut().enumerate() {
                    let tap = S::splat(*tap.sub(j));
                    for (e, m) in e.iter_mut().zip(m) {
                        *e = m.fma(tap, *e);
                    }
                }
            }
        }
        for (j, e) in e.iter().enumerate() {
            for (map, e) in e.iter().enumerate() {
                unsafe { e.store(out.as_mut_ptr().add((4 * j + map) * line + BORDER + i)) };
            }
        }
    }
}

#[inline(always)]
unsafe fn gradient_line<S: Simd>(a: &mut Band, y: usize, buffer: &[f32], w: &[S; RADIUS + 1]) {
    let shape = a.input.shape;
    let (line, stride, width) = (shape.line(), shape.stride(), shape.width);
    let (zero, one, two) = (S::splat(0.0), S::splat(1.0), S::splat(2.0));
    let l1_scale = S::splat(a.scale * (1.0 - a.input.lambda));
    let ssim_scale = S::splat(-a.scale * a.input.lambda);
    let (mut l1, mut l2) = (zero, zero);
    for i in (0..stride).step_by(S::LANES) {
        unsafe {
            let at = y * stride + i;
            let x = S::load(a.input.rgb[a.channel].as_ptr().add(at));
            let t = S::load(a.input.target[a.channel].as_ptr().add(at));
            let inside = S::splat((width as f32) - i as f32).sub(S::iota()).max(zero).min(one);
            let weight = match a.input.weight {
                Some(plane) => inside.mul(S::load(plane.as_ptr().add(at))),
                None => inside,
            };
            let p = buffer.as_ptr().add(BORDER);
            let by_mean = across(p, i, w);
            let by_square = across(p.add(line), i, w);
            let by_product = across(p.add(2 * line), i, w);
            let ssim = by_mean.add(two.mul(x).mul(by_square)).add(t.mul(by_product));
            let difference = x.sub(t);
            l1 = difference.abs().fma(weight, l1);
            l2 = difference.mul(difference).fma(weight, l2);
            let sign = S::select(difference.lt(zero), zero.sub(one), one.keep(zero.lt(difference)));
            // The maps carry the weights of the windows' centres; the pixel's own only says whether it counts.
            let g = sign.mul(l1_scale).mul(weight).add(ssim.mul(ssim_scale).keep(zero.lt(weight)));
            g.store(a.out.as_mut_ptr().add((y - a.y0) * stride + i));
        }
    }
    a.l1 += f64::from(l1.sum());
    a.l2 += f64::from(l2.sum());
}
