//! Small filters of planes and masks; windows are cut at the border.

use super::pool::{BinaryMask, Raster, RasterValue};
use bytemuck::cast_slice_mut;
use std::ops::Range;

/// A part of a picture: columns and rows.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Rect {
    /// Columns.
    pub x: Range<usize>,
    /// Rows.
    pub y: Range<usize>,
}

impl Rect {
    /// The smallest around the non-zero part of a mask, grown by `margin`, within the picture.
    pub(super) fn around(mask: &BinaryMask, margin: usize) -> Self {
        let mut x = Range { start: mask.width, end: 0 }; // empty until a pixel is seen
        let mut y = Range { start: usize::MAX, end: 0 };
        for (row, line) in mask.chunks_exact(mask.width).enumerate() {
            if let Some((a, b)) = ends(line) {
                x = x.start.min(a)..x.end.max(b + 1);
                y = y.start.min(row)..row + 1;
            }
        }
        if y.end == 0 {
            return Self { x: 0..0, y: 0..0 };
        }
        Self {
            x: x.start.saturating_sub(margin)..(x.end + margin).min(mask.width),
            y: y.start.saturating_sub(margin)..(y.end + margin).min(mask.height()),
        }
    }

    /// Indices of its pixels in a picture of this width, row by row.
    pub(super) fn rows(&self, width: usize) -> impl Iterator<Item = Range<usize>> + use<> {
        let x = self.x.clone();
        self.y.clone().map(move |y| y * width + x.start..y * width + x.end)
    }

    /// The part of a plane that it covers, as a mask.
    pub(super) fn mask<'p, T: RasterValue>(
        &self,
        plane: &Raster<'p, T>,
        is_set: impl Fn(T) -> bool,
    ) -> BinaryMask<'p> {
        let mut mask = plane.pool.filled(self.x.len(), 0, 0);
        self.rows(plane.width).for_each(|row| mask.extend(plane[row].iter().map(|v| u8::from(is_set(*v)))));
        mask
    }
}

/// First and last set pixel of a row.
pub(crate) fn ends(row: &[u8]) -> Option<(usize, usize)> {
    let is_empty = row.iter().fold(0, |all, v| all | v) == 0; // faster than looking for the first
    if is_empty {
        return None;
    }
    Some((row.iter().position(|v| *v != 0)?, row.iter().rposition(|v| *v != 0)?))
}

/// Indices of what is set, in order.
pub(crate) fn set_pixels(mask: &[u8]) -> impl Iterator<Item = usize> {
    mask.iter().enumerate().filter(|(_, v)| **v != 0).map(|(i, _)| i)
}

/// Sums over windows of `(2r + 1)²` that lie in `rect` (outside of it values count as 0), in place,
/// channel by channel. Summed anew for every pixel: a running sum would leave rounding errors
/// larger than the smallest weights.
pub(crate) fn box_sum<T: RasterValue + bytemuck::Pod>(plane: &mut Raster<T>, rect: &Rect, r: usize) {
    let (channels, pitch, pool) = (size_of::<T>() / size_of::<f32>(), plane.width, plane.pool);
    let (w, h) = (channels * rect.x.len(), rect.y.len());
    let values: &mut [f32] = cast_slice_mut(plane);
    let mut sums = pool.filled(w, 0, 0.0);
    for y in rect.y.clone() {
        let source = &values[channels * (y * pitch + rect.x.start)..][..w];
        let start = sums.len();
        sums.extend(source.iter().copied());
        let target = &mut sums[start..];
        for d in (1..=r).map(|d| channels * d).take_while(|d| *d < w) {
            add(&mut target[d..], source);
            add(target, &source[d..]);
        }
    }
    for y in 0..h {
        let target = &mut values[channels * ((rect.y.start + y) * pitch + rect.x.start)..][..w];
        let (first, rest) = sums[y.saturating_sub(r) * w..(y + r + 1).min(h) * w].split_at(w);
        target.copy_from_slice(first);
        rest.chunks_exact(w).for_each(|row| add(target, row));
    }
}

fn add(sums: &mut [f32], row: &[f32]) {
    sums.iter_mut().zip(row).for_each(|(s, v)| *s += v);
}

/// Binomial 3 × 3 smoothing; the border repeats.
pub(crate) fn smooth<'p>(plane: &Raster<'p, f32>) -> Raster<'p, f32> {
    smooth_within(plane, &Rect { x: 0..plane.width, y: 0..plane.height() })
}

/// The same in the rows and columns of `rect` only, beside which values count as those at its
/// border; 0 elsewhere.
pub(crate) fn smooth_within<'p>(plane: &Raster<'p, f32>, rect: &Rect) -> Raster<'p, f32> {
    let mut out = plane.pool.filled(plane.width, plane.len(), 0.0);
    let (w, last) = (rect.x.len(), rect.y.end.saturating_sub(1));
    if w == 0 {
        return out;
    }
    let mut column = vec![0.0_f32; w + 2];
    for y in rect.y.clone() {
        let (up, down) = (y.saturating_sub(1).max(rect.y.start), (y + 1).min(last));
        let [above, here, below] = [up, y, down].map(|y| &plane[y * plane.width + rect.x.start..][..w]);
        for (c, ((a, v), b)) in column[1..=w].iter_mut().zip(above.iter().zip(here).zip(below)) {
            *c = 0.25 * (a + b) + 0.5 * v;
        }
        (column[0], column[w + 1]) = (column[1], column[w]);
        for (o, c) in out[y * plane.width + rect.x.start..][..w].iter_mut().zip(column.windows(3)) {
            *o = 0.25 * (c[0] + c[2]) + 0.5 * c[1];
        }
    }
    out
}

impl<'p> BinaryMask<'p> {
    /// Grows what is set by `r` pixels in every direction (a square).
    pub(super) fn dilate(&self, r: usize) -> Self {
        let mut rows = self.map(|v| *v);
        for d in 1..=r.min(self.width - 1) {
            for (source, target) in self.chunks_exact(self.width).zip(rows.chunks_exact_mut(self.width)) {
                unite(&mut target[d..], source);
                unite(target, &source[d..]);
            }
        }
        let mut out = rows.map(|v| *v);
        for d in (1..=r.min(self.height() - 1)).map(|d| d * self.width) {
            unite(&mut out[d..], &rows);
            unite(&mut out, &rows[d..]);
        }
        out
    }

    /// Shrinks what is set by `r` pixels; the border does not shrink it.
    pub(super) fn erode(&self, r: usize) -> Self {
        self.mask(|v| v == 0).dilate(r).mask(|v| v == 0)
    }
}

fn unite(target: &mut [u8], source: &[u8]) {
    target.iter_mut().zip(source).for_each(|(t, s)| *t |= s);
}

/// Connected regions (8 neighbours) of a mask.
pub(crate) struct Regions<'p> {
    /// The region of every pixel; 0 outside of the mask.
    pub labels: Raster<'p, u32>,
    /// Pixels of every region; element 0 is unused.
    pub sizes: Vec<usize>,
}

impl<'p> Regions<'p> {
    /// Works on runs of pixels: rows are joined where runs touch.
    pub(super) fn of(mask: &BinaryMask<'p>) -> Self {
        let width = mask.width;
        let mut parent = vec![0_u32];
        // Runs of the whole picture: first pixel, end, label; and those of the row above.
        let mut runs: Vec<(usize, usize, u32)> = Vec::new();
        let mut above = 0..0;
        for (y, row) in mask.chunks_exact(width).enumerate() {
            let (first, base) = (runs.len(), y * width);
            let (mut x, end) = ends(row).map_or((0, 0), |(a, b)| (a, b + 1));
            let mut candidate = above.start;
            while let Some(start) = row[x..end].iter().position(|v| *v != 0).map(|d| x + d) {
                x = row[start..].iter().position(|v| *v == 0).map_or(width, |d| start + d);
                // Runs above that end before this one's left neighbour can touch none of the later
                // ones either.
                while candidate < above.end && runs[candidate].1 + width < base + start {
                    candidate += 1;
                }
                let mut label = 0;
                for &(_, _, other) in
                    runs[candidate..above.end].iter().take_while(|r| r.0 + width <= base + x)
                {
                    let other = root(&mut parent, other);
                    if label != 0 && label != other {
                        parent[label.max(other) as usize] = label.min(other);
                    }
                    label = if label == 0 { other } else { label.min(other) };
                }
                if label == 0 {
                    label = parent.len() as u32;
                    parent.push(label);
                }
                runs.push((base + start, base + x, label));
            }
            above = first..runs.len();
        }
        let (mut labels, mut sizes) = (mask.map(|_| 0), vec![0; parent.len()]);
        for (start, end, label) in runs {
            let label = root(&mut parent, label);
            labels[start..end].fill(label);
            sizes[label as usize] += end - start;
        }
        Self { labels, sizes }
    }

    /// Which regions have a pixel, of those given, at which something holds.
    pub(super) fn any(&self, is_so: impl Fn(usize) -> bool) -> Vec<bool> {
        let mut any = vec![false; self.sizes.len()];
        for (i, label) in self.labels.iter().enumerate().filter(|(_, label)| **label != 0) {
            any[*label as usize] |= is_so(i);
        }
        any
    }

    /// Which regions reach the border of the picture.
    pub(super) fn at_border(&self) -> Vec<bool> {
        let (w, n) = (self.labels.width, self.labels.len());
        self.any(|i| i < w || i + w >= n || i % w == 0 || i % w == w - 1)
    }

    /// Pixels of the largest region.
    pub(super) fn largest(&self) -> usize {
        self.sizes.iter().copied().max().unwrap_or(0)
    }
}

fn root(parent: &mut [u32], mut label: u32) -> u32 {
    while parent[label as usize] != label {
        parent[label as usize] = parent[parent[label as usize] as usize];
        label = parent[label as usize];
    }
    label
}

/// Convex hull of the pixels that are surely screen (all of the picture where there are hardly
/// any).
pub(crate) fn hull(screen: &BinaryMask) -> Vec<bool> {
    let (width, solid) = (screen.width, screen.erode(3));
    let rows = solid.chunks_exact(width).enumerate();
    let points: Vec<(i64, i64)> = rows
        .filter_map(|(y, row)| ends(row).map(|(a, b)| [(y as i64, a as i64), (y as i64, b as i64)]))
        .flatten()
        .collect();
    if points.len() < 8 {
        return vec![true; screen.len()];
    }
    let (left, right) = (chain(&points, -1), chain(&points, 1));
    let mut inside = vec![false; screen.len()];
    for (y, row) in inside.chunks_exact_mut(width).enumerate() {
        if let (Some(a), Some(b)) = (crossing(&left, y as i64), crossing(&right, y as i64)) {
            let (a, b) = (a.min(b).floor().max(0.0) as usize, a.max(b).ceil() as usize);
            row[a..=b.min(width - 1)].fill(true);
        }
    }
    inside
}

/// The points, sorted by row, on one side of their convex hull (Andrew 1979).
fn chain(points: &[(i64, i64)], side: i64) -> Vec<(i64, i64)> {
    let mut chain: Vec<(i64, i64)> = Vec::new();
    for &p in points {
        // Of the two points of a row only the one on this side can lie on the chain.
        while let [.., o, a] = chain[..]
            && side * ((a.0 - o.0) * (p.1 - o.1) - (a.1 - o.1) * (p.0 - o.0)) >= 0
        {
            chain.pop();
        }
        chain.push(p);
    }
    chain
}

/// Where a chain of points with rising rows crosses row `y`.
fn crossing(chain: &[(i64, i64)], y: i64) -> Option<f64> {
    let i = chain.windows(2).position(|w| w[0].0 <= y && y <= w[1].0)?;
    let (a, b) = (chain[i], chain[i + 1]);
    let t = if b.0 > a.0 { (y - a.0) as f64 / (b.0 - a.0) as f64 } else { 0.0 };
    Some(a.1 as f64 + t * (b.1 - a.1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matting::pool::Pool;

    fn mask<'p>(pool: &'p Pool, width: usize, values: &[u8]) -> BinaryMask<'p> {
        pool.plane(width, values.iter().copied())
    }

    fn regions(width: usize, values: &[u8]) -> usize {
        Regions::of(&mask(&Pool::default(), width, values)).sizes.iter().filter(|s| **s > 0).count()
    }

    #[test]
    fn box_sums_are_exact_to_the_border_of_their_rectangle() {
        let (pool, rect) = (Pool::default(), Rect { x: 1..8, y: 1..6 });
        let plane = pool.plane(9, (0..63).map(|i| ((i * 7) % 11) as f32));
        for r in [0, 1, 2, 9] {
            let mut out = plane.map(|v| *v);
            let mut colours = plane.map(|v| glam::Vec3::new(*v, 0.0, 2.0 * v));
            box_sum(&mut out, &rect, r);
            box_sum(&mut colours, &rect, r);
            for (i, o) in out.iter().enumerate() {
                let (x, y) = (i % 9, i / 9);
                let is_in = |j: usize| rect.x.contains(&(j % 9)) && rect.y.contains(&(j / 9));
                let near = |j: &usize| is_in(*j) && (j % 9).abs_diff(x) <= r && (j / 9).abs_diff(y) <= r;
                let wanted =
                    if is_in(i) { (0..63).filter(near).map(|j| plane[j]).sum::<f32>() } else { plane[i] };
                assert!((o - wanted).abs() < 1e-4, "r {r} pixel {i}: {o} {wanted}");
                assert_eq!(colours[i], glam::Vec3::new(*o, 0.0, 2.0 * o));
            }
        }
        assert_eq!(Rect::around(&mask(&pool, 3, &[0, 0, 0, 0, 1, 0, 0, 0, 0]), 1), Rect { x: 0..3, y: 0..3 });
        let none = Rect::around(&mask(&pool, 1, &[0]), 3);
        box_sum(&mut pool.filled(1, 1, 1.0), &none, 3);
        assert_eq!(rect.mask(&plane, |v| v > 0.0).len(), 35);
    }

    #[test]
    fn masks_grow_and_shrink_and_fall_apart_into_regions() {
        let pool = Pool::default();
        let mut small = pool.filled(8, 48, 0);
        (small[8 + 1], small[4 * 8 + 6]) = (1, 1);
        let grown = small.dilate(1);
        assert_eq!(set_pixels(&grown).count(), 18);
        assert_eq!(set_pixels(&grown.erode(1)).collect::<Vec<_>>(), [0, 1, 8, 9, 38, 39, 46, 47]);
        let regions_of_both = Regions::of(&grown);
        assert_eq!(regions_of_both.sizes[1..].iter().filter(|s| **s > 0).collect::<Vec<_>>(), [&9, &9]);
        assert_ne!(regions_of_both.labels[9], regions_of_both.labels[4 * 8 + 6]);
        // A spiral is one region although its arms get different labels at first.
        assert_eq!(regions(3, &[1, 0, 1, 1, 0, 1, 1, 1, 1]), 1);
        // Corners touch; a gap of one does not.
        assert_eq!(regions(4, &[1, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0]), 1);
        assert_eq!(regions(4, &[1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 1, 0]), 3);
        let frame = Regions::of(&mask(&pool, 4, &[1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0]));
        let inner = frame.labels[10] as usize;
        assert!(frame.at_border()[1] && !frame.at_border()[inner] && frame.largest() == 2);
    }

    #[test]
    fn the_hull_bridges_the_object_and_leaves_out_what_is_beside_the_screen() {
        let (width, height) = (80, 60);
        let screen: Vec<u8> = (0..width * height)
            .map(|i| {
                let (x, y) = (i % width, i / width);
                u8::from((10..70).contains(&x) && (5..55).contains(&y) && !(30..50).contains(&x))
            })
            .collect();
        let pool = Pool::default();
        let inside = hull(&pool.plane(width, screen.into_iter()));
        assert!(inside[30 * width + 40] && inside[20 * width + 20]);
        assert!(!inside[30 * width + 3] && !inside[2 * width + 40] && !inside[58 * width + 40]);
        assert!(hull(&pool.filled(width, 4800, 0)).iter().all(|v| *v));
    }
}
