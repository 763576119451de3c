//! Separable Gaussian filters on planes of f32, borders replicated.
//!
//! One portable source, compiled three times: for AVX-512 and AVX2 where the machine has them and
//! for the baseline. Products and sums are kept apart (no fused multiply-add), so all give the same
//! bits.

// Loops over several arrays at once are written with an index: the form the compiler vectorises.
#![allow(clippy::needless_range_loop)]

/// A row-major plane.
#[derive(Clone, Debug, Default)]
pub(super) struct LumaPlane {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// [height × width].
    pub data: Vec<f32>,
}

impl LumaPlane {
    /// Gives the plane that size; what it holds then is not defined.
    pub(super) fn resize(&mut self, width: usize, height: usize) {
        self.width = width;
        self.height = height;
        self.data.resize(width * height, 0.0);
    }

    /// Row `y`.
    #[inline(always)]
    pub(super) fn row(&self, y: usize) -> &[f32] {
        &self.data[y * self.width..(y + 1) * self.width]
    }

    /// The sample at column `x`, row `y`.
    #[inline(always)]
    pub(super) fn at(&self, x: usize, y: usize) -> f32 {
        self.data[y * self.width + x]
    }
}

/// Half of a symmetric, normalised, sampled Gaussian: `[centre, ±1, ±2, …]`, cut at 4σ.
pub(super) fn half_kernel(sigma: f32) -> Vec<f32> {
    let radius = (4.0 * sigma).ceil().max(1.0) as usize;
    let half: Vec<f64> = (0..=radius).map(|i| (-0.5 * (i as f64 / f64::from(sigma)).powi(2)).exp()).collect();
    let sum = half[0] + 2.0 * half[1..].iter().sum::<f64>();
    half.iter().map(|v| (v / sum) as f32).collect()
}

pub(crate) use scene::dispatch;

/// Samples of a vector.
/// Source: derived: the 512 bits of the widest registers over the 32 of a sample.
pub(crate) const LANES: usize = 16;
/// Samples of the four vectors whose sums are formed side by side.
/// Source: derived: an addition takes about four cycles, so that the next need not wait for the
/// last.
const BLOCK: usize = 4 * LANES;

/// Where the blocks of `n` samples begin; the last one overlaps the one before, so that none is
/// left over.
#[inline(always)]
fn blocks_of(n: usize) -> impl Iterator<Item = usize> {
    let count = if n < BLOCK { 0 } else { n.div_ceil(BLOCK) };
    (0..count).map(move |i| (i * BLOCK).min(n - BLOCK))
}

/// The samples that are in no block: all, where they are too few for one.
#[inline(always)]
fn single_samples_of(n: usize) -> std::ops::Range<usize> {
    0..if n < BLOCK { n } else { 0 }
}

/// The vector at the beginning of samples that hold a whole one.
#[inline(always)]
fn vector(samples: &[f32]) -> [f32; LANES] {
    *samples.first_chunk().unwrap_or(&[0.0; LANES])
}

/// `sum + k (left + right)` of a vector.
#[inline(always)]
fn with_pair(sum: [f32; LANES], k: f32, left: &[f32], right: &[f32]) -> [f32; LANES] {
    let (left, right) = (vector(left), vector(right));
    let mut out = [0.0; LANES];
    for i in 0..LANES {
        out[i] = sum[i] + k * (left[i] + right[i]);
    }
    out
}

/// The sums of a block: `Σ_k kernel[|k|] side(k)[..BLOCK]`. Four vectors by name, for an array of
/// them would be kept in memory.
#[inline(always)]
fn block_sum<'a>(kernel: &[f32], side: impl Fn(isize) -> &'a [f32]) -> [[f32; LANES]; 4] {
    let centre = &side(0)[..BLOCK];
    let [mut a, mut b, mut c, mut d] =
        [0, 1, 2, 3].map(|i| vector(&centre[i * LANES..]).map(|v| kernel[0] * v));
    for (i, &k) in kernel.iter().enumerate().skip(1) {
        let (left, right) = (&side(-(i as isize))[..BLOCK], &side(i as isize)[..BLOCK]);
        a = with_pair(a, k, left, right);
        b = with_pair(b, k, &left[LANES..], &right[LANES..]);
        c = with_pair(c, k, &left[2 * LANES..], &right[2 * LANES..]);
        d = with_pair(d, k, &left[3 * LANES..], &right[3 * LANES..]);
    }
    [a, b, c, d]
}

dispatch! {
    /// `out[x] = Σ_k kernel[|k|] rows[radius + k][x]`: the vertical pass of a part of a row.
    fn vertical(rows: &[&[f32]], kernel: &[f32], out: &mut [f32]) {
        let radius = kernel.len() - 1;
        for at in blocks_of(out.len()) {
            let sums = block_sum(kernel, |k| &rows[radius.wrapping_add_signed(k)][at..]);
            out[at..at + BLOCK].copy_from_slice(sums.as_flattened());
        }
        for x in single_samples_of(out.len()) {
            let mut sum = kernel[0] * rows[radius][x];
            for (i, k) in kernel.iter().enumerate().skip(1) {
                sum += k * (rows[radius - i][x] + rows[radius + i][x]);
            }
            out[x] = sum;
        }
    }
}

dispatch! {
    /// The horizontal pass of a part of a row; `padded` holds `radius` further samples on both
    /// sides.
    fn horizontal(padded: &[f32], kernel: &[f32], out: &mut [f32]) {
        let radius = kernel.len() - 1;
        for at in blocks_of(out.len()) {
            let sums = block_sum(kernel, |k| &padded[(at + radius).wrapping_add_signed(k)..]);
            out[at..at + BLOCK].copy_from_slice(sums.as_flattened());
        }
        for x in single_samples_of(out.len()) {
            let at = x + radius;
            let mut sum = kernel[0] * padded[at];
            for (i, k) in kernel.iter().enumerate().skip(1) {
                sum += k * (padded[at - i] + padded[at + i]);
            }
            out[x] = sum;
        }
    }
}

/// Blurs `source` by σ pixels into `out` (resized).
pub(super) fn gaussian_blur(source: &LumaPlane, sigma: f32, out: &mut LumaPlane) {
    out.resize(source.width, source.height);
    if source.data.is_empty() {
        return;
    }
    let kernel = half_kernel(sigma);
    let (w, h, radius) = (source.width, source.height, kernel.len() - 1);
    // Eight blocks are read together: the rows that the filter reaches over stay in the first-level
    // cache.
    let step = (8 * BLOCK).saturating_sub(2 * radius).max(BLOCK);
    let mut padded = vec![0.0; step + 2 * radius];
    let mut rows: Vec<&[f32]> = Vec::with_capacity(2 * radius + 1);
    for first in (0..w).step_by(step) {
        let last = (first + step).min(w);
        let (from, to) = (first.saturating_sub(radius), (last + radius).min(w));
        // Where column `from` lies among the padded ones.
        let start = radius - (first - from);
        let padded = &mut padded[..last - first + 2 * radius];
        for y in 0..h {
            rows.clear();
            rows.extend(
                (0..=2 * radius).map(|k| &source.row((y + k).saturating_sub(radius).min(h - 1))[from..to]),
            );
            let end = start + to - from;
            vertical(&rows, &kernel, &mut padded[start..end]);
            let (left, right) = (padded[start], padded[end - 1]);
            padded[..start].fill(left);
            padded[end..].fill(right);
            horizontal(padded, &kernel, &mut out.data[y * w + first..y * w + last]);
        }
    }
}

/// Twice the size, blurred by σ input pixels on the way: output sample `i` lies at input position
/// `i/2 − 1/4` (sample indices), so both phases are Gaussian sums of the same width and neither is
/// favoured.
pub(super) fn gaussian_double(source: &LumaPlane, sigma: f32, out: &mut LumaPlane) {
    out.resize(source.width * 2, source.height * 2);
    if source.data.is_empty() {
        return;
    }
    let radius = (4.0 * sigma).ceil().max(1.0) as isize + 1;
    let taps = phase_kernel(sigma, radius);
    let (w, h) = (source.width, source.height);
    let pad = radius as usize;
    let mut line = vec![0.0; w + 2 * pad];
    let (mut even, mut odd) = (vec![0.0; w], vec![0.0; w]);
    for y in 0..2 * h {
        let rows: Vec<&[f32]> = (-radius..=radius)
            .map(|k| source.row((y as isize / 2 + k).clamp(0, h as isize - 1) as usize))
            .collect();
        weigh_rows(&rows, &taps[y % 2], &mut line[pad..pad + w]);
        let (first, last) = (line[pad], line[pad + w - 1]);
        line[..pad].fill(first);
        line[pad + w..].fill(last);
        let shifted: Vec<&[f32]> = (0..=2 * pad).map(|k| &line[k..k + w]).collect();
        weigh_rows(&shifted, &taps[0], &mut even);
        weigh_rows(&shifted, &taps[1], &mut odd);
        let target = &mut out.data[y * 2 * w..(y + 1) * 2 * w];
        for ((pair, e), o) in target.chunks_exact_mut(2).zip(&even).zip(&odd) {
            pair.copy_from_slice(&[*e, *o]);
        }
    }
}

dispatch! {
    /// `out[x] = Σ_k weights[k] rows[k][x]`, sixteen samples in registers at a time.
    fn weigh_rows(rows: &[&[f32]], weights: &[f32], out: &mut [f32]) {
        let n = out.len();
        let (blocks, rest) = out.as_chunks_mut::<LANES>();
        for (b, block) in blocks.iter_mut().enumerate() {
            let mut sum = [0.0_f32; LANES];
            for (row, w) in rows.iter().zip(weights) {
                for (s, v) in sum.iter_mut().zip(&row[b * LANES..(b + 1) * LANES]) {
                    *s += w * v;
                }
            }
            *block = sum;
        }
        let start = n - rest.len();
        for (i, o) in rest.iter_mut().enumerate() {
            *o = rows.iter().zip(weights).map(|(row, w)| w * row[start + i]).sum();
        }
    }
}

/// Weights of input samples `i + k`, `k = −radius..=radius`, for output samples `2i` (at −1/4) and
/// `2i + 1` (at +1/4).
fn phase_kernel(sigma: f32, radius: isize) -> [Vec<f32>; 2] {
    [-0.25, 0.25].map(|shift: f64| {
        let g: Vec<f64> = (-radius..=radius)
            .map(|k| (-0.5 * ((k as f64 - shift) / f64::from(sigma)).powi(2)).exp())
            .collect();
        let sum: f64 = g.iter().sum();
        g.iter().map(|v| (v / sum) as f32).collect()
    })
}

/// Every second sample, beginning with the first.
pub(super) fn halve(source: &LumaPlane, out: &mut LumaPlane) {
    let (w, h) = (source.width.div_ceil(2), source.height.div_ceil(2));
    out.resize(w, h);
    for y in 0..h {
        let row = source.row(2 * y);
        for (o, v) in out.data[y * w..(y + 1) * w].iter_mut().zip(row.iter().step_by(2)) {
            *o = *v;
        }
    }
}

/// Area-averaged reduction to `width × height` (not larger than the source).
pub(super) fn reduce(source: &LumaPlane, width: usize, height: usize) -> LumaPlane {
    let columns = area_weights(source.width, width);
    let rows = area_weights(source.height, height);
    let mut out = LumaPlane { width, height, data: vec![0.0; width * height] };
    let mut line = vec![0.0_f32; source.width];
    for (y, (first, weights)) in rows.iter().enumerate() {
        line.fill(0.0);
        for (k, weight) in weights.iter().enumerate() {
            for (o, v) in line.iter_mut().zip(source.row(first + k)) {
                *o += weight * v;
            }
        }
        for (x, (first, weights)) in columns.iter().enumerate() {
            out.data[y * width + x] = weights.iter().zip(&line[*first..]).map(|(w, v)| w * v).sum();
        }
    }
    out
}

/// For each of `to` cells: the first of `from` samples it covers, and the shares it takes of them.
fn area_weights(from: usize, to: usize) -> Vec<(usize, Vec<f32>)> {
    let step = from as f64 / to as f64;
    (0..to)
        .map(|i| {
            let (lo, hi) = (i as f64 * step, ((i + 1) as f64 * step).min(from as f64));
            let first = (lo as usize).min(from - 1);
            let last = (hi.ceil() as usize).clamp(first + 1, from);
            let covered = (first..last).map(|k| (hi.min((k + 1) as f64) - lo.max(k as f64)).max(0.0));
            (first, covered.map(|width| (width / step) as f32).collect())
        })
        .collect()
}
