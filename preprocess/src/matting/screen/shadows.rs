//! Shadows and reflections on the screen: its light in this frame, as a factor on what it is without them.

use super::Screen;
use super::grid::Cells;
use crate::matting::morphology::smooth;
use crate::matting::pool::{Mask, Plane};

/// Cells in which the light is measured, pixels, and the pixels that one needs.
const CELL: (usize, u32) = (6, 3);
/// Rounds of relaxation under the object.
const ROUNDS: usize = 6;
/// Light of a shadow and of a reflection, as a share of the screen's.
const RANGE: std::ops::Range<f32> = 0.05..1.7;
/// Least purity of screen in a shadow: colour difference by light, as a share of the screen's.
const PURITY: f32 = 0.9;
/// A pixel this much brighter than the screen and this much less pure (share by light) is an object: chroma of 4:2:0 video
/// spreads in coded values, and in linear light the screen's weighs more on bright pixels than on its own dark ones.
const GLARE: (f32, f32) = (1.5, 0.6);

/// Marks the screen in whatever light it is: its hue is the screen's, its light (`total`) any. What is mixed with the object is a
/// band; what survives an opening is not. Between parts of the object there is less room: with half the smoothing a smaller opening
/// is enough.
pub(super) fn find<'p>(share: &Plane<'p, f32>, total: &Plane<'p, f32>) -> Mask<'p> {
    let once = smooth(total);
    let mut shaded = open(&smooth(share), &smooth(&once), 2);
    shaded.iter_mut().zip(open(share, &once, 1).iter()).for_each(|(s, n)| *s |= n);
    shaded
}

fn open<'p>(share: &Plane<'p, f32>, total: &Plane<'p, f32>, radius: usize) -> Mask<'p> {
    let is_screen =
        |(s, t): (&f32, &f32)| u8::from((*s > RANGE.start) & (*s < RANGE.end) & (*s > PURITY * t));
    let candidates = share.pool.plane(share.width, share.iter().zip(total.iter()).map(is_screen));
    candidates.erode(radius).dilate(radius)
}

impl Screen<'_> {
    /// Brings `light`, `share` and `smoothed` to the light of this frame, measured where the screen is `shaded`.
    pub(super) fn take_out_shadows(&mut self, total: &[f32]) {
        let (width, height) = (self.share.width, self.share.height());
        let near_fixed = self.fixed.dilate(1);
        let mut cells = Cells::new(width, height, CELL.0);
        for y in (0..height).step_by(2) {
            let line = y * width..(y + 1) * width;
            let (shaded, fixed, smoothed) =
                (&self.shaded[line.clone()], &near_fixed[line.clone()], &self.smoothed[line]);
            cells.add_row(y, 2, |x| (shaded[x] > fixed[x]).then_some(smoothed[x]));
        }
        let Some(field) = cells.fill(CELL.1, ROUNDS) else { return };
        let mut row = Vec::new();
        for y in 0..height {
            field.row(y, width, &mut row);
            for (i, k) in (y * width..).zip(&row) {
                let k = if self.fixed[i] != 0 { 1.0 } else { *k };
                self.light[i] *= k;
                self.share[i] = without_glare(self.share[i] / k, total[i] / k);
            }
        }
        self.smoothed = smooth(&self.share);
    }
}

/// The share of a pixel with `total` times the screen's light, without what chroma from around adds to a bright one: that weighs
/// by the slope of linear light over coded values, for gamma 2 the root of the light.
#[inline(always)]
pub(super) fn without_glare(share: f32, total: f32) -> f32 {
    if total > GLARE.0 && share > 0.0 && share < GLARE.1 * total {
        share * (GLARE.0 / total).sqrt()
    } else {
        share
    }
}

#[cfg(test)]
mod tests {
    use crate::matting::colour::{Key, srgb8};
    use crate::matting::pool::Pool;
    use crate::matting::screen::Screen;
    use image::{Rgb, RgbImage};

    #[test]
    fn a_shadow_on_the_screen_is_taken_for_screen_and_an_object_is_not() {
        let light = [0.05, 0.4, 0.1_f32];
        let frame = RgbImage::from_fn(120, 90, |x, y| {
            let shade = if (10..50).contains(&x) && (20..70).contains(&y) { 0.4 } else { 1.0 };
            let is_object = (70..100).contains(&x) && (20..70).contains(&y);
            Rgb(if is_object { [120, 110, 100] } else { light.map(|v| srgb8(shade * v)) })
        });
        let (pool, key) = (Pool::default(), Key::new(light.into(), 1.0 / 3f32.sqrt()).unwrap());
        let screen = Screen::before_field(&pool, &frame, &key).unwrap();
        let at = |x: usize, y: usize| y * 120 + x;
        assert_eq!([(30, 45), (5, 5), (85, 45)].map(|(x, y)| screen.shaded[at(x, y)]), [1, 1, 0]);
        assert!((screen.smoothed[at(30, 45)] - 1.0).abs() < 0.05, "the shadow's light is the screen's here");
        assert!((screen.light[at(30, 45)].y / 0.16 - 1.0).abs() < 0.05 && screen.share[at(85, 45)] < 0.1);
    }
}
