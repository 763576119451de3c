//! Values known at some pixels, spread to all: means in square cells, gaps filled from around,
//! interpolated between.

use std::ops::{Add, Div, Mul, Sub};

/// What can be averaged and interpolated.
pub(crate) trait Interpolate:
    Copy + Default + Add<Output = Self> + Sub<Output = Self> + Mul<f32, Output = Self> + Div<f32, Output = Self>
{
}

impl<T> Interpolate for T where
    T: Copy + Default + Add<Output = T> + Sub<Output = T> + Mul<f32, Output = T> + Div<f32, Output = T>
{
}

/// Side of a cell, pixels, and the pixels that it needs to count.
/// Source: `key_table` is the same to 0.0001 of IoU with 6 and 16 pixels.
const SIDE: usize = 8;
/// Rounds of relaxation. Source: `key_table` is the same with 200.
const ROUNDS: usize = 16;

/// A coarse picture over a fine one.
#[derive(Clone, Debug)]
pub(crate) struct CellGrid<V> {
    cells: Vec<V>,
    columns: usize,
    rows: usize,
}

/// Sums from which a [`CellGrid`] is made.
pub(crate) struct CellSums<V> {
    sums: Vec<(V, u32)>,
    width: usize,
    columns: usize,
}

impl<V: Interpolate> CellSums<V> {
    /// Empty cells over a picture.
    pub(super) fn new(width: usize, height: usize) -> Self {
        let (columns, rows) = (width.div_ceil(SIDE), height.div_ceil(SIDE));
        Self { sums: vec![(V::default(), 0); columns * rows], width, columns }
    }

    /// Counts every `step`-th pixel of row `y` that has a value.
    #[inline(always)]
    pub(super) fn add_row(&mut self, y: usize, step: usize, mut value: impl FnMut(usize) -> Option<V>) {
        let row = &mut self.sums[y / SIDE * self.columns..][..self.columns];
        let mut x = 0;
        for (cell, (sum, count)) in row.iter_mut().enumerate() {
            let end = ((cell + 1) * SIDE).min(self.width);
            while x < end {
                if let Some(value) = value(x) {
                    *sum = *sum + value;
                    *count += 1;
                }
                x += step;
            }
        }
    }

    /// Means of the cells; those that hold too few pixels are filled from their neighbours, layer
    /// by layer, and relaxed (discrete Laplace equation). `None` where no cell is known.
    pub(super) fn fill(self) -> Option<CellGrid<V>> {
        let (columns, rows) = (self.columns, self.sums.len() / self.columns);
        let mut cells: Vec<Option<V>> =
            self.sums.iter().map(|(sum, n)| (*n as usize >= SIDE).then(|| *sum / *n as f32)).collect();
        let gaps: Vec<(usize, Vec<usize>)> = (0..cells.len())
            .filter(|i| cells[*i].is_none())
            .map(|i| (i, neighbours(i, columns, rows).collect()))
            .collect();
        if gaps.len() == cells.len() {
            return None;
        }
        while cells.iter().any(Option::is_none) {
            let before = cells.clone();
            for (i, beside) in gaps.iter().filter(|(i, _)| before[*i].is_none()) {
                cells[*i] = mean_of(beside.iter().filter_map(|j| before[*j]));
            }
        }
        let mut cells: Vec<V> = cells.into_iter().map(Option::unwrap_or_default).collect();
        for (i, beside) in (0..ROUNDS).flat_map(|_| &gaps) {
            cells[*i] = mean_of(beside.iter().map(|j| cells[*j])).unwrap_or(cells[*i]);
        }
        Some(CellGrid { cells, columns, rows })
    }
}

/// The cells left, right, above and below.
fn neighbours(i: usize, columns: usize, rows: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (i % columns, i / columns);
    let beside =
        [(x > 0, -1), (x + 1 < columns, 1), (y > 0, -(columns as isize)), (y + 1 < rows, columns as isize)];
    beside.into_iter().filter(|(is_inside, _)| *is_inside).map(move |(_, step)| i.wrapping_add_signed(step))
}

#[inline(always)]
fn mean_of<V: Interpolate>(values: impl Iterator<Item = V>) -> Option<V> {
    let (sum, n) = values.fold((V::default(), 0.0), |(sum, n), v| (sum + v, n + 1.0));
    (n > 0.0).then(|| sum / n)
}

impl<V: Interpolate> CellGrid<V> {
    /// The values along a row of pixels.
    pub(super) fn row(&self, y: usize, width: usize, out: &mut Vec<V>) {
        let p = ((y as f32 + 0.5) / SIDE as f32 - 0.5).clamp(0.0, (self.rows - 1) as f32);
        let top = (p as usize).min(self.rows.saturating_sub(2));
        let [above, below] = [top, (top + 1).min(self.rows - 1)].map(|row| &self.cells[row * self.columns..]);
        let line: Vec<V> = (0..self.columns).map(|k| between(above[k], below[k], p - top as f32)).collect();
        out.clear();
        // From the middle of one cell to that of the next, and to the borders.
        let inverse = 1.0 / SIDE as f32;
        for left in 0..self.columns.saturating_sub(1).max(1) {
            let end = if left + 2 >= self.columns { width } else { (left + 1) * SIDE + SIDE / 2 };
            let (a, b) = (line[left], line[(left + 1).min(self.columns - 1)]);
            let middle = (left as f32 + 0.5) * SIDE as f32 - 0.5;
            out.extend(
                (out.len()..end).map(|x| between(a, b, ((x as f32 - middle) * inverse).clamp(0.0, 1.0))),
            );
        }
    }
}

/// Linear interpolation.
#[inline(always)]
fn between<V: Interpolate>(a: V, b: V, t: f32) -> V {
    a + (b - a) * t
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_is_carried_over_a_gap_and_an_empty_picture_gives_nothing() {
        let (width, height) = (128, 64);
        let mut cells = CellSums::<f32>::new(width, height);
        for y in 0..height {
            cells.add_row(y, 1, |x| (!(40..80).contains(&x)).then_some(x as f32));
        }
        let grid = cells.fill().unwrap();
        let mut row = Vec::new();
        grid.row(30, width, &mut row);
        for x in [10, 50, 60, 70, 110] {
            assert!((row[x] - x as f32).abs() < 1.5, "{x}: {}", row[x]);
        }
        assert!(CellSums::<f32>::new(9, 9).fill().is_none());
    }
}
