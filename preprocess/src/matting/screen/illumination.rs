//! The light of the empty screen at every pixel: a smooth field through what is surely screen.

use super::grid::{CellGrid, CellSums};
use crate::matting::colour::{Key, linear};
use glam::Vec4;

/// Light of the screen at one place, as a share of what a first fit says. Source: chosen by hand,
/// never measured.
const SAME_LIGHT: std::ops::Range<f32> = 0.85..1.25;

/// Linear colour and colour difference (`w`) of the screen, from the confident screen pixels of one
/// frame; `None` where there are none.
pub(crate) fn fit(rgb: &[u8], width: usize, key: &Key) -> Option<CellGrid<Vec4>> {
    let first = average(rgb, width, key, None)?;
    average(rgb, width, key, Some(&first))
}

/// Averages in cells what looks like the key's screen or, better, like the screen as it was found
/// `before`.
fn average(rgb: &[u8], width: usize, key: &Key, before: Option<&CellGrid<Vec4>>) -> Option<CellGrid<Vec4>> {
    let height = rgb.len() / 3 / width;
    let (mut cells, mut row) = (CellSums::new(width, height), Vec::new());
    // Every second pixel of every second row tells enough.
    for (y, line) in rgb.chunks_exact(3 * width).enumerate().step_by(2) {
        if let Some(grid) = before {
            grid.row(y, width, &mut row);
        }
        cells.add_row(y, 2, |x| {
            let linear = linear(&line[3 * x..3 * x + 3]);
            let difference = key.difference(linear);
            let is_screen = match row.get(x) {
                Some(screen) => SAME_LIGHT.contains(&(difference / screen.w)),
                None => key.is_like(linear),
            };
            is_screen.then(|| linear.extend(difference))
        });
    }
    cells.fill()
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
        let key = Key::new([0.05, 0.4, 0.1].into()).unwrap();
        let grid = fit(&rgb, width, &key).unwrap();
        let mut row = Vec::new();
        grid.row(64, width, &mut row);
        for x in [4, 30, 75, 120, 155] {
            let (found, wanted) = (row[x].y, 0.8 * light(x, 64));
            assert!((found / wanted - 1.0).abs() < 0.05, "{x}: {found} {wanted}");
        }
        assert!(fit(&vec![90; 3 * width * height], width, &key).is_none());
    }
}
