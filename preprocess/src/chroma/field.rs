//! The light of the empty screen at every pixel: a smooth field through what is surely screen.

use super::colour::{Key, LINEAR};

/// Side of a cell, pixels.
const CELL: usize = 16;
/// Pixels that a cell needs to count.
const NEEDED: usize = 24;

/// Linear colour and colour difference of the screen, on a coarse grid, interpolated between.
#[derive(Clone, Debug)]
pub(crate) struct Field {
    cells: Vec<[f32; 4]>,
    columns: usize,
    rows: usize,
}

impl Field {
    /// From the confident screen pixels of one frame; `None` where there are none.
    pub fn fit(rgb: &[u8], width: usize, key: &Key) -> Option<Self> {
        let reference = key.difference(key.colour);
        let purity = reference / (key.colour[0] + key.colour[1] + key.colour[2]);
        let first = Self::average(rgb, width, |linear, _, _| {
            let d = key.difference(linear);
            (d > 0.08 * reference && d > 0.7 * purity * (linear[0] + linear[1] + linear[2])).then_some(d)
        })?;
        let mut row = Vec::new();
        let mut at = usize::MAX;
        Self::average(rgb, width, |linear, x, y| {
            if at != y {
                first.row(y, width, &mut row);
                at = y;
            }
            let (d, b) = (key.difference(linear), &row[x]);
            (d > 0.85 * b[3] && d < 1.25 * b[3]).then_some(d)
        })
    }

    /// Averages in cells those pixels whose difference `accept` returns; fills the others from their neighbours.
    fn average(
        rgb: &[u8],
        width: usize,
        mut accept: impl FnMut([f32; 3], usize, usize) -> Option<f32>,
    ) -> Option<Self> {
        let height = rgb.len() / 3 / width;
        let (columns, rows) = (width.div_ceil(CELL), height.div_ceil(CELL));
        let mut sums = vec![([0.0_f32; 4], 0_usize); columns * rows];
        for (y, line) in rgb.chunks_exact(3 * width).enumerate() {
            // Every second pixel of every second row tells enough.
            if y % 2 == 1 {
                continue;
            }
            for (x, p) in line.chunks_exact(3).enumerate().step_by(2) {
                let linear =
                    [LINEAR[usize::from(p[0])], LINEAR[usize::from(p[1])], LINEAR[usize::from(p[2])]];
                if let Some(d) = accept(linear, x, y) {
                    let (sum, count) = &mut sums[y / CELL * columns + x / CELL];
                    for (s, v) in sum.iter_mut().zip([linear[0], linear[1], linear[2], d]) {
                        *s += v;
                    }
                    *count += 1;
                }
            }
        }
        let mean = |(sum, n): &([f32; 4], usize)| (*n >= NEEDED).then(|| sum.map(|v| v / *n as f32));
        let known: Vec<Option<[f32; 4]>> = sums.iter().map(mean).collect();
        known.iter().any(Option::is_some).then(|| Self { cells: filled(known, columns), columns, rows })
    }

    /// Red, green, blue and colour difference of the screen along a row of pixels.
    pub fn row(&self, y: usize, width: usize, out: &mut Vec<[f32; 4]>) {
        out.clear();
        let position = |i: usize, n: usize| {
            let p = ((i as f32 + 0.5) / CELL as f32 - 0.5).clamp(0.0, (n - 1) as f32);
            let low = (p as usize).min(n.saturating_sub(2));
            (low, p - low as f32)
        };
        let (top, ty) = position(y, self.rows);
        let bottom = (top + 1).min(self.rows - 1);
        let column = |c: usize| {
            let (a, b) = (&self.cells[top * self.columns + c], &self.cells[bottom * self.columns + c]);
            [0, 1, 2, 3].map(|k| a[k] + ty * (b[k] - a[k]))
        };
        let line: Vec<[f32; 4]> = (0..self.columns).map(column).collect();
        out.extend((0..width).map(|x| {
            let (left, tx) = position(x, self.columns);
            let (a, b) = (&line[left], &line[(left + 1).min(self.columns - 1)]);
            [
                a[0] + tx * (b[0] - a[0]),
                a[1] + tx * (b[1] - a[1]),
                a[2] + tx * (b[2] - a[2]),
                a[3] + tx * (b[3] - a[3]),
            ]
        }));
    }
}

/// Unknown cells get the mean of known neighbours, layer by layer, and are then relaxed (discrete Laplace equation).
fn filled(mut cells: Vec<Option<[f32; 4]>>, columns: usize) -> Vec<[f32; 4]> {
    let rows = cells.len() / columns;
    let fixed: Vec<bool> = cells.iter().map(Option::is_some).collect();
    let neighbours = |i: usize| {
        let (x, y) = (i % columns, i / columns);
        let left = (x > 0).then(|| i - 1);
        let right = (x + 1 < columns).then(|| i + 1);
        let up = (y > 0).then(|| i - columns);
        let down = (y + 1 < rows).then(|| i + columns);
        [left, right, up, down].into_iter().flatten()
    };
    while cells.iter().any(Option::is_none) {
        let next: Vec<_> = (0..cells.len())
            .map(|i| cells[i].or_else(|| mean_of(neighbours(i).filter_map(|j| cells[j]))))
            .collect();
        if next.iter().filter(|c| c.is_some()).count() == cells.iter().filter(|c| c.is_some()).count() {
            break;
        }
        cells = next;
    }
    let mut cells: Vec<[f32; 4]> = cells.into_iter().map(Option::unwrap_or_default).collect();
    for _ in 0..2 * (columns + rows) {
        for i in (0..cells.len()).filter(|i| !fixed[*i]) {
            if let Some(mean) = mean_of(neighbours(i).map(|j| cells[j])) {
                cells[i] = mean;
            }
        }
    }
    cells
}

fn mean_of(values: impl Iterator<Item = [f32; 4]>) -> Option<[f32; 4]> {
    let (mut sum, mut n) = ([0.0; 4], 0.0);
    for v in values {
        (0..4).for_each(|k| sum[k] += v[k]);
        n += 1.0;
    }
    (n > 0.0).then(|| sum.map(|s| s / n))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chroma::colour::srgb8;

    #[test]
    fn the_light_behind_an_object_is_interpolated_from_around_it() {
        let (width, height) = (160, 128);
        let light = |x: usize, y: usize| 0.4 + 0.002 * x as f32 + 0.001 * y as f32;
        let mut rgb = Vec::new();
        for i in 0..width * height {
            let (x, y) = (i % width, i / width);
            let l = light(x, y);
            let inside = (40..110).contains(&x) && (30..100).contains(&y);
            let linear = if inside { [0.3, 0.25, 0.2] } else { [0.1 * l, 0.8 * l, 0.2 * l] };
            rgb.extend(linear.map(srgb8));
        }
        let key = Key::new([0.05, 0.4, 0.1], 1.0 / 3f32.sqrt()).unwrap();
        let field = Field::fit(&rgb, width, &key).unwrap();
        let mut row = Vec::new();
        field.row(64, width, &mut row);
        for x in [4, 30, 75, 120, 155] {
            assert!(
                (row[x][1] / (0.8 * light(x, 64)) - 1.0).abs() < 0.05,
                "{x}: {} {}",
                row[x][1],
                0.8 * light(x, 64)
            );
        }
        assert!(Field::fit(&vec![90; 3 * width * height], width, &key).is_none());
    }
}
