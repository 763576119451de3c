//! Values known at some pixels, spread to all: means in square cells, gaps filled from around, interpolated between.

/// A coarse picture of `C` channels over a fine one.
#[derive(Clone, Debug)]
pub(crate) struct Grid<const C: usize> {
    cells: Vec<[f32; C]>,
    columns: usize,
    rows: usize,
    side: usize,
}

/// Sums from which a [`Grid`] is made.
pub(crate) struct Sums<const C: usize> {
    sums: Vec<([f32; C], u32)>,
    width: usize,
    columns: usize,
    side: usize,
}

impl<const C: usize> Sums<C> {
    /// Empty cells of `side` pixels over a picture.
    pub fn new(width: usize, height: usize, side: usize) -> Self {
        let (columns, rows) = (width.div_ceil(side), height.div_ceil(side));
        Self { sums: vec![([0.0; C], 0); columns * rows], width, columns, side }
    }

    /// Counts a pixel.
    #[inline(always)]
    pub fn add(&mut self, x: usize, y: usize, value: [f32; C]) {
        let (sum, count) = &mut self.sums[y / self.side * self.columns + x / self.side];
        for (s, v) in sum.iter_mut().zip(value) {
            *s += v;
        }
        *count += 1;
    }

    /// Counts every second pixel of row `y` that has a value.
    #[inline(always)]
    pub fn add_row(&mut self, y: usize, mut value: impl FnMut(usize) -> Option<[f32; C]>) {
        let row = &mut self.sums[y / self.side * self.columns..][..self.columns];
        let mut x = 0;
        for (cell, (sum, count)) in row.iter_mut().enumerate() {
            let end = ((cell + 1) * self.side).min(self.width);
            while x < end {
                if let Some(value) = value(x) {
                    (0..C).for_each(|k| sum[k] += value[k]);
                    *count += 1;
                }
                x += 2;
            }
        }
    }

    /// Means of the cells that hold at least `needed` pixels; the others are filled from their neighbours, layer by
    /// layer, and relaxed `rounds` times (discrete Laplace equation). `None` where no cell is known.
    pub fn filled(self, needed: u32, rounds: usize) -> Option<Grid<C>> {
        let mean = |(sum, n): &([f32; C], u32)| (*n >= needed).then(|| sum.map(|v| v / *n as f32));
        let known: Vec<Option<[f32; C]>> = self.sums.iter().map(mean).collect();
        known.iter().any(Option::is_some).then(|| Grid {
            rows: known.len() / self.columns,
            cells: filled(known, self.columns, rounds),
            columns: self.columns,
            side: self.side,
        })
    }
}

impl<const C: usize> Grid<C> {
    /// The values along a row of pixels.
    pub fn row(&self, y: usize, width: usize, out: &mut Vec<[f32; C]>) {
        let p = ((y as f32 + 0.5) / self.side as f32 - 0.5).clamp(0.0, (self.rows - 1) as f32);
        let top = (p as usize).min(self.rows.saturating_sub(2));
        let (ty, bottom) = (p - top as f32, (top + 1).min(self.rows - 1));
        let cells = [top, bottom].map(|row| &self.cells[row * self.columns..][..self.columns]);
        let between = |a: &[f32; C], b: &[f32; C], t: f32| {
            let mut v = *a;
            (0..C).for_each(|k| v[k] += t * (b[k] - a[k]));
            v
        };
        let line: Vec<[f32; C]> = cells[0].iter().zip(cells[1]).map(|(a, b)| between(a, b, ty)).collect();
        out.clear();
        // From the middle of one cell to that of the next, and to the borders.
        for left in 0..self.columns.saturating_sub(1).max(1) {
            let end = if left + 2 >= self.columns { width } else { (left + 1) * self.side + self.side / 2 };
            let (a, b) = (line[left], line[(left + 1).min(self.columns - 1)]);
            let middle = (left as f32 + 0.5) * self.side as f32 - 0.5;
            let inverse = 1.0 / self.side as f32;
            let share = |x: usize| ((x as f32 - middle) * inverse).clamp(0.0, 1.0);
            out.extend((out.len()..end).map(|x| between(&a, &b, share(x))));
        }
    }
}

fn filled<const C: usize>(mut cells: Vec<Option<[f32; C]>>, columns: usize, rounds: usize) -> Vec<[f32; C]> {
    let rows = cells.len() / columns;
    let gaps: Vec<usize> = (0..cells.len()).filter(|i| cells[*i].is_none()).collect();
    let neighbours = |i: usize| {
        let (x, y) = (i % columns, i / columns);
        let left = (x > 0).then(|| i - 1);
        let right = (x + 1 < columns).then(|| i + 1);
        let up = (y > 0).then(|| i - columns);
        let down = (y + 1 < rows).then(|| i + columns);
        [left, right, up, down].into_iter().flatten()
    };
    let mut open = gaps.clone();
    while !open.is_empty() {
        let layer: Vec<(usize, [f32; C])> = open
            .iter()
            .filter_map(|i| Some((*i, mean_of(neighbours(*i).filter_map(|j| cells[j]))?)))
            .collect();
        if layer.is_empty() {
            break;
        }
        layer.iter().for_each(|(i, value)| cells[*i] = Some(*value));
        open.retain(|i| cells[*i].is_none());
    }
    let mut cells: Vec<[f32; C]> = cells.into_iter().map(|c| c.unwrap_or([0.0; C])).collect();
    let beside: Vec<Vec<usize>> = gaps.iter().map(|i| neighbours(*i).collect()).collect();
    for _ in 0..rounds {
        for (i, beside) in gaps.iter().zip(&beside) {
            if let Some(mean) = mean_of(beside.iter().map(|j| cells[*j])) {
                cells[*i] = mean;
            }
        }
    }
    cells
}

#[inline(always)]
fn mean_of<const C: usize>(values: impl Iterator<Item = [f32; C]>) -> Option<[f32; C]> {
    let (mut mean, mut n) = ([0.0; C], 0.0);
    for v in values {
        (0..C).for_each(|k| mean[k] += v[k]);
        n += 1.0;
    }
    mean.iter_mut().for_each(|v| *v /= n);
    (n > 0.0).then_some(mean)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_is_carried_over_a_gap_and_an_empty_picture_gives_nothing() {
        let (width, height) = (128, 64);
        let mut sums = Sums::<1>::new(width, height, 8);
        for y in 0..height {
            for x in (0..width).filter(|x| !(40..80).contains(x)) {
                sums.add(x, y, [x as f32]);
            }
        }
        let grid = sums.filled(8, 200).unwrap();
        let mut row = Vec::new();
        grid.row(30, width, &mut row);
        for x in [10, 50, 60, 70, 110] {
            assert!((row[x][0] - x as f32).abs() < 1.5, "{x}: {}", row[x][0]);
        }
        assert!(Sums::<2>::new(9, 9, 8).filled(1, 5).is_none());
    }
}
