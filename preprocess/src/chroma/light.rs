//! Shadows and reflections on the screen: its light in this frame, as a factor on what it is without them.

use super::alpha::Workspace;
use super::filters::{dilate, erode, smooth};
use super::grid::Sums;

/// Cells in which the light is measured, pixels, and the pixels that one needs.
const CELL: (usize, u32) = (8, 6);
/// Rounds of relaxation under the object.
const ROUNDS: usize = 16;
/// Light of a shadow and of a reflection, as a share of the screen's.
const RANGE: std::ops::Range<f32> = 0.12..1.7;
/// Least purity of screen in a shadow: colour difference by light, as a share of the screen's.
const PURITY: f32 = 0.85;
/// What is mixed with the object is a band; what survives an opening with this radius is not, pixels.
const OPENING: usize = 2;

impl Workspace {
    /// Finds the screen in whatever light it is (its hue is the screen's, its light any), marks it in `shaded`, and
    /// brings `screen`, `share` and `smoothed` to the light of this frame.
    pub(super) fn take_out_shadows(&mut self, width: usize) {
        let mut total = std::mem::take(&mut self.mean);
        let mut twice = Vec::new();
        smooth(&self.total, width, &mut twice);
        smooth(&twice, width, &mut total);
        smooth(&self.smoothed, width, &mut twice);
        let candidates: Vec<u8> = twice
            .iter()
            .zip(total.iter().zip(&self.still))
            .map(|(s, (t, still))| {
                u8::from((*s > RANGE.start) & (*s < RANGE.end) & (*s > PURITY * t) & (*still == 0))
            })
            .collect();
        self.mean = total;
        self.shaded = dilate(&erode(&candidates, width, OPENING), width, OPENING);
        let height = self.share.len() / width;
        let mut sums = Sums::<1>::new(width, height, CELL.0);
        for y in (0..height).step_by(2) {
            for x in (0..width).step_by(2).filter(|x| self.shaded[y * width + x] != 0) {
                sums.add(x, y, [self.smoothed[y * width + x]]);
            }
        }
        let Some(light) = sums.filled(CELL.1, ROUNDS) else { return };
        let mut row = Vec::new();
        for y in 0..height {
            light.row(y, width, &mut row);
            let line = y * width..(y + 1) * width;
            for (k, _) in row.iter_mut().zip(&self.still[line.clone()]).filter(|(_, still)| **still != 0) {
                *k = [1.0];
            }
            for plane in &mut self.screen {
                plane[line.clone()].iter_mut().zip(&row).for_each(|(v, k)| *v *= k[0]);
            }
            for plane in [&mut self.share, &mut self.smoothed] {
                plane[line.clone()].iter_mut().zip(&row).for_each(|(v, k)| *v /= k[0]);
            }
        }
    }
}
