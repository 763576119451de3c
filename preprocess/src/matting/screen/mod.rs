//! The screen: whether there is one, its light without the object, its shadows, and a frame
//! measured against it.

pub(crate) mod clean_plate;
pub(crate) mod detect;
mod grid;
mod illumination;
mod shadows;

use super::colour::{Key, linear};
use super::morphology::smooth;
use super::pool::{BinaryMask, Pool, Raster};
use clean_plate::CleanPlate;
use detect::quantile;
use glam::Vec3;
use image::RgbImage;

/// A frame, measured against the light of its empty screen.
pub(crate) struct Screen<'p> {
    /// Linear colour of the frame.
    pub image: Raster<'p, Vec3>,
    /// The same of the empty screen.
    pub light: Raster<'p, Vec3>,
    /// Share of the screen's colour difference: 1 on the screen, 0 on the object.
    pub share: Raster<'p, f32>,
    /// The same, smoothed.
    pub smoothed: Raster<'p, f32>,
    /// What always stands there, other than the screen.
    pub fixed: BinaryMask<'p>,
    /// Screen in whatever light: far enough from the object that it cannot be mixed with it.
    pub shaded: BinaryMask<'p>,
}

impl<'p> Screen<'p> {
    /// Of a frame whose screen's light is found in itself; `None` where it cannot.
    pub(super) fn before_field(pool: &'p Pool, frame: &RgbImage, key: &Key) -> Option<Self> {
        let (rgb, width) = (frame.as_raw(), frame.width() as usize);
        let field = illumination::fit(rgb, width, key)?;
        let (mut light, mut row) = (pool.filled(width, 0, Vec3::ZERO), Vec::new());
        for y in 0..frame.height() as usize {
            field.row(y, width, &mut row);
            light.extend(row.iter().map(|l| l.truncate()));
        }
        Some(Self::new(rgb, light, key, std::iter::empty()))
    }

    /// Of a frame of a camera that stands still; what always stands there counts as screen.
    pub(super) fn before_plate(
        pool: &'p Pool,
        frame: &RgbImage,
        key: &Key,
        plate: &CleanPlate,
        keep_pole: bool,
    ) -> Self {
        let rgb = frame.as_raw();
        let standing = plate.others.iter().map(|i| *i as usize).filter(|i| {
            let own = [rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]];
            plate.shows_still(*i, own, keep_pole)
        });
        Self::new(rgb, pool.plane(plate.width, plate.light.iter().copied()), key, standing)
    }

    /// `standing`: pixels that show what always stands there and is no screen.
    fn new(
        rgb: &[u8],
        mut light: Raster<'p, Vec3>,
        key: &Key,
        standing: impl Iterator<Item = usize>,
    ) -> Self {
        let (pool, width) = (light.pool, light.width);
        let image = pool.plane(width, rgb.chunks_exact(3).map(linear));
        let both = image.iter().zip(light.iter());
        let mut share = pool.plane(
            width,
            both.clone().map(|(seen, light)| key.difference(*seen) / (key.difference(*light) + 1e-6)),
        );
        let mut total =
            pool.plane(width, both.map(|(seen, light)| seen.element_sum() / (light.element_sum() + 1e-6)));
        let mut fixed = image.mask(|_| false);
        for i in standing {
            (light[i], share[i], total[i], fixed[i]) = (image[i], 1.0, 1.0, 1);
        }
        let smoothed = smooth(&share);
        let shaded = shadows::find(&smoothed, &total);
        let mut screen = Self { image, light, share, smoothed, fixed, shaded };
        screen.take_out_shadows();
        screen
    }

    /// Brings `light`, `share` and `smoothed` to the light of this frame, measured where the screen
    /// is `shaded`.
    fn take_out_shadows(&mut self) {
        let Some(field) = shadows::measure(&self.smoothed, &self.shaded, &self.fixed) else { return };
        let (width, mut row) = (self.share.width, Vec::new());
        for y in 0..self.share.height() {
            field.row(y, width, &mut row);
            for (i, k) in (y * width..).zip(&row) {
                let k = if self.fixed[i] != 0 { 1.0 } else { *k };
                self.light[i] *= k;
                self.share[i] /= k;
            }
        }
        self.smoothed = smooth(&self.share);
    }

    /// Standard deviation of the empty screen's smoothed share, from its lower half-width.
    pub(super) fn noise(&self) -> f32 {
        let near = self.smoothed.iter().step_by(7).filter(|s| (0.8..1.2).contains(*s));
        let mut samples: Vec<f32> = near.map(|s| (s - 1.0).abs()).collect();
        // Of normal noise the median distance is this part of a standard deviation.
        1.4826 * quantile(&mut samples, 0.5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    /// A grey box before a green screen of which every second pixel is brighter.
    fn frame() -> RgbImage {
        RgbImage::from_fn(96, 64, |x, y| match (x, y) {
            (30..60, 20..44) => Rgb([120, 118, 122]),
            _ => Rgb([40, 168 + 4 * ((x + y) % 2) as u8, 60]),
        })
    }

    #[test]
    fn shares_are_one_on_the_screen_and_none_on_the_object_and_the_scatter_is_measured() {
        let (pool, key) = (Pool::default(), Key::new([0.02, 0.4, 0.045].into()).unwrap());
        let screen = Screen::before_field(&pool, &frame(), &key).unwrap();
        let (empty, object) = (8 * 96 + 8, 32 * 96 + 45);
        assert!((screen.smoothed[empty] - 1.0).abs() < 0.02 && screen.share[object] < 0.05);
        assert!(screen.noise() < 0.02, "smoothing takes a checkerboard out");
    }
}
