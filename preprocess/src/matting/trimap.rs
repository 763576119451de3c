//! What is surely object, what is surely screen, and the band between, where alpha has to be
//! solved.

use super::colour::{Key, coded, levels};
use super::morphology::set_pixels;
use super::pool::BinaryMask;
use super::screen::Screen;

/// Least departure from the screen that counts, share of its colour difference.
/// Source: `key_table` is the same from 0.03 to 0.1.
const MIN_DEPARTURE: f32 = 0.06;
/// Inside of solid parts, what keeps this share of the screen's coded colour difference is a slit.
/// Source: `key_table`: at 0.5 the IoU of lego before blue falls by 0.0006.
const SLIT_SHARE: f32 = 0.6;

/// The parts of a frame by what they are.
pub(crate) struct Trimap<'p> {
    /// What departs from the screen, and two pixels around it.
    pub not_screen: BinaryMask<'p>,
    /// Surely object.
    pub core: BinaryMask<'p>,
    /// Object that shows its own colour: all of it but its rim.
    pub interior: BinaryMask<'p>,
    /// Neither surely screen nor surely object.
    pub band: BinaryMask<'p>,
}

impl<'p> Trimap<'p> {
    /// Of a frame, given the scatter of its screen's smoothed share.
    pub(super) fn new(screen: &Screen<'p>, noise: f32, rgb: &[u8], key: &Key) -> Self {
        let threshold = 1.0 - MIN_DEPARTURE.max(5.0 * noise);
        let mut seeds = screen.smoothed.mask(|s| s < threshold);
        seeds.iter_mut().zip(screen.shaded.iter()).for_each(|(seed, shaded)| *seed &= 1 - shaded);
        let not_screen = seeds.dilate(2);
        let mut solid = screen.smoothed.mask(|s| s < 0.5);
        let mut core = solid.erode(2);
        let slits = find_slits(&core, screen, rgb, key);
        solid.iter_mut().zip(slits.iter()).for_each(|(solid, slit)| *solid &= 1 - slit);
        core.iter_mut().zip(slits.dilate(2).iter()).for_each(|(core, near)| *core &= 1 - near);
        let mut band = not_screen.map(|v| *v);
        band.iter_mut().zip(core.iter()).for_each(|(band, core)| *band &= 1 - core);
        Self { interior: solid.erode(1), not_screen, core, band }
    }
}

/// Slits of one or two pixels between bright parts: 4:2:0 averages coded chroma, and in linear
/// light what is left of the screen's looks like a tint of the bright parts. What keeps
/// [`SLIT_SHARE`] of the screen's colour difference in coded values is solved, not solid.
fn find_slits<'p>(core: &BinaryMask<'p>, screen: &Screen, rgb: &[u8], key: &Key) -> BinaryMask<'p> {
    let mut slits = core.map(|_| 0);
    for i in set_pixels(core) {
        let kept = key.difference(levels(&rgb[3 * i..]));
        // Most of the object keeps nothing, whatever the screen's light.
        if kept > SLIT_SHARE && kept > SLIT_SHARE * key.difference(coded(screen.light[i])) {
            slits[i] = 1;
        }
    }
    slits
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matting::pool::Pool;
    use image::{Rgb, RgbImage};

    /// Panels before a green screen: a grey one at the left, two bright ones with a slit of a pixel
    /// between, and a faint stain on the screen.
    fn panels() -> RgbImage {
        RgbImage::from_fn(120, 60, |x, y| match (x, y) {
            (20..50, 15..45) => Rgb([120, 118, 122]),
            (85, 15..45) => Rgb([140, 220, 145]),
            (70..100, 15..45) => Rgb([225, 220, 215]),
            (5..9, 50..54) => Rgb([52, 166, 70]),
            _ => Rgb([40, 170, 60]),
        })
    }

    #[test]
    fn parts_are_told_apart_and_a_slit_between_bright_panels_is_not_solid() {
        let (pool, image) = (Pool::default(), panels());
        let key = Key::new([0.02, 0.4, 0.045].into()).unwrap();
        let screen = Screen::before_field(&pool, &image, &key).unwrap();
        let trimap = Trimap::new(&screen, 0.0, image.as_raw(), &key);
        let at = |mask: &BinaryMask, x: usize, y: usize| mask[y * 120 + x];
        assert_eq!([at(&trimap.core, 35, 30), at(&trimap.core, 75, 30), at(&trimap.core, 60, 30)], [1, 1, 0]);
        assert_eq!([at(&trimap.band, 20, 30), at(&trimap.band, 35, 30), at(&trimap.band, 60, 30)], [1, 0, 0]);
        assert_eq!([at(&trimap.core, 85, 30), at(&trimap.band, 85, 30)], [0, 1], "the slit");
        assert_eq!(at(&trimap.not_screen, 6, 52), 0, "a stain departs too little");
    }
}
