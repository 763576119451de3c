//! 8-bit luma and chroma with half the columns and rows (4:2:0), as nearly every camera films, to RGB.

use image::{GrayImage, RgbImage};

/// How luma and chroma are coded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Coding {
    /// By the matrix of Rec. 709; else of Rec. 601.
    pub is_bt709: bool,
    /// Levels 0 to 255; else black is 16, white 235 and chroma has 224 levels.
    pub is_full_range: bool,
}

/// A picture as coded.
pub(crate) struct Yuv420 {
    /// Coded luma.
    pub luma: GrayImage,
    /// Blue-difference, then red-difference chroma, each of half the columns and rows, rounded up.
    chroma: Vec<u8>,
    coding: Coding,
}

/// Fraction bits of the conversion.
/// Source: derived; sums stay below 2³¹ (levels below 2¹⁰, factors below 2²), factors err by 2⁻¹⁷, levels by 1/256.
const BITS: i32 = 16;

impl Coding {
    /// Coded level of black and what one coded level of luma is worth.
    fn luma_levels(self) -> (f64, f64) {
        if self.is_full_range { (0.0, 1.0) } else { (16.0, 255.0 / 219.0) }
    }

    /// Luma of 255 levels, rounded, from (a mean of) coded luma.
    pub fn level(self, coded: f32) -> u8 {
        let (black, gain) = self.luma_levels();
        ((coded - black as f32) * gain as f32 + 0.5).clamp(0.0, 255.0) as u8
    }

    /// Parts of red by Cr, green by Cb and by Cr, blue by Cb, and the gain of luma, in 1/2^[`BITS`]
    /// (ITU-R BT.601, 2.5; ITU-R BT.709, 3: from the luma weights of red and blue).
    fn factors(self) -> [i32; 5] {
        let (red, blue) = if self.is_bt709 { (0.2126, 0.0722) } else { (0.299, 0.114) };
        let green = 1.0 - red - blue;
        let gain = if self.is_full_range { 1.0 } else { 255.0 / 224.0 };
        let (by_cr, by_cb) = (2.0 * (1.0 - red), 2.0 * (1.0 - blue));
        let parts = [gain * by_cr, gain * by_cb * blue / green, gain * by_cr * red / green, gain * by_cb];
        let [r, gb, gr, b] = parts.map(fixed);
        [r, gb, gr, b, fixed(self.luma_levels().1)]
    }
}

fn fixed(value: f64) -> i32 {
    (value * f64::from(1 << BITS)).round() as i32
}

impl Yuv420 {
    /// Bytes of a picture.
    pub fn bytes(width: u32, height: u32) -> usize {
        let half = |n: u32| n.div_ceil(2) as usize;
        width as usize * height as usize + 2 * half(width) * half(height)
    }

    /// `planes`: luma, Cb, Cr, [`Self::bytes`] in all; `None` where there are fewer.
    pub fn new(mut planes: Vec<u8>, (width, height): (u32, u32), coding: Coding) -> Option<Self> {
        if planes.len() < Self::bytes(width, height) {
            return None;
        }
        let chroma = planes.split_off(width as usize * height as usize);
        Some(Self { luma: GrayImage::from_raw(width, height, planes)?, chroma, coding })
    }

    /// How it is coded.
    pub fn coding(&self) -> Coding {
        self.coding
    }

    /// Gamma-coded colours; four pixels share a chroma value.
    pub fn to_rgb(&self) -> RgbImage {
        let (width, height) = self.luma.dimensions();
        let columns = width.div_ceil(2) as usize;
        let (blue, red) = self.chroma.split_at(columns * height.div_ceil(2) as usize);
        let [r_cr, g_cb, g_cr, b_cb, gain] = self.coding.factors();
        let black = self.coding.luma_levels().0 as i32;
        let mut rgb = vec![0; 3 * width as usize * height as usize];
        let luma = self.luma.as_raw().chunks_exact(width as usize);
        let lines = rgb.chunks_exact_mut(3 * width as usize).zip(luma).enumerate();
        for (y, (line, luma)) in lines {
            let place = columns * (y / 2);
            let chroma = blue[place..][..columns].iter().zip(&red[place..][..columns]);
            for ((pixels, levels), (cb, cr)) in line.chunks_mut(6).zip(luma.chunks(2)).zip(chroma) {
                let (cb, cr) = (i32::from(*cb) - 128, i32::from(*cr) - 128);
                let (r, g, b) = (r_cr * cr, -(g_cb * cb + g_cr * cr), b_cb * cb);
                for (pixel, level) in pixels.chunks_exact_mut(3).zip(levels) {
                    let y = gain * (i32::from(*level) - black) + (1 << (BITS - 1));
                    let byte = |v: i32| (v >> BITS).clamp(0, 255) as u8;
                    pixel.copy_from_slice(&[byte(y + r), byte(y + g), byte(y + b)]);
                }
            }
        }
        RgbImage::from_raw(width, height, rgb).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one_pixel(coded: [u8; 3], coding: Coding) -> [u8; 3] {
        Yuv420::new(coded.to_vec(), (1, 1), coding).unwrap().to_rgb().get_pixel(0, 0).0
    }

    #[test]
    fn colours_come_back_by_the_matrix_that_coded_them() {
        for (is_bt709, red, blue) in [(true, 0.2126, 0.0722), (false, 0.299, 0.114)] {
            for is_full_range in [true, false] {
                let coding = Coding { is_bt709, is_full_range };
                let (black, light, chroma) =
                    if is_full_range { (0.0, 255.0, 255.0) } else { (16.0, 219.0, 224.0) };
                for [r, g, b] in [[180, 0, 0], [0, 180, 0], [0, 0, 180], [255; 3], [0; 3], [90, 140, 20]] {
                    let [r1, g1, b1] = [r, g, b].map(|v| f64::from(v) / 255.0);
                    let y = red * r1 + (1.0 - red - blue) * g1 + blue * b1;
                    let (cb, cr) = ((b1 - y) / (2.0 * (1.0 - blue)), (r1 - y) / (2.0 * (1.0 - red)));
                    let coded = [black + light * y, 128.0 + chroma * cb, 128.0 + chroma * cr];
                    let back = one_pixel(coded.map(|v: f64| v.round() as u8), coding);
                    let error = back.iter().zip([r, g, b]).map(|(a, b)| a.abs_diff(b)).max();
                    assert!(error.unwrap() <= 2, "{back:?} of {:?}, {coding:?}", [r, g, b]);
                    assert!(coding.level(coded[0] as f32).abs_diff((255.0 * y).round() as u8) <= 1);
                }
            }
        }
    }

    #[test]
    fn odd_sizes_have_chroma_for_their_last_row_and_column() {
        let coding = Coding { is_bt709: true, is_full_range: true };
        assert_eq!(Yuv420::bytes(3, 3), 9 + 8);
        let mut planes = vec![100; 9];
        planes.extend([128, 128, 128, 128, 128, 128, 128, 178]);
        assert!(Yuv420::new(planes[1..].to_vec(), (3, 3), coding).is_none());
        let rgb = Yuv420::new(planes, (3, 3), coding).unwrap().to_rgb();
        let expected = (100.0 + 1.5748 * 50.0_f64).round() as u8;
        assert_eq!((rgb.get_pixel(2, 2).0[0], rgb.get_pixel(1, 2).0), (expected, [100; 3]));
    }
}
