//! From a decoded frame to an upright one with square pixels and the right colours; sharpness and
//! similarity.

use crate::area;
use crate::probe::{Turn, VideoInfo};
use image::imageops::{self, FilterType};
use image::{GrayImage, RgbImage};
use std::borrow::Cow;

/// Longest side at which sharpness is measured, pixels: sensor noise is averaged away, blur is not.
/// Source: chosen by hand, never measured.
const SHARPNESS_SIDE: u32 = 640;
/// Longest side of the pictures that are compared for similarity and in which a screen is looked
/// for, pixels. Source: chosen by hand, never measured.
pub const THUMBNAIL_SIDE: u32 = 160;
/// A Gaussian of standard deviation 1 pixel at a distance of 2, 1 and 0 pixels, in 1/256. Source:
/// derived; exp(-x²/2) over its sum, 0.0545, 0.2442 and 0.4026, rounded so that the sum is 1.
const GAUSSIAN: [u32; 3] = [14, 62, 104];

/// Width and height that fit into `max_size` (0: as they are), at least one pixel each.
pub(crate) fn fitted(width: u32, height: u32, max_size: u32) -> (u32, u32) {
    let longest = width.max(height);
    if max_size == 0 || longest <= max_size {
        return (width, height);
    }
    [width, height]
        .map(|v| (f64::from(v) * f64::from(max_size) / f64::from(longest)).round().max(1.0) as u32)
        .into()
}

/// Area average where it shrinks, cubic where it grows.
fn resized(image: &RgbImage, (width, height): (u32, u32)) -> Cow<'_, RgbImage> {
    if image.dimensions() == (width, height) {
        Cow::Borrowed(image)
    } else if width <= image.width() && height <= image.height() {
        Cow::Owned(area::shrunk(image, width, height))
    } else {
        Cow::Owned(imageops::resize(image, width, height, FilterType::CatmullRom))
    }
}

/// The picture as it is to be seen.
fn turned(mut image: RgbImage, turn: Turn) -> RgbImage {
    if turn.mirror {
        imageops::flip_horizontal_in_place(&mut image);
    }
    match turn.quarters % 4 {
        1 => imageops::rotate90(&image),
        2 => imageops::rotate180(&image),
        3 => imageops::rotate270(&image),
        _ => image,
    }
}

/// Upright sRGB of a decoded frame: square pixels, size, turn, colour matrix. `correct_matrix`: the
/// frame was converted by the Rec. 601 matrix although it is coded by Rec. 709.
pub(crate) fn finished(rgb: &RgbImage, info: &VideoInfo, max_size: u32, correct_matrix: bool) -> RgbImage {
    let (w, h) = rgb.dimensions();
    let square = if (info.pixel_aspect - 1.0).abs() < 0.005 {
        (w, h)
    } else if info.pixel_aspect > 1.0 {
        ((f64::from(w) * info.pixel_aspect).round() as u32, h)
    } else {
        (w, (f64::from(h) / info.pixel_aspect).round() as u32)
    };
    let sized = resized(rgb, fitted(square.0, square.1, max_size));
    let mut upright = turned(sized.into_owned(), info.turn);
    if correct_matrix {
        upright.pixels_mut().for_each(|p| p.0 = rec709_from_rec601(p.0));
    }
    upright
}

/// Undoes the Rec. 601 decoding matrix and applies that of Rec. 709 (ITU-R BT.601, BT.709: Y, Cb,
/// Cr from Kr, Kb); limited-range scaling is the same for both and cancels.
fn rec709_from_rec601([r, g, b]: [u8; 3]) -> [u8; 3] {
    let (r, g, b) = (f32::from(r), f32::from(g), f32::from(b));
    let y = 0.299 * r + 0.587 * g + 0.114 * b;
    let (cb, cr) = ((b - y) / 1.772, (r - y) / 1.402);
    [y + 1.5748 * cr, y - 0.187_32 * cb - 0.468_12 * cr, y + 1.8556 * cb]
        .map(|v| (v + 0.5).clamp(0.0, 255.0) as u8)
}

/// What decides between frames, from luma averaged down.
pub(crate) struct Look {
    /// Variance of the Laplacian of Gaussian over the variance of luma: the same at any exposure.
    pub sharpness: f64,
    /// Small luma picture.
    pub thumbnail: Vec<u8>,
    /// Its width and height.
    pub size: (u32, u32),
}

impl Look {
    /// Of a decoded frame.
    pub(crate) fn of(rgb: &RgbImage) -> Self {
        let (w, h) = fitted(rgb.width(), rgb.height(), SHARPNESS_SIDE);
        let luma = luma_of(&resized(rgb, (w, h)));
        let smooth = smoothed(&luma);
        let edges = laplacian(&smooth);
        let levels = smooth.as_raw().iter().map(|v| i16::from(*v));
        let sharpness = (deviation(edges.into_iter()) / (deviation(levels) + 0.5)).powi(2);
        let (tw, th) = fitted(w, h, THUMBNAIL_SIDE);
        let thumbnail = area::shrunk(&luma, tw, th).into_raw();
        Self { sharpness, thumbnail, size: (tw, th) }
    }

    /// Difference that all but one pixel in 200 stay below, 8-bit levels: moving texture shows even
    /// where the object is small in the picture.
    pub(crate) fn difference(&self, other: &Self) -> f32 {
        if self.thumbnail.len() != other.thumbnail.len() {
            return f32::INFINITY;
        }
        let mut counts = [0_usize; 256];
        for (a, b) in self.thumbnail.iter().zip(&other.thumbnail) {
            counts[usize::from(a.abs_diff(*b))] += 1;
        }
        let mut rest = self.thumbnail.len() / 200;
        for (level, count) in counts.iter().enumerate().rev() {
            if *count > rest {
                return level as f32;
            }
            rest -= count;
        }
        0.0
    }
}

/// Luma of gamma-coded values in 1/32768 (ITU-R BT.601: 0.299, 0.587, 0.114).
fn luma_of(rgb: &RgbImage) -> GrayImage {
    let levels = rgb.pixels().map(|p| {
        let [r, g, b] = p.0.map(u32::from);
        ((9798 * r + 19_235 * g + 3735 * b + (1 << 14)) >> 15) as u8
    });
    GrayImage::from_raw(rgb.width(), rgb.height(), levels.collect()).unwrap_or_default()
}

/// A 5 x 5 Gaussian of standard deviation 1 pixel; mirrored at the borders.
fn smoothed(image: &GrayImage) -> GrayImage {
    let (w, h) = (image.width() as usize, image.height() as usize);
    let row = |y: isize| &image.as_raw()[w * mirrored(y, h)..][..w];
    let (mut columns, mut padded) = (vec![0_u32; w], vec![0_u32; w + 4]);
    let mut out = Vec::with_capacity(w * h);
    for y in 0..h as isize {
        let [a, b, c, d, e] = [-2, -1, 0, 1, 2].map(|dy| row(y + dy));
        for (x, sum) in columns.iter_mut().enumerate() {
            let [a, b, c, d, e] = [a[x], b[x], c[x], d[x], e[x]].map(u32::from);
            *sum = GAUSSIAN[0] * (a + e) + GAUSSIAN[1] * (b + d) + GAUSSIAN[2] * c;
        }
        padded[2..w + 2].copy_from_slice(&columns);
        for (place, x) in [(0, -2), (1, -1), (w + 2, w as isize), (w + 3, w as isize + 1)] {
            padded[place] = columns[mirrored(x, w)];
        }
        out.extend((0..w).map(|x| {
            let p = &padded[x..x + 5];
            let sum = GAUSSIAN[0] * (p[0] + p[4]) + GAUSSIAN[1] * (p[1] + p[3]) + GAUSSIAN[2] * p[2];
            ((sum + (1 << 15)) >> 16) as u8
        }));
    }
    GrayImage::from_raw(image.width(), image.height(), out).unwrap_or_default()
}

/// Sum of the four neighbours less four times the pixel, of every pixel; mirrored at the borders.
fn laplacian(image: &GrayImage) -> Vec<i16> {
    let (w, h) = (image.width() as usize, image.height() as usize);
    let row = |y: isize| &image.as_raw()[w * mirrored(y, h)..][..w];
    let mut out = Vec::with_capacity(w * h);
    let mut padded = vec![0_u8; w + 2];
    for y in 0..h as isize {
        let (above, here, below) = (row(y - 1), row(y), row(y + 1));
        padded[1..=w].copy_from_slice(here);
        (padded[0], padded[w + 1]) = (here[mirrored(-1, w)], here[mirrored(w as isize, w)]);
        out.extend((0..w).map(|x| {
            let [a, l, c, r, b] = [above[x], padded[x], here[x], padded[x + 2], below[x]].map(i16::from);
            a + l + r + b - 4 * c
        }));
    }
    out
}

/// The place inside `0..n` of one outside it: mirrored about the first and the last.
fn mirrored(i: isize, n: usize) -> usize {
    let last = n as isize - 1;
    (last - (last - i.abs()).abs()).clamp(0, last) as usize
}

/// Standard deviation; 0 of nothing.
fn deviation(values: impl ExactSizeIterator<Item = i16>) -> f64 {
    let count = values.len().max(1) as f64;
    let (mut sum, mut squares) = (0_i64, 0_i64);
    for value in values.map(i64::from) {
        (sum, squares) = (sum + value, squares + value * value);
    }
    let mean = sum as f64 / count;
    (squares as f64 / count - mean * mean).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    fn chart(gain: f32, blur: u32) -> RgbImage {
        let level = |x: u32, y: u32| if ((x / 13) + (y / 17)).is_multiple_of(2) { 220.0 } else { 40.0 };
        let sharp = RgbImage::from_fn(320, 240, |x, y| Rgb([(level(x, y) * gain) as u8; 3]));
        let half = blur / 2;
        let mean = |x: u32, y: u32| {
            let near = |v: u32, n: u32| v.saturating_sub(half)..=(v + half).min(n - 1);
            let levels = near(y, 240).flat_map(|y| near(x, 320).map(move |x| (x, y)));
            let levels: Vec<u32> = levels.map(|(x, y)| u32::from(sharp[(x, y)][0])).collect();
            Rgb([(levels.iter().sum::<u32>() / levels.len() as u32) as u8; 3])
        };
        RgbImage::from_fn(320, 240, mean)
    }

    #[test]
    fn sharpness_falls_with_blur_and_not_with_exposure() {
        let sharp = Look::of(&chart(1.0, 1)).sharpness;
        let dark = Look::of(&chart(0.25, 1)).sharpness;
        let blurred = Look::of(&chart(1.0, 7)).sharpness;
        assert!((dark / sharp - 1.0).abs() < 0.1, "{dark} {sharp}");
        assert!(blurred < 0.5 * sharp && blurred < 0.5 * dark, "{blurred} {sharp}");
        let black = Look::of(&RgbImage::new(64, 48));
        assert_eq!(black.sharpness, 0.0);
    }

    #[test]
    fn the_edge_filters_answer_a_point_by_their_kernels() {
        let mut point = GrayImage::new(9, 9);
        point.put_pixel(4, 4, image::Luma([255]));
        let smooth = smoothed(&point);
        let expected = |dx: usize, dy: usize| {
            let weight = |d: usize| (-0.5 * (d as f64).powi(2)).exp() / 2.4837;
            255.0 * weight(dx) * weight(dy)
        };
        for (x, y, v) in smooth.enumerate_pixels() {
            let (dx, dy) = (x.abs_diff(4) as usize, y.abs_diff(4) as usize);
            let value = if dx.max(dy) <= 2 { expected(dx, dy) } else { 0.0 };
            assert!((f64::from(v[0]) - value).abs() < 1.0, "{x} {y} {} {value}", v[0]);
        }
        let edges = laplacian(&point);
        assert_eq!((edges[40], edges[39], edges[31], edges[30]), (-1020, 255, 255, 0));
        let mut corner = GrayImage::new(3, 3);
        corner.put_pixel(1, 0, image::Luma([7]));
        assert_eq!(laplacian(&corner)[0], 14, "mirrored about the first pixel");
        assert_eq!([-2, -1, 0, 4, 5, 6].map(|i| mirrored(i, 5)), [2, 1, 0, 4, 3, 2]);
    }

    #[test]
    fn sizes_fit_and_never_vanish() {
        assert_eq!(fitted(1920, 1080, 640), (640, 360));
        assert_eq!(fitted(320, 240, 640), (320, 240));
        assert_eq!(fitted(10_000, 1, 100), (100, 1));
    }

    #[test]
    fn the_matrix_correction_undoes_the_wrong_decoding() {
        // Y, Cb, Cr of a saturated green in Rec. 709, decoded by 601, must come back.
        let (y, cb, cr) = (0.7152 * 180.0, -0.7152 * 180.0 / 1.8556, -0.7152 * 180.0 / 1.5748);
        let wrong = [y + 1.402 * cr, y - 0.344_14 * cb - 0.714_14 * cr, y + 1.772 * cb]
            .map(|v: f32| v.round().clamp(0.0, 255.0) as u8);
        let right = rec709_from_rec601(wrong);
        assert!(right[1].abs_diff(180) <= 3, "{right:?} from {wrong:?}");
        assert_eq!(rec709_from_rec601([90, 90, 90]), [90, 90, 90]);
    }
}
