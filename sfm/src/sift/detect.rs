//! Extrema of the difference of Gaussians, located below the pixel (Lowe 2004, sections 3.1 and 4).

// Loops over several arrays at once are written with an index: the form the compiler vectorises.
#![allow(clippy::needless_range_loop)]

use super::blur::{LANES, dispatch};
use super::pyramid::Octave;

/// An extremum of an octave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Extremum {
    /// Column, octave samples (0 is the first sample's centre).
    pub x: f32,
    /// Row, octave samples.
    pub y: f32,
    /// Level within the octave, fractional.
    pub level: f32,
    /// Interpolated response, signed.
    pub response: f32,
}

/// Samples this close to the border are not searched.
/// Source: OpenCV, SIFT_IMG_BORDER.
pub(super) const BORDER: usize = 5;
/// A first look takes samples with this share of the threshold: interpolation can only raise them.
/// Source: VLFeat, vl_sift_detect.
const FIRST_LOOK: f32 = 0.8;
/// How often the quadratic may move on to a neighbouring sample.
/// Source: OpenCV, SIFT_MAX_INTERP_STEPS.
const MAX_MOVES: usize = 5;

/// All extrema of an octave whose response reaches `threshold(level)` and whose principal
/// curvatures differ by less than `edge_ratio`.
pub(super) fn extrema(octave: &Octave, edge_ratio: f32, threshold: impl Fn(usize) -> f32) -> Vec<Extremum> {
    let (w, h) = (octave.levels[0].width, octave.levels[0].height);
    let mut found = Vec::new();
    if w <= 2 * BORDER || h <= 2 * BORDER {
        return found;
    }
    let thresholds: Vec<f32> = (0..octave.scales + 2).map(threshold).collect();
    let layers = octave.scales + 2;
    // Rows y − 1, y, y + 1 of every difference of Gaussians, in a ring.
    let mut ring = vec![vec![0.0_f32; w]; 3 * layers];
    fill(octave, BORDER - 1, &mut ring);
    fill(octave, BORDER, &mut ring);
    let mut candidates = Vec::new();
    for y in BORDER..h - BORDER {
        fill(octave, y + 1, &mut ring);
        for level in 1..=octave.scales {
            let rows =
                std::array::from_fn(|i| ring[(level + i / 3 - 1) * 3 + (y + i % 3 + 2) % 3].as_slice());
            candidates.clear();
            scan_row(&rows, FIRST_LOOK * thresholds[level], &mut candidates);
            for &x in &candidates {
                let refined = refine(octave, x as usize, y, level, edge_ratio);
                found.extend(refined.filter(|e| e.response.abs() >= thresholds[level]));
            }
        }
    }
    found
}

/// Row `y` of every difference of Gaussians, into its place of the ring.
fn fill(octave: &Octave, y: usize, ring: &mut [Vec<f32>]) {
    for (layer, rows) in ring.chunks_exact_mut(3).enumerate() {
        difference(octave.levels[layer + 1].row(y), octave.levels[layer].row(y), &mut rows[y % 3]);
    }
}

dispatch! {
    fn difference(coarse: &[f32], fine: &[f32], out: &mut [f32]) {
        for ((o, c), f) in out.iter_mut().zip(coarse).zip(fine) {
            *o = c - f;
        }
    }
}

dispatch! {
    /// Columns at which the middle one of nine rows (three layers of three) is above or below all
    /// 26 neighbours.
    fn scan_row(rows: &[&[f32]; 9], threshold: f32, candidates: &mut Vec<u32>) {
        let n = rows[4].len();
        let middle = rows[4];
        let mut at = BORDER;
        while at < n - BORDER {
            let lanes = LANES.min(n - BORDER - at);
            if lanes < LANES {
                candidates.extend((at..at + lanes).filter(|&x| middle[x].abs() > threshold && is_extremum(rows, x)).map(|x| x as u32));
                break;
            }
            let v: &[f32; LANES] = lanes_of(middle, at);
            let mut strong = 0_u32;
            for v in v {
                strong |= u32::from(v.abs() > threshold);
            }
            if strong != 0 {
                // Four neighbours are asked at once; the few that pass meet all 26.
                let (left, right) = (lanes_of(middle, at - 1), lanes_of(middle, at + 1));
                let (above, below) = (lanes_of(rows[3], at), lanes_of(rows[5], at));
                let mut hits = [0_u32; LANES];
                let mut any = 0;
                for i in 0..LANES {
                    let high = u32::from(v[i] >= left[i]) & u32::from(v[i] >= right[i])
                        & u32::from(v[i] >= above[i]) & u32::from(v[i] >= below[i]) & u32::from(v[i] > threshold);
                    let low = u32::from(v[i] <= left[i]) & u32::from(v[i] <= right[i])
                        & u32::from(v[i] <= above[i]) & u32::from(v[i] <= below[i]) & u32::from(v[i] < -threshold);
                    hits[i] = high | low;
                    any |= hits[i];
                }
                if any != 0 {
                    candidates.extend((0..LANES).filter(|&i| hits[i] != 0 && is_extremum(rows, at + i)).map(|i| (at + i) as u32));
                }
            }
            at += lanes;
        }
    }
}

/// [`LANES`] samples from `at` on (a place within the row).
#[inline(always)]
fn lanes_of(row: &[f32], at: usize) -> &[f32; LANES] {
    match row[at..].first_chunk() {
        Some(lanes) => lanes,
        None => &[0.0; LANES],
    }
}

#[inline(always)]
fn is_extremum(rows: &[&[f32]; 9], x: usize) -> bool {
    let v = rows[4][x];
    let sign = if v > 0.0 { 1.0 } else { -1.0 };
    rows.iter().all(|row| row[x - 1..=x + 1].iter().all(|n| sign * v >= sign * n))
}

/// Gradient and Hessian of the response at a sample, by central differences over (x, y, level).
fn derivatives(octave: &Octave, x: usize, y: usize, level: usize) -> ([f32; 3], [[f32; 3]; 3]) {
    let d = |dx: isize, dy: isize, ds: isize| {
        octave.dog(level.wrapping_add_signed(ds), x.wrapping_add_signed(dx), y.wrapping_add_signed(dy))
    };
    let v2 = 2.0 * d(0, 0, 0);
    let gradient = [
        (d(1, 0, 0) - d(-1, 0, 0)) / 2.0,
        (d(0, 1, 0) - d(0, -1, 0)) / 2.0,
        (d(0, 0, 1) - d(0, 0, -1)) / 2.0,
    ];
    let xy = (d(1, 1, 0) - d(-1, 1, 0) - d(1, -1, 0) + d(-1, -1, 0)) / 4.0;
    let xs = (d(1, 0, 1) - d(-1, 0, 1) - d(1, 0, -1) + d(-1, 0, -1)) / 4.0;
    let ys = (d(0, 1, 1) - d(0, -1, 1) - d(0, 1, -1) + d(0, -1, -1)) / 4.0;
    let xx = d(1, 0, 0) + d(-1, 0, 0) - v2;
    let yy = d(0, 1, 0) + d(0, -1, 0) - v2;
    let ss = d(0, 0, 1) + d(0, 0, -1) - v2;
    (gradient, [[xx, xy, xs], [xy, yy, ys], [xs, ys, ss]])
}

/// Moves to the top of the quadratic through the 27 neighbours (Brown and Lowe 2002); `None` where
/// it leaves the octave, does not settle, or lies on an edge.
fn refine(
    octave: &Octave,
    mut x: usize,
    mut y: usize,
    mut level: usize,
    edge_ratio: f32,
) -> Option<Extremum> {
    let (w, h) = (octave.levels[0].width, octave.levels[0].height);
    for _ in 0..MAX_MOVES {
        let (gradient, hessian) = derivatives(octave, x, y, level);
        let offset = solve3(&hessian, &gradient)?.map(|v| -v);
        if offset.iter().any(|o| !o.is_finite() || o.abs() > 2.0) {
            return None;
        }
        let step = offset.map(|o| if o.abs() > 0.6 { o.signum() as isize } else { 0 });
        if step == [0; 3] {
            let [[xx, xy, _], [_, yy, _], _] = hessian;
            let (trace, det) = (xx + yy, xx * yy - xy * xy);
            if det <= 0.0 || trace * trace * edge_ratio >= (edge_ratio + 1.0).powi(2) * det {
                return None;
            }
            let rise: f32 = gradient.iter().zip(&offset).map(|(g, o)| g * o).sum();
            let [dx, dy] = top_in_plane(octave, x, y, level, offset[2]).unwrap_or([offset[0], offset[1]]);
            return Some(Extremum {
                x: x as f32 + dx,
                y: y as f32 + dy,
                level: level as f32 + offset[2],
                response: octave.dog(level, x, y) + rise / 2.0,
            });
        }
        x = x.wrapping_add_signed(step[0]);
        y = y.wrapping_add_signed(step[1]);
        level = level.wrapping_add_signed(step[2]);
        let inside = (BORDER..w - BORDER).contains(&x) && (BORDER..h - BORDER).contains(&y);
        if !inside || !(1..=octave.scales).contains(&level) {
            return None;
        }
    }
    None
}

/// Where the response is largest in the plane at level `level + offset`: the nine responses are
/// interpolated to that level first, so that the shape along scale does not pull at the position.
/// Around a Gaussian spot the response is `(1 − a) e^(−a)`, `a = r² / 2w²`; its fourth root has no
/// term in `a²`, so a parabola through it has the least bias.
fn top_in_plane(octave: &Octave, x: usize, y: usize, level: usize, offset: f32) -> Option<[f32; 2]> {
    let sign = octave.dog(level, x, y).signum();
    let mut v = [[0.0_f32; 3]; 3];
    for (j, row) in v.iter_mut().enumerate() {
        for (i, v) in row.iter_mut().enumerate() {
            let [below, here, above] =
                [0, 1, 2].map(|s| sign * octave.dog(level + s - 1, x + i - 1, y + j - 1));
            let value = here + offset * ((above - below) + offset * (above + below - 2.0 * here)) / 2.0;
            if value <= 0.0 {
                return None;
            }
            *v = value.sqrt().sqrt();
        }
    }
    let (gx, gy) = ((v[1][2] - v[1][0]) / 2.0, (v[2][1] - v[0][1]) / 2.0);
    let xx = v[1][2] + v[1][0] - 2.0 * v[1][1];
    let yy = v[2][1] + v[0][1] - 2.0 * v[1][1];
    let xy = (v[2][2] - v[2][0] - v[0][2] + v[0][0]) / 4.0;
    let det = xx * yy - xy * xy;
    let (dx, dy) = ((xy * gy - yy * gx) / det, (xy * gx - xx * gy) / det);
    (det > 0.0 && dx.abs() < 1.0 && dy.abs() < 1.0).then_some([dx, dy])
}

/// `a⁻¹ b` of a symmetric 3×3 system by cofactors, in f64; `None` where it is singular.
fn solve3(a: &[[f32; 3]; 3], b: &[f32; 3]) -> Option<[f32; 3]> {
    let m = a.map(|row| row.map(f64::from));
    let matrix = glam::DMat3::from_cols_array_2d(&m); // symmetric: rows are columns
    let det = matrix.determinant();
    let size = m.iter().flatten().fold(0.0_f64, |s, v| s.max(v.abs()));
    if det.abs() <= 1e-9 * size.powi(3) {
        return None;
    }
    let solved = matrix.inverse() * glam::DVec3::new(f64::from(b[0]), f64::from(b[1]), f64::from(b[2]));
    Some(solved.to_array().map(|v| v as f32))
}
