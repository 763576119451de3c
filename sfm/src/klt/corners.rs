//! Where an image can be tracked: corners (Shi & Tomasi, "Good features to track", CVPR 1994).

// Loops over several arrays at once are written with an index: the form the compiler vectorises.
#![allow(clippy::needless_range_loop)]

use super::pyramid::PyramidLevel;
use crate::sift::dispatch;
use glam::DVec2;
use image::GrayImage;

/// Half the side of the square over which gradients are summed, pixels.
/// Source: measured: with the three others of `klt` so marked it was about halved and doubled:
/// 0.150° and 0.038° in case 3 (0.048°).
const BLOCK: usize = 3;
/// A corner's smaller eigenvalue is at least this share of the strongest that the mask keeps.
/// Source: measured: with the three others of `klt` so marked it was about halved and doubled:
/// 0.150° and 0.038° in case 3 (0.048°).
const SHARE: f32 = 0.0005;

/// Which pixels a mask keeps; everything without a mask.
pub(super) fn is_unmasked(mask: Option<&GrayImage>, x: i64, y: i64, width: usize, height: usize) -> bool {
    if x < 0 || y < 0 || x >= width as i64 || y >= height as i64 {
        return false;
    }
    mask.is_none_or(|m| {
        let column = x as u64 * u64::from(m.width()) / width as u64;
        let row = y as u64 * u64::from(m.height()) / height as u64;
        m.get_pixel(column as u32, row as u32).0[0] >= 128
    })
}

/// New corners, strongest first, at least `distance` pixels from each other and from `taken`; at
/// most `most`.
pub(super) fn corners(
    level: &PyramidLevel,
    mask: Option<&GrayImage>,
    taken: &[DVec2],
    distance: f64,
    most: usize,
) -> Vec<DVec2> {
    let (w, h) = (level.width, level.height);
    let border = 2 * BLOCK + 2;
    if w <= 2 * border || h <= 2 * border {
        return Vec::new();
    }
    let strength = strengths(level);
    let mut strongest = 0.0;
    let mut found: Vec<(f32, usize)> = Vec::new();
    for y in border..h - border {
        for x in border..w - border {
            let i = y * w + x;
            let s = strength[i];
            if s <= SHARE * strongest || s <= 0.0 {
                continue;
            }
            let neighbours = [i - w - 1, i - w, i - w + 1, i - 1, i + 1, i + w - 1, i + w, i + w + 1];
            let peak = neighbours
                .iter()
                .enumerate()
                .all(|(k, &n)| if k < 4 { s > strength[n] } else { s >= strength[n] });
            if peak && inside(mask, x as i64, y as i64, w, h) {
                strongest = s.max(strongest);
                found.push((s, i));
            }
        }
    }
    found.retain(|(s, _)| *s > SHARE * strongest);
    found.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut grid = CornerGrid::new(w, h, distance);
    taken.iter().for_each(|p| grid.add(*p));
    let mut chosen = Vec::new();
    for (_, i) in found {
        if chosen.len() >= most {
            break;
        }
        let p = DVec2::new((i % w) as f64 + 0.5, (i / w) as f64 + 0.5);
        if grid.is_free(p) {
            grid.add(p);
            chosen.push(p);
        }
    }
    chosen
}

/// Whether the mask keeps a pixel and its four neighbours: what lies on a contour may slide along
/// it, but rods and struts are contour on both sides, and of thin objects nothing would be left
/// with a wider margin (docs/decisions, tried.md: corners at the matte's edge).
fn inside(mask: Option<&GrayImage>, x: i64, y: i64, w: usize, h: usize) -> bool {
    let around = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)];
    mask.is_none() || around.iter().all(|(dx, dy)| is_unmasked(mask, x + dx, y + dy, w, h))
}

dispatch! {
/// Smaller eigenvalue of the gradients' second moments, summed over a square, at every pixel.
fn strengths(level: &PyramidLevel) -> Vec<f32> {
    let (w, h) = (level.width, level.height);
    let mut moments = [vec![0.0f32; w * h], vec![0.0f32; w * h], vec![0.0f32; w * h]];
    for y in 1..h - 1 {
        let (above, own, below) = (level.row(y - 1), level.row(y), level.row(y + 1));
        let [xx, xy, yy] = moments.each_mut().map(|m| &mut m[y * w..(y + 1) * w]);
        for x in 1..w - 1 {
            let gx = 0.5 * (own[x + 1] - own[x - 1]);
            let gy = 0.5 * (below[x] - above[x]);
            (xx[x], xy[x], yy[x]) = (gx * gx, gx * gy, gy * gy);
        }
    }
    for m in &mut moments {
        box_sum(m, w, h);
    }
    let [xx, xy, yy] = moments;
    let mut out = vec![0.0; w * h];
    for i in 0..w * h {
        let (a, b, c) = (xx[i], xy[i], yy[i]);
        out[i] = 0.5 * (a + c - ((a - c) * (a - c) + 4.0 * b * b).sqrt());
    }
    out
}
}

/// Sums over squares of side 2 BLOCK + 1; zero near the border.
#[inline(always)]
fn box_sum(data: &mut [f32], w: usize, h: usize) {
    let side = 2 * BLOCK + 1;
    let inner = w - 2 * BLOCK;
    let mut across = vec![0.0f32; w * h];
    for (row, out) in data.chunks_exact(w).zip(across.chunks_exact_mut(w)) {
        let out = &mut out[BLOCK..w - BLOCK];
        for k in 0..side {
            let row = &row[k..k + inner];
            for x in 0..inner {
                out[x] += row[x];
            }
        }
    }
    data.fill(0.0);
    for y in BLOCK..h - BLOCK {
        let out = &mut data[y * w..(y + 1) * w];
        for k in 0..side {
            let row = &across[(y - BLOCK + k) * w..(y - BLOCK + k + 1) * w];
            for x in 0..w {
                out[x] += row[x];
            }
        }
    }
}

/// Which cells of a grid are near a point.
struct CornerGrid {
    cell: f64,
    columns: usize,
    rows: usize,
    points: Vec<Vec<DVec2>>,
}

impl CornerGrid {
    fn new(w: usize, h: usize, distance: f64) -> Self {
        let cell = distance.max(1.0);
        let (columns, rows) = ((w as f64 / cell) as usize + 1, (h as f64 / cell) as usize + 1);
        Self { cell, columns, rows, points: vec![Vec::new(); columns * rows] }
    }

    fn place(&self, p: DVec2) -> (usize, usize) {
        let p = p / self.cell;
        ((p.x as usize).min(self.columns - 1), (p.y as usize).min(self.rows - 1))
    }

    fn add(&mut self, p: DVec2) {
        let (x, y) = self.place(p);
        self.points[y * self.columns + x].push(p);
    }

    fn is_free(&self, p: DVec2) -> bool {
        let (x, y) = self.place(p);
        let rows = y.saturating_sub(1)..=(y + 1).min(self.rows - 1);
        rows.flat_map(|r| (x.saturating_sub(1)..=(x + 1).min(self.columns - 1)).map(move |c| (r, c)))
            .all(|(r, c)| self.points[r * self.columns + c].iter().all(|q| q.distance(p) >= self.cell))
    }
}
