//! Images made smaller by the mean over the area of each new pixel.

use image::{ImageBuffer, Pixel};

/// One axis: for each new pixel its first old one and the weights of that and those behind it (sum 1).
struct Axis(Vec<(usize, Vec<f32>)>);

impl Axis {
    fn new(from: u32, to: u32) -> Self {
        let scale = f64::from(from) / f64::from(to);
        let new = (0..to).map(|i| {
            let (start, end) = (f64::from(i) * scale, (f64::from(i + 1) * scale).min(f64::from(from)));
            // An end that exceeds a border between pixels by rounding alone takes nothing from behind it.
            let (first, last) = ((start + 1e-6).floor(), (end - 1e-6).ceil());
            let covered = |k: u32| {
                let left = first + f64::from(k);
                ((left + 1.0).min(end) - left.max(start)) as f32
            };
            let weights: Vec<f32> = (0..(last - first) as u32).map(covered).collect();
            let sum: f32 = weights.iter().sum();
            (first as usize, weights.iter().map(|w| w / sum).collect())
        });
        Self(new.collect())
    }
}

/// The mean over each new pixel's area, as `level` rounds it. `width`, `height`: at least 1, at most the image's.
pub(crate) fn shrunk<P>(
    image: &ImageBuffer<P, Vec<u8>>,
    (width, height): (u32, u32),
    level: impl Fn(f32) -> u8,
) -> ImageBuffer<P, Vec<u8>>
where
    P: Pixel<Subpixel = u8>,
{
    let channels = usize::from(P::CHANNEL_COUNT);
    let line = image.width() as usize * channels;
    let (columns, rows) = (Axis::new(image.width(), width), Axis::new(image.height(), height));
    let mut sums = vec![0.0_f32; line];
    let mut out = Vec::with_capacity(width as usize * height as usize * channels);
    for (first, weights) in &rows.0 {
        sums.fill(0.0);
        for (old, weight) in image.as_raw().chunks_exact(line).skip(*first).zip(weights) {
            sums.iter_mut().zip(old).for_each(|(sum, v)| *sum += weight * f32::from(*v));
        }
        for (first, weights) in &columns.0 {
            for channel in 0..channels {
                let old = sums[first * channels + channel..].iter().step_by(channels);
                let mean: f32 = old.zip(weights).map(|(v, w)| v * w).sum();
                out.push(level(mean));
            }
        }
    }
    ImageBuffer::from_raw(width, height, out).unwrap_or_else(|| ImageBuffer::new(width, height))
}

/// The nearest level; halves upwards.
pub(crate) fn nearest(mean: f32) -> u8 {
    (mean + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, Luma, Rgb, RgbImage};

    #[test]
    fn every_new_pixel_is_the_mean_of_what_it_covers() {
        let image = GrayImage::from_fn(5, 2, |x, y| Luma([(10 * x + 100 * y) as u8]));
        // Halves of the middle column go to either side.
        let expected = [(0.0 + 10.0 + 0.5 * 20.0) / 2.5 + 50.0, (0.5 * 20.0 + 30.0 + 40.0) / 2.5 + 50.0];
        assert_eq!(shrunk(&image, (2, 1), nearest).into_raw(), expected.map(|v: f32| v.round() as u8));
        let colours = RgbImage::from_fn(6, 4, |x, y| Rgb([x as u8, y as u8, 200]));
        assert_eq!(shrunk(&colours, (3, 2), nearest).get_pixel(1, 1).0, [3, 3, 200], "halves are rounded up");
    }

    #[test]
    fn no_size_changes_the_level_of_a_flat_image() {
        let image = RgbImage::from_pixel(97, 61, Rgb([255, 7, 128]));
        for (width, height) in [(96, 60), (50, 61), (33, 7), (1, 1), (97, 61)] {
            let small = shrunk(&image, (width, height), nearest);
            assert_eq!(small.dimensions(), (width, height));
            assert!(small.pixels().all(|p| p.0 == [255, 7, 128]), "{width} x {height}");
        }
    }
}
