//! loss: `(1 − λ) mean|C − G| + λ (1 − SSIM)` and its gradient dL/dC.
//! in: colour and target as \[3\] planes (rows padded to whole tiles), optional weights. out:
//! gradient planes, loss, squared error.
//!
//! SSIM: Wang et al. 2004, 11 × 11 Gaussian window with σ = 1.5, zero padding, per channel. The
//! window is separable; gradients go back through the same (symmetric) window. Lines are filtered
//! down first, which reads the planes where they lie and several lines at once, then across; a
//! band's derivatives of SSIM stay in the second-level cache.

use super::dispatch::{Isa, simd_kernel};
use super::simd::Simd;
use super::tile::PlaneShape;
use crate::model::LANE_PAD;
use rayon::prelude::*;
use scene::metrics::{SSIM_K, SSIM_REACH, SSIM_SIGMA, SSIM_WINDOW};
use std::cell::RefCell;

/// Rows a task works on. The derivatives of the ten rows around them are worked out by their
/// neighbours too. Source: chosen by hand, never measured.
pub(super) const BAND: usize = 64;
/// Most rows that are filtered at once. Source: four sums each fill the 32 registers of AVX-512 and
/// NEON.
const ROWS: usize = 4;

/// The window's weights, exp(−x² / (2 · 1.5²)) normalised, between `ROWS − 1` zeros.
fn window() -> [f32; SSIM_WINDOW + 2 * (ROWS - 1)] {
    let spread = 2.0 * SSIM_SIGMA * SSIM_SIGMA;
    let raw: [f64; SSIM_WINDOW] =
        std::array::from_fn(|i| (-(i as f64 - SSIM_REACH as f64).powi(2) / spread).exp());
    let sum: f64 = raw.iter().sum();
    let mut padded = [0.0; SSIM_WINDOW + 2 * (ROWS - 1)];
    for (tap, w) in padded[ROWS - 1..].iter_mut().zip(raw) {
        *tap = (w / sum) as f32;
    }
    padded
}

/// Values of a bordered line.
fn bordered(shape: &PlaneShape) -> usize {
    shape.stride() + 2 * LANE_PAD
}

/// Result of the loss.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct LossValue {
    /// The loss.
    pub(crate) loss: f32,
    /// Mean squared error.
    pub(crate) mse: f32,
}

/// What the loss compares.
pub(crate) struct LossInput<'a> {
    /// Size.
    pub(crate) shape: PlaneShape,
    /// Rendered colour.
    pub(crate) rgb: &'a [Vec<f32>; 3],
    /// What it should be.
    pub(crate) target: &'a [Vec<f32>; 3],
    /// Weight of each pixel; all 1 if missing. Pixels of weight 0 must have equal colour and
    /// target.
    pub(crate) weight: Option<&'a [f32]>,
    /// λ.
    pub(crate) lambda: f32,
}

thread_local! {
    static LINES: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
}

/// The loss; fills `gradient` (planes like `rgb`, zero outside the image). `parts` is scratch
/// space, kept by the caller. Every plane must have the size that the shape says.
pub(crate) fn loss(
    isa: Isa,
    input: &LossInput,
    gradient: &mut [Vec<f32>; 3],
    parts: &mut Vec<[f64; 3]>,
) -> LossValue {
    let shape = input.shape;
    let planes = input.rgb.iter().chain(input.target).chain(&*gradient).map(Vec::as_slice);
    for plane in planes.chain(input.weight) {
        assert_eq!(plane.len(), shape.plane(), "a plane is not of the image's size");
    }
    let count = match input.weight {
        Some(w) => rows(&shape).map(|r| w[r].iter().map(|&v| f64::from(v)).sum::<f64>()).sum::<f64>(),
        None => (shape.width * shape.height) as f64,
    };
    let scale = if count > 0.0 { (1.0 / (3.0 * count)) as f32 } else { 0.0 };
    let window = window();
    let bands = shape.height.div_ceil(BAND);
    parts.clear();
    parts.resize(3 * bands, [0.0; 3]);
    let planes = gradient.par_iter_mut().zip(parts.par_chunks_mut(bands.max(1))).enumerate();
    planes.for_each(|(channel, (plane, parts))| {
        let bands = plane.par_chunks_mut(shape.stride().max(1) * BAND).zip(parts).enumerate();
        bands.for_each(|(b, (out, part))| {
            let y0 = b * BAND;
            let mut a = Band { input, channel, y0, window: &window, scale, out, ssim: 0.0, l1: 0.0, l2: 0.0 };
            band(isa, &mut a);
            *part = [a.ssim, a.l1, a.l2];
        });
    });
    let sums = parts.iter().fold([0.0; 3], |s, p| [s[0] + p[0], s[1] + p[1], s[2] + p[2]]);
    let [ssim, l1, l2] = sums.map(|sum: f64| if count > 0.0 { sum / (3.0 * count) } else { 0.0 });
    let lambda = f64::from(input.lambda);
    let d_ssim = if count > 0.0 && input.lambda > 0.0 { 1.0 - ssim } else { 0.0 };
    LossValue { loss: ((1.0 - lambda) * l1 + lambda * d_ssim) as f32, mse: l2 as f32 }
}

fn rows(shape: &PlaneShape) -> impl Iterator<Item = std::ops::Range<usize>> + use<> {
    let (stride, width) = (shape.stride(), shape.width);
    (0..shape.height).map(move |y| y * stride..y * stride + width)
}

/// `BAND` rows of one channel.
struct Band<'a> {
    input: &'a LossInput<'a>,
    channel: usize,
    y0: usize,
    window: &'a [f32; SSIM_WINDOW + 2 * (ROWS - 1)],
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
    let (line, stride) = (bordered(&shape), shape.stride());
    let y1 = (a.y0 + BAND).min(shape.height);
    let around = a.y0.saturating_sub(SSIM_REACH)..(y1 + SSIM_REACH).min(shape.height);
    let mut buffer = LINES.take();
    let size = 4 * R * line + 3 * (BAND + 2 * SSIM_REACH) * stride + LANE_PAD;
    if buffer.len() < size {
        buffer.resize(size, 0.0);
    }
    // Loads that straddle cache lines cost twice.
    let aligned = buffer.as_ptr().align_offset(64).min(LANE_PAD);
    let (lines, maps) = buffer[aligned..].split_at_mut(4 * R * line);
    for line in lines.chunks_exact_mut(line) {
        line[..LANE_PAD].fill(0.0);
        line[LANE_PAD + stride..].fill(0.0);
    }
    let dissimilar = a.input.lambda > 0.0;
    if !dissimilar {
        lines.fill(0.0);
    }
    let mut across = [S::splat(0.0); SSIM_REACH + 1];
    for (tap, &w) in across.iter_mut().zip(&a.window[ROWS - 1..]) {
        *tap = S::splat(w);
    }
    if dissimilar {
        for y in around.clone().step_by(R) {
            moments_down::<S, R>(a, y, lines);
            for (j, moments) in lines.chunks_exact(4 * line).enumerate().take(around.end - y) {
                let out = &mut maps[(y + j - around.start) * 3 * stride..][..3 * stride];
                similarity_line::<S>(a, y + j, moments, out, &across);
            }
        }
    }
    a.out.fill(0.0);
    for y in (a.y0..y1).step_by(R) {
        if dissimilar {
            derivatives_down::<S, R>(a, y, &around, maps, lines);
        }
        for (j, derivatives) in lines.chunks_exact(4 * line).enumerate().take(y1 - y) {
            gradient_line::<S>(a, y + j, derivatives, &across);
        }
    }
    LINES.set(buffer);
}

/// Σ w_k line[x + k − 5] of a bordered line; `w` are the window's first half and its middle.
#[inline(always)]
fn across<S: Simd>(line: &[f32], x: usize, w: &[S; SSIM_REACH + 1]) -> S {
    let taps = &line[LANE_PAD + x - SSIM_REACH..LANE_PAD + x + SSIM_REACH + S::LANES];
    let mut sum = S::read(&taps[SSIM_REACH..]).mul(w[SSIM_REACH]);
    for (k, &tap) in w[..SSIM_REACH].iter().enumerate() {
        sum = S::read(&taps[k..]).add(S::read(&taps[2 * SSIM_REACH - k..])).fma(tap, sum);
    }
    sum
}

/// The window's weights of row `r` for the output rows from `y` on, last one first; 0 where it is
/// out of reach.
#[inline(always)]
fn taps<'a, const R: usize>(a: &Band<'a>, r: usize, y: usize) -> &'a [f32] {
    &a.window[ROWS + r + SSIM_REACH - y - R..][..R]
}

/// Lines `y` to `y + R` of colour, target, the sum of their squares and their product, filtered
/// down: four bordered lines each.
#[inline(always)]
fn moments_down<S: Simd, const R: usize>(a: &Band, y: usize, out: &mut [f32]) {
    let shape = a.input.shape;
    let (line, stride) = (bordered(&shape), shape.stride());
    let rows = y.saturating_sub(SSIM_REACH)..(y + R + SSIM_REACH).min(shape.height);
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
            let (x, t) = (S::read(&rgb[r * stride + i..]), S::read(&target[r * stride + i..]));
            let (squares, product) = (x.fma(x, t.mul(t)), x.mul(t));
            for (e, &tap) in e.iter_mut().zip(taps::<R>(a, r, y).iter().rev()) {
                let tap = S::splat(tap);
                e[0] = x.fma(tap, e[0]);
                e[1] = t.fma(tap, e[1]);
                e[2] = squares.fma(tap, e[2]);
                e[3] = product.fma(tap, e[3]);
            }
        }
        for (e, lines) in e.iter().zip(out.chunks_exact_mut(4 * line)) {
            for (e, line) in e.iter().zip(lines.chunks_exact_mut(line)) {
                e.keep(inside).write(&mut line[LANE_PAD + i..]);
            }
        }
    }
}

/// SSIM of line `y` and its derivatives by E[x], E[x² + y²] and E[xy], three lines of `out`.
#[inline(always)]
fn similarity_line<S: Simd>(
    a: &mut Band,
    y: usize,
    moments: &[f32],
    out: &mut [f32],
    w: &[S; SSIM_REACH + 1],
) {
    let shape = a.input.shape;
    let (line, stride, width) = (bordered(&shape), shape.stride(), shape.width);
    let [c1, c2] = SSIM_K.map(|k| S::splat((k * k) as f32));
    let (one, two) = (S::splat(1.0), S::splat(2.0));
    let mut sum = S::splat(0.0);
    let (x_line, rest) = moments.split_at(line);
    let (y_line, rest) = rest.split_at(line);
    let (square_line, product_line) = rest.split_at(line);
    let (by_mean_line, rest) = out.split_at_mut(stride);
    let (by_square_line, by_product_line) = rest.split_at_mut(stride);
    for i in (0..stride).step_by(S::LANES) {
        let (mx, my) = (across(x_line, i, w), across(y_line, i, w));
        let (squares, product) = (across(square_line, i, w), across(product_line, i, w));
        let means = mx.mul(my);
        let mean_squares = mx.fma(mx, my.mul(my));
        let (a1, b1) = (means.fma(two, c1), mean_squares.add(c1));
        let (a2, b2) = (product.sub(means).fma(two, c2), squares.sub(mean_squares).add(c2));
        let inverse = one.div(b1.mul(b2));
        let ssim = a1.mul(a2).mul(inverse);
        let mut weight = S::splat((width as f32) - i as f32).sub(S::iota()).max(S::splat(0.0)).min(one);
        if let Some(plane) = a.input.weight {
            weight = weight.mul(S::read(&plane[y * stride + i..]));
        }
        sum = ssim.fma(weight, sum);
        let by_square = S::splat(0.0).sub(ssim.mul(b1).mul(inverse));
        let by_product = two.mul(a1).mul(inverse);
        // d/dmx: through A1, A2, B1 and B2 (1 / B1 = B2 · inverse).
        let cross = two.mul(my).mul(a2.sub(a1)).mul(inverse);
        let own = two.mul(mx).mul(ssim).mul(b1.sub(b2)).mul(inverse);
        cross.add(own).mul(weight).write(&mut by_mean_line[i..]);
        by_square.mul(weight).write(&mut by_square_line[i..]);
        by_product.mul(weight).write(&mut by_product_line[i..]);
    }
    if (a.y0..a.y0 + BAND).contains(&y) {
        a.ssim += f64::from(sum.sum());
    }
}

/// Lines `y` to `y + R` of the derivatives, filtered down: three of four bordered lines each.
#[inline(always)]
fn derivatives_down<S: Simd, const R: usize>(
    a: &Band,
    y: usize,
    around: &std::ops::Range<usize>,
    maps: &[f32],
    out: &mut [f32],
) {
    let (line, stride) = (bordered(&a.input.shape), a.input.shape.stride());
    let rows = y.saturating_sub(SSIM_REACH)..(y + R + SSIM_REACH).min(around.end);
    for i in (0..stride).step_by(S::LANES) {
        let mut e = [[S::splat(0.0); 3]; R];
        for r in rows.clone() {
            let maps = &maps[(r - around.start) * 3 * stride..][..3 * stride];
            let m = [S::read(&maps[i..]), S::read(&maps[stride + i..]), S::read(&maps[2 * stride + i..])];
            for (e, &tap) in e.iter_mut().zip(taps::<R>(a, r, y).iter().rev()) {
                let tap = S::splat(tap);
                for (e, m) in e.iter_mut().zip(m) {
                    *e = m.fma(tap, *e);
                }
            }
        }
        for (e, lines) in e.iter().zip(out.chunks_exact_mut(4 * line)) {
            for (e, line) in e.iter().zip(lines.chunks_exact_mut(line)) {
                e.write(&mut line[LANE_PAD + i..]);
            }
        }
    }
}

/// The gradient of line `y` from the derivatives' lines, and the line's part of the sums.
#[inline(always)]
fn gradient_line<S: Simd>(a: &mut Band, y: usize, derivatives: &[f32], w: &[S; SSIM_REACH + 1]) {
    let shape = a.input.shape;
    let (line, stride, width) = (bordered(&shape), shape.stride(), shape.width);
    let (zero, one, two) = (S::splat(0.0), S::splat(1.0), S::splat(2.0));
    let l1_scale = S::splat(a.scale * (1.0 - a.input.lambda));
    let ssim_scale = S::splat(-a.scale * a.input.lambda);
    let (mut l1, mut l2) = (zero, zero);
    let (by_mean_line, rest) = derivatives.split_at(line);
    let (by_square_line, by_product_line) = rest.split_at(line);
    let row = y * stride..(y + 1) * stride;
    let (rgb, target) = (&a.input.rgb[a.channel][row.clone()], &a.input.target[a.channel][row]);
    let out = &mut a.out[(y - a.y0) * stride..][..stride];
    for i in (0..stride).step_by(S::LANES) {
        let (x, t) = (S::read(&rgb[i..]), S::read(&target[i..]));
        let inside = S::splat((width as f32) - i as f32).sub(S::iota()).max(zero).min(one);
        let weight = match a.input.weight {
            Some(plane) => inside.mul(S::read(&plane[y * stride + i..])),
            None => inside,
        };
        let by_mean = across(by_mean_line, i, w);
        let by_square = across(by_square_line, i, w);
        let by_product = across(by_product_line, i, w);
        let ssim = by_mean.add(two.mul(x).mul(by_square)).add(t.mul(by_product));
        let difference = x.sub(t);
        l1 = difference.abs().fma(weight, l1);
        l2 = difference.mul(difference).fma(weight, l2);
        let sign = S::select(difference.lt(zero), zero.sub(one), one.keep(zero.lt(difference)));
        // The maps carry the weights of the windows' centres; the pixel's own only says whether it
        // counts.
        let g = sign.mul(l1_scale).mul(weight).add(ssim.mul(ssim_scale).keep(zero.lt(weight)));
        g.write(&mut out[i..]);
    }
    a.l1 += f64::from(l1.sum());
    a.l2 += f64::from(l2.sum());
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Planes of an image of 40 × 30 pixels, one of them or the weights too short.
    fn short(which: usize) {
        let shape = PlaneShape { width: 40, height: 30 };
        let length = |k: usize| shape.plane() - usize::from(k == which) * shape.stride();
        let planes = |first: usize| std::array::from_fn(|c| vec![0.5; length(first + c)]);
        let (rgb, target, mut gradient) = (planes(0), planes(3), planes(6));
        let weight = vec![1.0; shape.plane() - usize::from(which == 9) * 3 * shape.stride()];
        let input = LossInput { shape, rgb: &rgb, target: &target, weight: Some(&weight), lambda: 0.2 };
        loss(Isa::best(), &input, &mut gradient, &mut Vec::new());
    }

    #[test]
    fn planes_that_are_too_short_are_refused_before_they_are_read() {
        short(usize::MAX);
        for which in 0..10 {
            assert!(std::panic::catch_unwind(|| short(which)).is_err(), "plane {which}");
        }
    }
}
