//! Small image filters on float and byte planes, row-major; windows are cut at the border.

use crate::matting::pool::{Mask, Reused};

/// A part of a picture: columns and rows.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Rect {
    /// Columns.
    pub x: std::ops::Range<usize>,
    /// Rows.
    pub y: std::ops::Range<usize>,
}

impl Rect {
    /// The smallest around the non-zero part of a mask, grown by `margin`, within the picture.
    pub fn around(mask: &[u8], width: usize, margin: usize) -> Self {
        let mut x = std::ops::Range { start: width, end: 0 }; // empty until a pixel is seen
        let mut y = std::ops::Range { start: usize::MAX, end: 0 };
        for (row, line) in mask.chunks_exact(width).enumerate().filter(|(_, line)| !is_empty(line)) {
            if let (Some(a), Some(b)) =
                (line.iter().position(|v| *v != 0), line.iter().rposition(|v| *v != 0))
            {
                x = x.start.min(a)..x.end.max(b + 1);
                y = y.start.min(row)..row + 1;
            }
        }
        if y.end == 0 {
            return Self { x: 0..0, y: 0..0 };
        }
        let height = mask.len() / width;
        Self {
            x: x.start.saturating_sub(margin)..(x.end + margin).min(width),
            y: y.start.saturating_sub(margin)..(y.end + margin).min(height),
        }
    }

    /// Indices of its pixels in a picture of this width, row by row.
    pub fn rows(&self, width: usize) -> impl Iterator<Item = std::ops::Range<usize>> + use<> {
        let x = self.x.clone();
        self.y.clone().map(move |y| y * width + x.start..y * width + x.end)
    }

    /// A mask of its pixels alone, row by row.
    pub fn mask(&self, width: usize, is_set: impl Fn(usize) -> bool) -> Mask {
        let mut mask = Mask::filled(0, self.x.len() * self.y.len());
        for (line, row) in mask.chunks_exact_mut(self.x.len().max(1)).zip(self.rows(width)) {
            line.iter_mut().zip(row).for_each(|(v, i)| *v = u8::from(is_set(i)));
        }
        mask
    }
}

/// Whether nothing is set.
fn is_empty(mask: &[u8]) -> bool {
    mask.iter().fold(0, |all, v| all | v) == 0
}

/// Indices of what is set, in order.
pub(crate) fn set_pixels(mask: &[u8]) -> impl Iterator<Item = usize> {
    const RUN: usize = 64;
    mask.chunks(RUN)
        .enumerate()
        .filter(|(_, run)| !is_empty(run))
        .flat_map(|(k, run)| run.iter().enumerate().filter(|(_, v)| **v != 0).map(move |(j, _)| RUN * k + j))
}

/// Sums over windows of `(2r + 1)²` that lie in `rect` (outside of it values count as 0), in place; `scratch` is reused.
pub(crate) fn box_sum(plane: &mut [f32], width: usize, rect: &Rect, r: usize, scratch: &mut Vec<f32>) {
    let (w, h) = (rect.x.len(), rect.y.len());
    scratch.resize(w * h, 0.0);
    for (y, target) in rect.y.clone().zip(scratch.chunks_exact_mut(w.max(1))) {
        let source = &plane[y * width + rect.x.start..][..w];
        target.copy_from_slice(source);
        for d in 1..=r.min(w.saturating_sub(1)) {
            add(&mut target[d..], source);
            add(target, &source[d..]);
        }
    }
    // Summed anew for every row: a running sum would leave rounding errors larger than the smallest weights.
    for y in 0..h {
        let target = &mut plane[(rect.y.start + y) * width + rect.x.start..][..w];
        let (first, rest) = scratch[y.saturating_sub(r) * w..(y + r + 1).min(h) * w].split_at(w);
        target.copy_from_slice(first);
        rest.chunks_exact(w).for_each(|row| add(target, row));
    }
}

/// The same by running sums: four additions a pixel whatever `r` is, at the price of rounding errors of about 1e-4 of the largest
/// value.
pub(crate) fn box_sum_running(
    plane: &mut [f32],
    width: usize,
    rect: &Rect,
    r: usize,
    scratch: &mut Vec<f32>,
) {
    let (w, h) = (rect.x.len(), rect.y.len());
    scratch.resize(w * h, 0.0);
    for (y, target) in rect.y.clone().zip(scratch.chunks_exact_mut(w.max(1))) {
        let source = &plane[y * width + rect.x.start..][..w];
        let mut sum: f32 = source.iter().take(r).sum();
        for (x, t) in target.iter_mut().enumerate() {
            sum += source.get(x + r).copied().unwrap_or(0.0);
            *t = sum;
            sum -= if x >= r { source[x - r] } else { 0.0 };
        }
    }
    let mut sums = vec![0.0_f32; w];
    for row in scratch.chunks_exact(w.max(1)).take(r) {
        add(&mut sums, row);
    }
    for y in 0..h {
        if y + r < h {
            add(&mut sums, &scratch[(y + r) * w..][..w]);
        }
        plane[(rect.y.start + y) * width + rect.x.start..][..w].copy_from_slice(&sums);
        if y >= r {
            sums.iter_mut().zip(&scratch[(y - r) * w..][..w]).for_each(|(s, v)| *s -= v);
        }
    }
}

fn add(sums: &mut [f32], row: &[f32]) {
    sums.iter_mut().zip(row).for_each(|(s, v)| *s += v);
}

/// Binomial 3 × 3 smoothing; the border repeats.
pub(crate) fn smooth(plane: &[f32], width: usize, out: &mut Vec<f32>) {
    smooth_within(plane, width, &Rect { x: 0..width, y: 0..plane.len() / width }, out);
}

/// The same in the rows and columns of `rect` only, beside which values count as those at its border.
pub(crate) fn smooth_within(plane: &[f32], width: usize, rect: &Rect, out: &mut Vec<f32>) {
    out.resize(plane.len(), 0.0);
    let (w, last) = (rect.x.len(), rect.y.end.saturating_sub(1));
    if w == 0 {
        return;
    }
    let mut column = vec![0.0_f32; w + 2];
    for y in rect.y.clone() {
        let (up, down) = (y.saturating_sub(1).max(rect.y.start), (y + 1).min(last));
        let rows = [up, y, down].map(|y| &plane[y * width + rect.x.start..][..w]);
        for (x, c) in column[1..=w].iter_mut().enumerate() {
            *c = 0.25 * (rows[0][x] + rows[2][x]) + 0.5 * rows[1][x];
        }
        column[0] = column[1];
        column[w + 1] = column[w];
        for (x, o) in out[y * width + rect.x.start..][..w].iter_mut().enumerate() {
            *o = 0.25 * (column[x] + column[x + 2]) + 0.5 * column[x + 1];
        }
    }
}

/// Grows the non-zero part of a byte mask by `r` pixels in every direction (a square).
pub(crate) fn dilate(mask: &[u8], width: usize, r: usize) -> Mask {
    let height = mask.len() / width;
    let mut rows = Mask::of(mask);
    if r == 0 {
        return rows;
    }
    for d in 1..=r.min(width.saturating_sub(1)) {
        for (source, target) in mask.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
            target[d..].iter_mut().zip(source).for_each(|(t, s)| *t |= s);
            target.iter_mut().zip(&source[d..]).for_each(|(t, s)| *t |= s);
        }
    }
    let mut out = Mask::of(&rows);
    for d in 1..=r.min(height.saturating_sub(1)) {
        out[d * width..].iter_mut().zip(&rows).for_each(|(t, s)| *t |= s);
        out.iter_mut().zip(&rows[d * width..]).for_each(|(t, s)| *t |= s);
    }
    out
}

/// Shrinks the non-zero part by `r` pixels; the border does not shrink it.
pub(crate) fn erode(mask: &[u8], width: usize, r: usize) -> Mask {
    let mut out: Mask = mask.iter().map(|v| u8::from(*v == 0)).collect();
    out = dilate(&out, width, r);
    out.iter_mut().for_each(|v| *v = u8::from(*v == 0));
    out
}

/// Connected regions (8 neighbours) of the non-zero part: a label for every pixel (0 outside) and, by label, the
/// number of pixels; element 0 is unused. Works on runs of pixels: rows are joined where runs touch.
pub(crate) fn components(mask: &[u8], width: usize) -> (Reused<u32>, Vec<usize>) {
    let mut labels = Reused::filled(0, mask.len());
    let mut parent = vec![0_u32];
    // Runs of the whole picture: first pixel, end, label; and those of the row above.
    let mut runs: Vec<(usize, usize, u32)> = Vec::new();
    let mut above = 0..0;
    for (y, row) in mask.chunks_exact(width).enumerate() {
        let (first, base) = (runs.len(), y * width);
        let (mut x, mut candidate) = (if is_empty(row) { width } else { 0 }, above.start);
        while let Some(start) = row[x..].iter().position(|v| *v != 0).map(|d| x + d) {
            x = row[start..].iter().position(|v| *v == 0).map_or(width, |d| start + d);
            // Runs above that end before this one's left neighbour can touch none of the later ones either.
            while candidate < above.end && runs[candidate].1 + width < base + start {
                candidate += 1;
            }
            let mut label = 0;
            let touching = runs[candidate..above.end].iter().take_while(|r| r.0 + width <= base + x);
            for &(_, _, other) in touching {
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
    let mut sizes = vec![0; parent.len()];
    for (start, end, label) in runs {
        let label = root(&mut parent, label);
        labels[start..end].fill(label);
        sizes[label as usize] += end - start;
    }
    (labels, sizes)
}

fn root(parent: &mut [u32], mut label: u32) -> u32 {
    while parent[label as usize] != label {
        parent[label as usize] = parent[parent[label as usize] as usize];
        label = parent[label as usize];
    }
    label
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn box_sums_are_exact_to_the_border_of_their_rectangle() {
        let plane: Vec<f32> = (0..63).map(|i| ((i * 7) % 11) as f32).collect();
        let rect = Rect { x: 1..8, y: 1..6 };
        for r in [0, 1, 2, 9] {
            let mut out = plane.clone();
            box_sum(&mut out, 9, &rect, r, &mut Vec::new());
            for (i, o) in out.iter().enumerate() {
                let (x, y) = (i % 9, i / 9);
                let is_in = |j: usize| rect.x.contains(&(j % 9)) && rect.y.contains(&(j / 9));
                let near = |j: &usize| is_in(*j) && (j % 9).abs_diff(x) <= r && (j / 9).abs_diff(y) <= r;
                let wanted =
                    if is_in(i) { (0..63).filter(near).map(|j| plane[j]).sum::<f32>() } else { plane[i] };
                assert!((o - wanted).abs() < 1e-4, "r {r} pixel {i}: {o} {wanted}");
            }
            let mut running = plane.clone();
            box_sum_running(&mut running, 9, &rect, r, &mut Vec::new());
            assert!(running.iter().zip(&out).all(|(a, b)| (a - b).abs() < 1e-3), "r {r}");
        }
        assert_eq!(Rect::around(&[0, 0, 0, 0, 1, 0, 0, 0, 0], 3, 1), Rect { x: 0..3, y: 0..3 });
        box_sum(&mut [1.0], 1, &Rect::around(&[0], 1, 3), 3, &mut Vec::new());
        box_sum_running(&mut [1.0], 1, &Rect::around(&[0], 1, 3), 3, &mut Vec::new());
    }

    #[test]
    fn what_is_set_is_found_in_order() {
        let mask: Vec<u8> =
            (0..1000).map(|i| u8::from(i == 0 || i == 999 || (300..390).contains(&i))).collect();
        let wanted: Vec<usize> = (0..1000).filter(|i| mask[*i] != 0).collect();
        assert_eq!(set_pixels(&mask).collect::<Vec<_>>(), wanted);
        assert_eq!(set_pixels(&[]).count(), 0);
    }

    #[test]
    fn masks_grow_and_shrink_and_fall_apart_into_regions() {
        let mut mask = vec![0; 48];
        mask[8 + 1] = 1;
        mask[4 * 8 + 6] = 1;
        let grown = dilate(&mask, 8, 1);
        assert_eq!(grown.iter().filter(|v| **v != 0).count(), 18);
        assert_eq!(erode(&grown, 8, 1)[9], 1);
        let (labels, sizes) = components(&grown, 8);
        assert_eq!(sizes.iter().filter(|s| **s > 0).copied().collect::<Vec<_>>(), [9, 9]);
        assert_ne!(labels[9], labels[4 * 8 + 6]);
        // A spiral is one region although its arms get different labels at first.
        let spiral = [1, 0, 1, 1, 0, 1, 1, 1, 1].to_vec();
        assert_eq!(components(&spiral, 3).1.iter().filter(|s| **s > 0).count(), 1);
        // Corners touch; a gap of one does not.
        assert_eq!(
            components(&[1, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0], 4).1.iter().filter(|s| **s > 0).count(),
            1
        );
        assert_eq!(
            components(&[1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 1, 0], 4).1.iter().filter(|s| **s > 0).count(),
            3
        );
    }
}
