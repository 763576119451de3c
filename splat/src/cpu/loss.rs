//! loss: `(1 − λ) mean|C − G| + λ (1 − SSIM)` and its gradient dL/dC.
//! in: colour and target as \[3\] planes (rows padded to whole tiles), optional weights. out: gradient planes, loss, squared error.
//!
//! SSIM: Wang et al. 2004, 11 × 11 Gaussian window with σ = 1.5, zero padding, per channel. The window is separable;
//! gradients go back through the same (symmetric) window.

use super::bin::TILE;
use super::raster::Tile;
use super::simd::{Isa, Simd, array, simd_kernel};
use rayon::prelude::*;
use std::cell::RefCell;

const C1: f32 = 0.0001;
const C2: f32 = 0.0009;
const RADIUS: usize = 5;
const TAPS: usize = 11;
/// Zeros on both sides of a line.
const BORDER: usize = 16;
/// Rows a task works on.
const BAND: usize = 32;

/// The window's weights: exp(−x² / (2 · 1.5²)), normalised.
fn window() -> [f32; TAPS] {
    let raw: [f64; TAPS] = std::array::from_fn(|i| (-(i as f64 - RADIUS as f64).powi(2) / 4.5).exp());
    let sum: f64 = raw.iter().sum();
    raw.map(|w| (w / sum) as f32)
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

/// Buffers of the loss, kept between steps.
#[derive(Debug, Default)]
pub struct LossBuffers {
    /// Derivatives of SSIM by E[x], E[x² + y²], E[xy]: [channel × map] planes of bordered lines.
    maps: Vec<Vec<f32>>,
    window: [f32; TAPS],
    shape: Shape,
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

impl LossBuffers {
    /// The loss; fills `gradient` (planes like `rgb`, zero outside the image).
    pub fn run(&mut self, isa: Isa, input: &LossInput, gradient: &mut [Vec<f32>; 3]) -> LossValue {
        let shape = input.shape;
        if self.shape != shape {
            self.shape = shape;
            self.window = window();
            self.maps = vec![vec![0.0; shape.line() * shape.height]; 9];
        }
        let bands = shape.height.div_ceil(BAND);
        let count = match input.weight {
            Some(w) => rows(&shape).map(|r| w[r].iter().map(|&v| f64::from(v)).sum::<f64>()).sum::<f64>(),
            None => (shape.width * shape.height) as f64,
        };
        let scale = if count > 0.0 { (1.0 / (3.0 * count)) as f32 } else { 0.0 };
        let ssim: f64 = if input.lambda > 0.0 {
            let window = &self.window;
            let mut tasks: Vec<_> =
                self.maps.chunks_mut(3).enumerate().flat_map(|(c, maps)| split(c, maps, &shape)).collect();
            let partial: Vec<f64> = tasks
                .par_iter_mut()
                .map(|(channel, y0, maps)| {
                    let mut a = Statistics { input, channel: *channel, y0: *y0, maps, window, sum: 0.0 };
                    statistics(isa, &mut a);
                    a.sum
                })
                .collect();
            partial.iter().sum()
        } else {
            count * 3.0
        };
        let (maps, window) = (&self.maps, &self.window);
        let line = shape.stride() * BAND;
        let partial: Vec<[f64; 2]> = gradient
            .par_iter_mut()
            .enumerate()
            .flat_map(|(channel, plane)| {
                plane.par_chunks_mut(line).take(bands).enumerate().map(move |(b, out)| (channel, b, out))
            })
            .map(|(channel, band, out)| {
                let maps = &maps[channel * 3..channel * 3 + 3];
                let mut a =
                    Gradient { input, channel, y0: band * BAND, maps, window, scale, out, l1: 0.0, l2: 0.0 };
                gradient_rows(isa, &mut a);
                [a.l1, a.l2]
            })
            .collect();
        let [l1, l2] = partial.iter().fold([0.0, 0.0], |s, p| [s[0] + p[0], s[1] + p[1]]);
        let mean = |sum: f64| if count > 0.0 { sum / (3.0 * count) } else { 0.0 };
        let lambda = f64::from(input.lambda);
        let d_ssim = if count > 0.0 { 1.0 - mean(ssim) } else { 0.0 };
        LossValue { loss: ((1.0 - lambda) * mean(l1) + lambda * d_ssim) as f32, mse: mean(l2) as f32 }
    }
}

fn rows(shape: &Shape) -> impl Iterator<Item = std::ops::Range<usize>> + use<> {
    let (stride, width) = (shape.stride(), shape.width);
    (0..shape.height).map(move |y| y * stride..y * stride + width)
}

/// The bands of a channel's three map planes: (channel, first row, map rows).
fn split<'a>(
    channel: usize,
    maps: &'a mut [Vec<f32>],
    shape: &Shape,
) -> Vec<(usize, usize, [&'a mut [f32]; 3])> {
    let line = shape.line() * BAND;
    let [a, b, c] = maps else { return Vec::new() };
    let parts = a.chunks_mut(line).zip(b.chunks_mut(line)).zip(c.chunks_mut(line));
    parts.enumerate().map(|(band, ((a, b), c))| (channel, band * BAND, [a, b, c])).collect()
}

struct Statistics<'a, 'b> {
    input: &'a LossInput<'a>,
    channel: usize,
    y0: usize,
    maps: &'b mut [&'a mut [f32]; 3],
    window: &'a [f32; TAPS],
    sum: f64,
}

/// Σ w_k src[x + k − 5]; `src` points to a bordered line's first pixel.
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

#[inline(always)]
fn statistics_generic<S: Simd>(a: &mut Statistics) {
    let shape = a.input.shape;
    let (line, stride) = (shape.line(), shape.stride());
    let y1 = (a.y0 + BAND).min(shape.height);
    let (w, full) = taps::<S>(a.window);
    // Four bordered input lines (x, y, x² + y², xy), then a ring of 11 filtered lines for each.
    let mut buffer = LINES.take();
    buffer.clear();
    buffer.resize(line * 4 + stride * 4 * TAPS, 0.0);
    let (input, ring) = buffer.split_at_mut(line * 4);
    let mut next = a.y0.saturating_sub(RADIUS);
    for y in a.y0..y1 {
        while next <= (y + RADIUS).min(shape.height - 1) {
            let slot = next % TAPS * stride * 4;
            unsafe { filter_line::<S>(a, next, input, &mut ring[slot..slot + stride * 4], &w) };
            next += 1;
        }
        let first = y.saturating_sub(RADIUS);
        let last = (y + RADIUS).min(shape.height - 1);
        a.sum += unsafe { similarity_line::<S>(a, y, first..last + 1, ring, &full) };
    }
    LINES.set(buffer);
}

/// The window's first half and the whole, in every lane.
#[inline(always)]
fn taps<S: Simd>(window: &[f32; TAPS]) -> ([S; RADIUS + 1], [S; TAPS]) {
    let mut full = [S::splat(0.0); TAPS];
    for (tap, &w) in full.iter_mut().zip(window) {
        *tap = S::splat(w);
    }
    ([full[0], full[1], full[2], full[3], full[4], full[5]], full)
}

/// Filters line `y` of colour, target and their products across.
#[inline(always)]
unsafe fn filter_line<S: Simd>(
    a: &Statistics,
    y: usize,
    input: &mut [f32],
    out: &mut [f32],
    w: &[S; RADIUS + 1],
) {
    let shape = a.input.shape;
    let (line, stride, width) = (shape.line(), shape.stride(), shape.width);
    let row = y * stride..y * stride + width;
    let (x_row, y_row) = (&a.input.rgb[a.channel][row.clone()], &a.input.target[a.channel][row]);
    input[BORDER..BORDER + width].copy_from_slice(x_row);
    input[line + BORDER..line + BORDER + width].copy_from_slice(y_row);
    unsafe {
        let p = input.as_mut_ptr().add(BORDER);
        for i in (0..stride).step_by(S::LANES) {
            let (x, y) = (S::load(p.add(i)), S::load(p.add(line + i)));
            x.fma(x, y.mul(y)).store(p.add(2 * line + i));
            x.mul(y).store(p.add(3 * line + i));
        }
        for i in (0..stride).step_by(S::LANES) {
            for map in 0..4 {
                across(p.add(map * line), i, w).store(out.as_mut_ptr().add(map * stride + i));
            }
        }
    }
}

/// SSIM of line `y` and its derivatives; returns the (weighted) sum over the line.
#[inline(always)]
unsafe fn similarity_line<S: Simd>(
    a: &mut Statistics,
    y: usize,
    rows: std::ops::Range<usize>,
    ring: &[f32],
    w: &[S; TAPS],
) -> f64 {
    let shape = a.input.shape;
    let (line, stride, width) = (shape.line(), shape.stride(), shape.width);
    let (c1, c2, one, two) = (S::splat(C1), S::splat(C2), S::splat(1.0), S::splat(2.0));
    let mut sum = S::splat(0.0);
    let at = (y - a.y0) * line + BORDER;
    let out = array!(m in 3 => unsafe { a.maps[m].as_mut_ptr().add(at) });
    for i in (0..stride).step_by(S::LANES) {
        unsafe {
            let mut e = [S::splat(0.0); 4];
            for r in rows.clone() {
                let tap = w[r + RADIUS - y];
                let p = ring.as_ptr().add(r % TAPS * stride * 4 + i);
                for (map, e) in e.iter_mut().enumerate() {
                    *e = S::load(p.add(map * stride)).fma(tap, *e);
                }
            }
            let [mx, my, squares, product] = e;
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
            cross.add(own).mul(weight).store(out[0].add(i));
            by_square.mul(weight).store(out[1].add(i));
            by_product.mul(weight).store(out[2].add(i));
        }
    }
    f64::from(sum.sum())
}

struct Gradient<'a> {
    input: &'a LossInput<'a>,
    channel: usize,
    y0: usize,
    maps: &'a [Vec<f32>],
    window: &'a [f32; TAPS],
    scale: f32,
    out: &'a mut [f32],
    l1: f64,
    l2: f64,
}

#[inline(always)]
fn gradient_generic<S: Simd>(a: &mut Gradient) {
    let shape = a.input.shape;
    let (line, stride) = (shape.line(), shape.stride());
    let y1 = (a.y0 + BAND).min(shape.height);
    let (w, full) = taps::<S>(a.window);
    a.out.fill(0.0);
    let mut buffer = LINES.take();
    buffer.clear();
    buffer.resize(line * 3, 0.0);
    for y in a.y0..y1 {
        let rows = y.saturating_sub(RADIUS)..(y + RADIUS).min(shape.height - 1) + 1;
        for map in 0..if a.input.lambda > 0.0 { 3 } else { 0 } {
            for i in (0..stride).step_by(S::LANES) {
                let mut sum = S::splat(0.0);
                for r in rows.clone() {
                    let p = unsafe { S::load(a.maps[map].as_ptr().add(r * line + BORDER + i)) };
                    sum = p.fma(full[r + RADIUS - y], sum);
                }
                unsafe { sum.store(buffer.as_mut_ptr().add(map * line + BORDER + i)) };
            }
        }
        unsafe { gradient_line::<S>(a, y, &buffer, &w) };
    }
    LINES.set(buffer);
}

#[inline(always)]
unsafe fn gradient_line<S: Simd>(a: &mut Gradient, y: usize, buffer: &[f32], w: &[S; RADIUS + 1]) {
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

simd_kernel!(fn statistics(arguments: &mut Statistics) = statistics_generic);
simd_kernel!(fn gradient_rows(arguments: &mut Gradient) = gradient_generic);
