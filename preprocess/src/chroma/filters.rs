//! Small image filters on float and byte planes, row-major; windows are cut at the border.

/// Mean over windows of `(2r + 1)²`, into `out`; `rows` is scratch of the same size.
pub(crate) fn box_mean(plane: &[f32], width: usize, r: usize, rows: &mut Vec<f32>, out: &mut Vec<f32>) {
    let height = plane.len() / width;
    rows.clear();
    rows.resize(plane.len(), 0.0);
    out.clear();
    out.resize(plane.len(), 0.0);
    for (source, target) in plane.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        let mut sum: f32 = source[..r.min(width)].iter().sum();
        for x in 0..width {
            if x + r < width {
                sum += source[x + r];
            }
            if x > r {
                sum -= source[x - r - 1];
            }
            let count = (x + r).min(width - 1) + 1 - x.saturating_sub(r);
            target[x] = sum / count as f32;
        }
    }
    let mut sums = vec![0.0_f32; width];
    for y in 0..r.min(height) {
        add(&mut sums, &rows[y * width..][..width], 1.0);
    }
    for y in 0..height {
        if y + r < height {
            add(&mut sums, &rows[(y + r) * width..][..width], 1.0);
        }
        if y > r {
            add(&mut sums, &rows[(y - r - 1) * width..][..width], -1.0);
        }
        let scale = 1.0 / ((y + r).min(height - 1) + 1 - y.saturating_sub(r)) as f32;
        for (o, s) in out[y * width..][..width].iter_mut().zip(&sums) {
            *o = s * scale;
        }
    }
}

fn add(sums: &mut [f32], row: &[f32], sign: f32) {
    sums.iter_mut().zip(row).for_each(|(s, v)| *s += sign * v);
}

/// Binomial 3 × 3 smoothing; the border repeats.
pub(crate) fn smooth(plane: &[f32], width: usize, out: &mut Vec<f32>) {
    let height = plane.len() / width;
    out.clear();
    out.resize(plane.len(), 0.0);
    let mut column = vec![0.0_f32; width + 2];
    for y in 0..height {
        let (up, down) = (y.saturating_sub(1), (y + 1).min(height - 1));
        let rows = [up, y, down].map(|y| &plane[y * width..][..width]);
        for (x, c) in column[1..=width].iter_mut().enumerate() {
            *c = 0.25 * (rows[0][x] + rows[2][x]) + 0.5 * rows[1][x];
        }
        column[0] = column[1];
        column[width + 1] = column[width];
        for (x, o) in out[y * width..][..width].iter_mut().enumerate() {
            *o = 0.25 * (column[x] + column[x + 2]) + 0.5 * column[x + 1];
        }
    }
}

/// Grows the non-zero part of a byte mask by `r` pixels in every direction (a square).
pub(crate) fn dilate(mask: &[u8], width: usize, r: usize) -> Vec<u8> {
    let height = mask.len() / width;
    let mut rows = mask.to_vec();
    for d in 1..=r.min(width.saturating_sub(1)) {
        for (source, target) in mask.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
            target[d..].iter_mut().zip(source).for_each(|(t, s)| *t |= s);
            target.iter_mut().zip(&source[d..]).for_each(|(t, s)| *t |= s);
        }
    }
    let mut out = rows.clone();
    for d in 1..=r.min(height.saturating_sub(1)) {
        out[d * width..].iter_mut().zip(&rows).for_each(|(t, s)| *t |= s);
        out.iter_mut().zip(&rows[d * width..]).for_each(|(t, s)| *t |= s);
    }
    out
}

/// Shrinks the non-zero part by `r` pixels; the border does not shrink it.
pub(crate) fn erode(mask: &[u8], width: usize, r: usize) -> Vec<u8> {
    let mut out: Vec<u8> = mask.iter().map(|v| u8::from(*v == 0)).collect();
    out = dilate(&out, width, r);
    out.iter_mut().for_each(|v| *v = u8::from(*v == 0));
    out
}

/// Connected regions (8 neighbours) of the non-zero part: a label for every pixel (0 outside) and, by label, the
/// number of pixels; element 0 is unused.
pub(crate) fn components(mask: &[u8], width: usize) -> (Vec<u32>, Vec<usize>) {
    let mut labels = vec![0_u32; mask.len()];
    let mut parent = vec![0_u32];
    for i in 0..mask.len() {
        if mask[i] == 0 {
            continue;
        }
        let (x, y) = (i % width, i / width);
        let mut label = 0;
        let mut join = |other: u32, parent: &mut Vec<u32>| {
            if other == 0 {
                return;
            }
            let other = root(parent, other);
            if label == 0 {
                label = other;
            } else if label != other {
                let (low, high) = (label.min(other), label.max(other));
                parent[high as usize] = low;
                label = low;
            }
        };
        if x > 0 {
            join(labels[i - 1], &mut parent);
        }
        if y > 0 {
            join(labels[i - width], &mut parent);
            if x > 0 {
                join(labels[i - width - 1], &mut parent);
            }
            if x + 1 < width {
                join(labels[i - width + 1], &mut parent);
            }
        }
        if label == 0 {
            label = parent.len() as u32;
            parent.push(label);
        }
        labels[i] = label;
    }
    let mut sizes = vec![0; parent.len()];
    for l in &mut labels {
        if *l != 0 {
            *l = root(&mut parent, *l);
            sizes[*l as usize] += 1;
        }
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
    fn box_means_are_exact_to_the_border() {
        let plane: Vec<f32> = (0..35).map(|i| ((i * 7) % 11) as f32).collect();
        let (mut rows, mut out) = (Vec::new(), Vec::new());
        for r in [0, 1, 2, 9] {
            box_mean(&plane, 7, r, &mut rows, &mut out);
            for (i, o) in out.iter().enumerate() {
                let (x, y) = (i % 7, i / 7);
                let near = |j: &usize| (j % 7).abs_diff(x) <= r && (j / 7).abs_diff(y) <= r;
                let window: Vec<f32> = (0..35).filter(near).map(|j| plane[j]).collect();
                let mean = window.iter().sum::<f32>() / window.len() as f32;
                assert!((o - mean).abs() < 1e-5, "r {r} pixel {i}: {o} {mean}");
            }
        }
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
    }
}
