//! Shadows and reflections on the screen: its light in this frame, as a factor on what it is without them.

use crate::matting::morphology::{dilate, erode, smooth};
use crate::matting::pool::Mask;
use crate::matting::screen::grid::Sums;
use crate::matting::solve::Workspace;

/// Cells in which the light is measured, pixels, and the pixels that one needs.
const CELL: (usize, u32) = (6, 3);
/// Rounds of relaxation under the object.
const ROUNDS: usize = 6;
/// Light of a shadow and of a reflection, as a share of the screen's.
const RANGE: std::ops::Range<f32> = 0.05..1.7;
/// Least purity of screen in a shadow: colour difference by light, as a share of the screen's.
const PURITY: f32 = 0.9;
/// What is mixed with the object is a band; what survives an opening with this radius is not, pixels. Between parts of the
/// object there is less room: with half the smoothing a smaller opening is enough.
const OPENING: (usize, usize) = (2, 1);
/// A pixel this much brighter than the screen and this much less pure (share by light) is an object: chroma of 4:2:0 video
/// spreads in coded values, and in linear light the screen's weighs more on bright pixels than on its own dark ones.
const GLARE: (f32, f32) = (1.5, 0.6);

impl Workspace {
    /// Finds the screen in whatever light it is (its hue is the screen's, its light any), marks it in `shaded`, and
    /// brings `screen`, `share` and `smoothed` to the light of this frame.
    pub(crate) fn take_out_shadows(&mut self, width: usize) {
        let mut total = std::mem::take(&mut self.mean);
        let [mut once, mut share, other] = std::mem::take(&mut self.around);
        smooth(&self.total, width, &mut once);
        smooth(&once, width, &mut total);
        smooth(&self.smoothed, width, &mut share);
        let opened = |share: &[f32], total: &[f32], radius| {
            let screen =
                |(s, t): (&f32, &f32)| u8::from((*s > RANGE.start) & (*s < RANGE.end) & (*s > PURITY * t));
            let candidates: Mask = share.iter().zip(total).map(screen).collect();
            dilate(&erode(&candidates, width, radius), width, radius)
        };
        self.shaded = opened(&share, &total, OPENING.0);
        let narrow = opened(&self.smoothed, &once, OPENING.1);
        self.shaded.iter_mut().zip(&narrow).for_each(|(s, n)| *s |= n);
        (self.mean, self.around) = (total, [once, share, other]);
        let height = self.share.len() / width;
        let near_still = dilate(&self.still, width, 1);
        let mut sums = Sums::<1>::new(width, height, CELL.0);
        for y in (0..height).step_by(2) {
            let line = y * width..(y + 1) * width;
            let (shaded, still) = (&self.shaded[line.clone()], &near_still[line.clone()]);
            let smoothed = &self.smoothed[line];
            sums.add_row(y, |x| (shaded[x] > still[x]).then_some([smoothed[x]]));
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
            let light = self.total[line.clone()].iter().zip(&row);
            for (v, (t, k)) in self.share[line].iter_mut().zip(light) {
                *v = without_glare(*v / k[0], t / k[0]);
            }
        }
        smooth(&self.share, width, &mut self.smoothed);
    }
}

/// The share of a pixel with `total` times the screen's light, without what chroma from around adds to a bright one: that weighs
/// by the slope of linear light over coded values, for gamma 2 the root of the light.
#[inline(always)]
pub(crate) fn without_glare(share: f32, total: f32) -> f32 {
    if total > GLARE.0 && share > 0.0 && share < GLARE.1 * total {
        share * (GLARE.0 / total).sqrt()
    } else {
        share
    }
}
