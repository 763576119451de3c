//! The light of the empty screen at every pixel: a smooth field through what is surely screen.

use crate::matting::colour::{Key, LINEAR};
use crate::matting::screen::grid::{Grid, Sums};

/// Side of a cell, pixels.
const CELL: usize = 16;
/// Pixels that a cell needs to count.
const NEEDED: u32 = 24;

/// Linear colour and colour difference of the screen, on a coarse grid, interpolated between.
#[derive(Clone, Debug)]
pub(crate) struct Field(Grid<4>);

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
        let (table, mut sums) = (&*LINEAR, Sums::new(width, height, CELL));
        for (y, line) in rgb.chunks_exact(3 * width).enumerate() {
            // Every second pixel of every second row tells enough.
            if y % 2 == 1 {
                continue;
            }
            sums.add_row(y, |x| {
                let p = &line[3 * x..3 * x + 3];
                let linear = [table[usize::from(p[0])], table[usize::from(p[1])], table[usize::from(p[2])]];
                accept(linear, x, y).map(|d| [linear[0], linear[1], linear[2], d])
            });
        }
        let rounds = 2 * (width + height) / CELL;
        sums.filled(NEEDED, rounds).map(Self)
    }

    /// Red, green, blue and colour difference of the screen along a row of pixels.
    pub fn row(&self, y: usize, width: usize, out: &mut Vec<[f32; 4]>) {
        self.0.row(y, width, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matting::colour::srgb8;

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
