//! Images made smaller by the mean over the area of each new pixel.

use image::{ImageBuffer, Pixel};

/// Most pixels in a block whose mean [`whole_means`] takes.
/// Source: derived; sums of 64 bytes and of the rows of a block stay below 2¹⁶.
const WHOLE_LIMIT: usize = 64;
/// What the place of a border between pixels may be off by rounding, pixels. Source: derived; f64
/// places up to 2¹⁶ are exact to 2⁻³⁶, and a share of 10⁻⁶ of a pixel changes no level.
const ROUNDING: f64 = 1e-6;

/// One axis: for each new pixel its first old one and the weights of that and those behind it (sum
/// 1).
struct Axis(Vec<(usize, Vec<f32>)>);

impl Axis {
    fn new(from: usize, to: usize) -> Self {
        let scale = from as f64 / to as f64;
        let new = (0..to).map(|i| {
            let (start, end) = (i as f64 * scale, ((i + 1) as f64 * scale).min(from as f64));
            // An end that exceeds a border between pixels by rounding alone takes nothing from
            // behind it.
            let (first, last) = ((start + ROUNDING).floor(), (end - ROUNDING).ceil());
            let covered = (0..(last - first) as u32).map(|k| {
                let left = first + f64::from(k);
                ((left + 1.0).min(end) - left.max(start)) as f32
            });
            let weights: Vec<f32> = covered.collect();
            let sum: f32 = weights.iter().sum();
            (first as usize, weights.iter().map(|w| w / sum).collect())
        });
        Self(new.collect())
    }
}

/// The mean over each new pixel's area, rounded to the nearest level, halves upwards.
/// `width`, `height`: at least 1, at most the image's.
pub(crate) fn shrunk<P>(image: &ImageBuffer<P, Vec<u8>>, width: u32, height: u32) -> ImageBuffer<P, Vec<u8>>
where
    P: Pixel<Subpixel = u8>,
{
    let channels = usize::from(P::CHANNEL_COUNT);
    let size = (image.width() as usize, image.height() as usize);
    let new = (width as usize, height as usize);
    let factors = (size.0 / new.0, size.1 / new.1);
    let whole = size == (new.0 * factors.0, new.1 * factors.1) && factors.0 * factors.1 <= WHOLE_LIMIT;
    let out = match (whole, channels) {
        (true, 1) => whole_means::<1>(image.as_raw(), size.0, factors),
        (true, 3) => whole_means::<3>(image.as_raw(), size.0, factors),
        _ => weighted_means(image.as_raw(), size, new, channels),
    };
    ImageBuffer::from_raw(width, height, out).unwrap_or_else(|| ImageBuffer::new(width, height))
}

/// Means of blocks of `factors` pixels, of lines of `width` pixels of `C` channels.
fn whole_means<const C: usize>(image: &[u8], width: usize, factors: (usize, usize)) -> Vec<u8> {
    let count = (factors.0 * factors.1) as u32;
    let mut sums = vec![0_u16; C * width];
    let mut out = Vec::with_capacity(image.len() / count as usize);
    for rows in image.chunks_exact(C * width * factors.1) {
        sums.fill(0);
        for row in rows.chunks_exact(C * width) {
            sums.iter_mut().zip(row).for_each(|(sum, v)| *sum += u16::from(*v));
        }
        for block in sums.chunks_exact(C * factors.0) {
            let mut total = [count / 2; C];
            for pixel in block.chunks_exact(C) {
                total.iter_mut().zip(pixel).for_each(|(t, v)| *t += u32::from(*v));
            }
            out.extend_from_slice(&total.map(|t| (t / count) as u8));
        }
    }
    out
}

/// Means where borders of new pixels cut old ones.
fn weighted_means(image: &[u8], size: (usize, usize), new: (usize, usize), channels: usize) -> Vec<u8> {
    let line = size.0 * channels;
    let (columns, rows) = (Axis::new(size.0, new.0), Axis::new(size.1, new.1));
    let mut sums = vec![0.0_f32; line];
    let mut out = Vec::with_capacity(new.0 * new.1 * channels);
    for (first, weights) in &rows.0 {
        sums.fill(0.0);
        for (old, weight) in image.chunks_exact(line).skip(*first).zip(weights) {
            sums.iter_mut().zip(old).for_each(|(sum, v)| *sum += weight * f32::from(*v));
        }
        for (first, weights) in &columns.0 {
            for channel in 0..channels {
                let old = sums[first * channels + channel..].iter().step_by(channels);
                let mean: f32 = old.zip(weights).map(|(v, w)| v * w).sum();
                out.push((mean + 0.5) as u8);
            }
        }
    }
    out
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
        assert_eq!(shrunk(&image, 2, 1).into_raw(), expected.map(|v: f32| v.round() as u8));
        let colours = RgbImage::from_fn(6, 4, |x, y| Rgb([x as u8, y as u8, 200]));
        assert_eq!(shrunk(&colours, 3, 2).get_pixel(1, 1).0, [3, 3, 200], "halves are rounded up");
    }

    #[test]
    fn whole_factors_give_the_level_of_the_exact_mean() {
        for (width, height) in [(2, 2), (3, 3), (4, 4), (6, 6), (8, 8), (5, 7), (1, 64)] {
            let count = width * height;
            for sum in 0..=255 * count {
                let level = |i: u32| (sum / count + u32::from(i < sum % count)) as u8;
                let image = GrayImage::from_fn(width, height, |x, y| Luma([level(y * width + x)]));
                let mean = (2 * sum + count) / (2 * count);
                assert_eq!(shrunk(&image, 1, 1).as_raw()[..], [mean as u8], "{sum} of {width} x {height}");
            }
        }
    }

    #[test]
    fn no_size_changes_the_level_of_a_flat_image() {
        let image = RgbImage::from_pixel(97, 61, Rgb([255, 7, 128]));
        for (width, height) in [(96, 60), (50, 61), (33, 7), (1, 1), (97, 61)] {
            let small = shrunk(&image, width, height);
            assert_eq!(small.dimensions(), (width, height));
            assert!(small.pixels().all(|p| p.0 == [255, 7, 128]), "{width} x {height}");
        }
    }
}
