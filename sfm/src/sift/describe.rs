//! Orientation and descriptor of a keypoint (Lowe 2004, sections 5 and 6; Arandjelović and
//! Zisserman 2012).

// Loops over several arrays at once are written with an index: the form the compiler vectorises.
#![allow(clippy::needless_range_loop)]

use super::blur::{LANES, LumaPlane, dispatch};
use std::f32::consts::{PI, TAU};

/// Bins of the histogram of orientations.
/// Source: Lowe 2004, section 5.
const ORIENTATION_BINS: usize = 36;
/// Spatial bins a side.
/// Source: Lowe 2004, section 6.2.
const SPATIAL: usize = 4;
/// Orientations a bin.
/// Source: Lowe 2004, section 6.2.
const ANGLES: usize = 8;
/// Width of a spatial bin in σ of the keypoint.
/// Source: judgement, near the 3 of Lowe 2004; no bench chose it.
const BIN_SIGMAS: f32 = 3.25;
/// Samples a spatial bin and side.
/// Source: derived: the most with which a row of the grid still fits two vectors.
const SAMPLES: usize = 6;
/// Samples a side: the 4 bins and half a bin around them, where interpolation still reaches.
/// Source: derived from [`SPATIAL`] and [`SAMPLES`].
const GRID: usize = (SPATIAL + 1) * SAMPLES;
/// Samples a row, whole vectors.
/// Source: derived from [`GRID`].
const WIDE: usize = GRID.next_multiple_of(LANES);

/// The samples of a keypoint's grid, with one more on each side for central differences.
type DescriptorPatch = [[f32; WIDE + 2]; GRID + 2];

/// `atan2(y, x)`, error below 1e-5 rad, without branches, so that loops over it become vector code.
/// Minimax polynomial of atan on [0, 1] (Abramowitz and Stegun 4.4.49).
#[inline(always)]
fn fast_atan2(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (low, high) = if ax < ay { (ax, ay) } else { (ay, ax) };
    let t = low / (high + f32::MIN_POSITIVE);
    let s = t * t;
    let p = 0.002_866_225_7 * s - 0.016_165_737;
    let p = p * s + 0.042_909_615;
    let p = p * s - 0.075_289_64;
    let p = p * s + 0.106_562_64;
    let p = p * s - 0.142_089;
    let p = p * s + 0.199_935_51;
    let p = p * s - 0.333_331_45;
    let a = p * s * t + t;
    let a = if ax < ay { PI / 2.0 - a } else { a };
    let a = if x < 0.0 { PI - a } else { a };
    if y < 0.0 { -a } else { a }
}

/// Dominant directions of the gradient around a keypoint, strongest first, radians in (−π, π].
/// `x, y, sigma`: samples of the level.
pub(super) fn orientations(level: &LumaPlane, x: f32, y: f32, sigma: f32, most: usize) -> Vec<f32> {
    let mut histogram = [0.0; ORIENTATION_BINS];
    orientation_histogram(level, x, y, 1.5 * sigma, &mut histogram);
    // Smoothed by (1, 4, 6, 4, 1)/16.
    for _ in 0..2 {
        let before = histogram;
        for (i, h) in histogram.iter_mut().enumerate() {
            let (l, r) = ((i + ORIENTATION_BINS - 1) % ORIENTATION_BINS, (i + 1) % ORIENTATION_BINS);
            *h = 0.25 * before[l] + 0.5 * before[i] + 0.25 * before[r];
        }
    }
    let top = histogram.iter().fold(0.0_f32, |m, &v| m.max(v));
    if top <= 0.0 {
        return Vec::new();
    }
    let mut peaks = Vec::new();
    for i in 0..ORIENTATION_BINS {
        let l = histogram[(i + ORIENTATION_BINS - 1) % ORIENTATION_BINS];
        let (v, r) = (histogram[i], histogram[(i + 1) % ORIENTATION_BINS]);
        // A further orientation needs 80 % of the strongest one (Lowe 2004, section 5).
        if v > l && v >= r && v >= 0.8 * top {
            let bin = i as f32 + 0.5 * (l - r) / (l - 2.0 * v + r);
            let angle = bin * TAU / ORIENTATION_BINS as f32;
            peaks.push((v, if angle > PI { angle - TAU } else { angle }));
        }
    }
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
    peaks.truncate(most.max(1));
    peaks.into_iter().map(|(_, angle)| angle).collect()
}

dispatch! {
    /// Gradient magnitudes by direction, Gaussian-weighted with `sigma_w`, shared between the two
    /// nearest bins.
    fn orientation_histogram(level: &LumaPlane, x: f32, y: f32, sigma_w: f32, histogram: &mut [f32; ORIENTATION_BINS]) {
        let radius = 3.0 * sigma_w;
        let (first_x, last_x) = clip_range(x, radius, level.width);
        let (first_y, last_y) = clip_range(y, radius, level.height);
        let scale = -0.5 / (sigma_w * sigma_w);
        let bins = ORIENTATION_BINS as f32;
        let column_weights: Vec<f32> = (first_x..=last_x).map(|c| (scale * (c as f32 - x).powi(2)).exp()).collect();
        for row in first_y..=last_y {
            let dy = row as f32 - y;
            let row_weight = (scale * dy * dy).exp();
            let (above, here, below) = (level.row(row - 1), level.row(row), level.row(row + 1));
            let mut column = first_x;
            while column <= last_x {
                let n = LANES.min(last_x + 1 - column);
                let mut weights = [0.0_f32; LANES];
                let mut angles = [0.0_f32; LANES];
                let (right, left) = (&here[column + 1..column + 1 + n], &here[column - 1..column - 1 + n]);
                let (down, up) = (&below[column..column + n], &above[column..column + n]);
                let column_weight = &column_weights[column - first_x..column - first_x + n];
                for i in 0..n {
                    let (gx, gy) = (right[i] - left[i], down[i] - up[i]);
                    weights[i] = (gx * gx + gy * gy).sqrt() * column_weight[i] * row_weight;
                    angles[i] = (fast_atan2(gy, gx) + TAU) * (bins / TAU);
                }
                for i in 0..n {
                    let dx = (column + i) as f32 - x;
                    if dx * dx + dy * dy <= radius * radius {
                        let floor = angles[i] as usize;
                        let share = angles[i] - floor as f32;
                        histogram[floor % ORIENTATION_BINS] += weights[i] * (1.0 - share);
                        histogram[(floor + 1) % ORIENTATION_BINS] += weights[i] * share;
                    }
                }
                column += n;
            }
        }
    }
}

/// First and last index within `radius` of `centre` that have neighbours on both sides.
#[inline(always)]
fn clip_range(centre: f32, radius: f32, size: usize) -> (usize, usize) {
    let first = (centre - radius).ceil().max(1.0) as usize;
    let last = ((centre + radius).floor().max(1.0) as usize).min(size.saturating_sub(2));
    (first, last)
}

/// Weights that every descriptor shares.
#[derive(Clone, Debug)]
pub(super) struct DescriptorTables {
    /// [WIDE] Gaussian weight along one axis (0 beyond the grid); σ is half the descriptor's width.
    gaussian: [f32; WIDE],
    /// [2 SAMPLES] linear share of the samples `SAMPLES b ..` in spatial bin `b`.
    share: [f32; 2 * SAMPLES],
}

impl Default for DescriptorTables {
    fn default() -> Self {
        let mut gaussian = [0.0; WIDE];
        for (i, weight) in gaussian[..GRID].iter_mut().enumerate() {
            let r = bins_from(i, (GRID as f32 - 1.0) / 2.0) / (SPATIAL as f32 / 2.0);
            *weight = (-0.5 * r * r).exp();
        }
        Self { gaussian, share: std::array::from_fn(|i| 1.0 - bins_from(i, SAMPLES as f32 - 0.5).abs()) }
    }
}

/// Distance of sample `i` from `centre`, spatial bins.
fn bins_from(i: usize, centre: f32) -> f32 {
    (i as f32 - centre) / SAMPLES as f32
}

dispatch! {
    /// RootSIFT of the neighbourhood, 128 bytes (see `scene::Features::descriptors`).
    /// `x, y, sigma`: samples of the level. The neighbourhood is read on a grid turned by `angle`
    /// and spaced by a share of σ, so that the weights of all samples are the same for every
    /// keypoint.
    pub fn describe(
        tables: &DescriptorTables, level: &LumaPlane, x: f32, y: f32, sigma: f32, angle: f32, out: &mut [u8],
    ) {
        let mut patch: DescriptorPatch = [[0.0; WIDE + 2]; GRID + 2];
        sample_patch(level, x, y, sigma * BIN_SIGMAS / SAMPLES as f32, angle, &mut patch);
        // Pooled over rows first: the columns stay apart, so that every step is a vector of
        // columns.
        let mut pooled = [[[0.0_f32; WIDE]; ANGLES]; SPATIAL];
        for row in 0..GRID {
            let (mut magnitude, mut direction) = ([0.0_f32; WIDE], [0.0_f32; WIDE]);
            let weight = tables.gaussian[row];
            for i in 0..WIDE {
                let gx = patch[row + 1][i + 2] - patch[row + 1][i];
                let gy = patch[row + 2][i + 1] - patch[row][i + 1];
                magnitude[i] = (gx * gx + gy * gy).sqrt() * tables.gaussian[i] * weight;
                direction[i] = fast_atan2(gy, gx) * (ANGLES as f32 / TAU);
            }
            // Each row lies in one or two spatial bins.
            let last = (row / SAMPLES).min(SPATIAL - 1);
            let first = (row / SAMPLES).saturating_sub(1);
            for angle in 0..ANGLES {
                let mut soft = [0.0_f32; WIDE];
                for i in 0..WIDE {
                    let d = (direction[i] - angle as f32).abs();
                    let around = (ANGLES as f32 - d).abs();
                    let d = if around < d { around } else { d };
                    let near = if d < 1.0 { 1.0 - d } else { 0.0 };
                    soft[i] = near * magnitude[i];
                }
                for bin in first..=last {
                    let share = tables.share[row - bin * SAMPLES];
                    for (p, s) in pooled[bin][angle].iter_mut().zip(&soft) {
                        *p += share * s;
                    }
                }
            }
        }
        let mut histogram = [0.0_f32; SPATIAL * SPATIAL * ANGLES];
        for (line, histogram) in pooled.iter().zip(histogram.chunks_exact_mut(SPATIAL * ANGLES)) {
            for (angle, columns) in line.iter().enumerate() {
                for bin in 0..SPATIAL {
                    let support = &columns[bin * SAMPLES..(bin + 2) * SAMPLES];
                    histogram[bin * ANGLES + angle] = support.iter().zip(&tables.share).map(|(c, s)| c * s).sum();
                }
            }
        }
        quantise(&histogram, out);
    }
}

/// Bilinear samples at `(x, y) + R(angle) spacing (i, j)`, centred; positions beyond the border
/// take its value.
#[inline(always)]
fn sample_patch(level: &LumaPlane, x: f32, y: f32, spacing: f32, angle: f32, patch: &mut DescriptorPatch) {
    let (s, c) = (angle.sin() * spacing, angle.cos() * spacing);
    // Just inside the last sample, so that both neighbours exist.
    let (max_x, max_y) = (level.width as f32 - 1.001, level.height as f32 - 1.001);
    let half = (GRID as f32 + 1.0) / 2.0;
    let width = level.width as i32;
    let data = &level.data[..level.width * level.height];
    for (j, row) in patch.iter_mut().enumerate() {
        let v = j as f32 - half;
        let (x0, y0) = (x - s * v, y + c * v);
        let (mut index, mut fx, mut fy) = ([0_i32; WIDE], [0.0_f32; WIDE], [0.0_f32; WIDE]);
        for i in 0..WIDE {
            let u = i as f32 - half;
            let px = clamp(x0 + c * u, max_x);
            let py = clamp(y0 + s * u, max_y);
            let (ix, iy) = (px as i32, py as i32);
            index[i] = iy * width + ix;
            fx[i] = px - ix as f32;
            fy[i] = py - iy as f32;
        }
        for i in 0..GRID + 2 {
            let at = index[i] as usize;
            let (top, bottom) = (&data[at..at + 2], &data[at + level.width..at + level.width + 2]);
            let upper = top[0] + fx[i] * (top[1] - top[0]);
            let lower = bottom[0] + fx[i] * (bottom[1] - bottom[0]);
            row[i] = upper + fy[i] * (lower - upper);
        }
    }
}

#[inline(always)]
fn clamp(v: f32, max: f32) -> f32 {
    let v = if v > 0.0 { v } else { 0.0 };
    if v < max { v } else { max }
}

/// Unit length, clamped at 0.2, unit length again (Lowe 2004, section 6.1), then
/// `round(512 √(h / Σh))`.
#[inline(always)]
fn quantise(histogram: &[f32], out: &mut [u8]) {
    let norm = histogram.iter().map(|h| h * h).sum::<f32>().sqrt();
    let clamp = 0.2 * norm;
    let sum: f32 = histogram.iter().map(|h| h.min(clamp)).sum();
    let scale = if sum > 0.0 { 1.0 / sum } else { 0.0 };
    for (o, h) in out.iter_mut().zip(histogram) {
        *o = (512.0 * (h.min(clamp) * scale).sqrt()).round().min(255.0) as u8;
    }
}
