//! Float images: interleaved rows of 1 or 3 channels.

use image::{GrayImage, RgbImage};

/// Grey value of the farthest depth in a picture of depths, 0 to 1.
/// Source: chosen by hand, never measured.
const FARTHEST_SHADE: f32 = 0.1;

/// A float image; values of 8-bit sources are scaled to [0, 1] (sRGB values, not linear light).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FloatImage {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Samples a pixel: 1 or 3.
    pub channels: usize,
    /// [height × width × channels], row-major.
    pub data: Vec<f32>,
}

impl FloatImage {
    /// All zero.
    pub fn zeros(width: usize, height: usize, channels: usize) -> Self {
        Self { width, height, channels, data: vec![0.0; width * height * channels] }
    }

    /// From 8-bit grey.
    pub fn from_gray(image: &GrayImage) -> Self {
        let data = image.as_raw().iter().map(|&v| f32::from(v) / 255.0).collect();
        Self { width: image.width() as usize, height: image.height() as usize, channels: 1, data }
    }

    /// From 8-bit sRGB.
    pub fn from_rgb(image: &RgbImage) -> Self {
        let data = image.as_raw().iter().map(|&v| f32::from(v) / 255.0).collect();
        Self { width: image.width() as usize, height: image.height() as usize, channels: 3, data }
    }

    /// Luma (Rec. 601 weights on sRGB values) of 8-bit sRGB.
    pub fn luma(image: &RgbImage) -> Self {
        let pixels = image.as_raw().as_chunks::<3>().0.iter().map(|p| p.map(f32::from));
        let data = pixels.map(|[r, g, b]| (0.299 * r + 0.587 * g + 0.114 * b) / 255.0).collect();
        Self { width: image.width() as usize, height: image.height() as usize, channels: 1, data }
    }

    /// The samples of a pixel.
    pub fn pixel(&self, x: usize, y: usize) -> &[f32] {
        let i = (y * self.width + x) * self.channels;
        &self.data[i..i + self.channels]
    }

    /// Rounded to 8 bits, clamped; three channels.
    pub fn to_rgb8(&self) -> RgbImage {
        RgbImage::from_fn(self.width as u32, self.height as u32, |x, y| {
            let p = self.pixel(x as usize, y as usize);
            let rgb = [p[0], p[if self.channels > 1 { 1 } else { 0 }], p[self.channels - 1]];
            image::Rgb(rgb.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8))
        })
    }
}

/// Grey values of a depth map, near bright: from 1 at the nearest to `FARTHEST_SHADE` at the
/// farthest depth; 0 where less than half of a pixel is covered. `alpha`: coverage of each pixel, 0
/// to 1.
pub fn depth_shades(depth: &[f32], alpha: &[f32]) -> Vec<f32> {
    let covered = depth.iter().zip(alpha).filter(|(d, a)| **a > 0.5 && d.is_finite());
    let (near, far) =
        covered.fold((f32::INFINITY, 0.0_f32), |(near, far), (&d, _)| (near.min(d), far.max(d)));
    let range = (far - near).max(f32::MIN_POSITIVE);
    let shades = depth
        .iter()
        .zip(alpha)
        .map(|(&d, &a)| if a > 0.5 { 1.0 - (1.0 - FARTHEST_SHADE) * (d - near) / range } else { 0.0 });
    shades.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_is_bright_far_is_dark_and_nothing_is_black() {
        let shades = depth_shades(&[1.0, 2.0, 3.0, 9.0], &[1.0, 1.0, 1.0, 0.2]);
        assert!((shades[0] - 1.0).abs() < 1e-6 && (shades[1] - 0.55).abs() < 1e-6, "{shades:?}");
        assert!((shades[2] - FARTHEST_SHADE).abs() < 1e-6 && shades[3] == 0.0, "{shades:?}");
    }
}
