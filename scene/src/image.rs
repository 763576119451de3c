//! Float images: interleaved rows of 1 or 3 channels.

use image::{GrayImage, RgbImage};

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
        let luma = |p: &[u8; 3]| {
            (0.299 * f32::from(p[0]) + 0.587 * f32::from(p[1]) + 0.114 * f32::from(p[2])) / 255.0
        };
        let data = image.as_raw().as_chunks::<3>().0.iter().map(luma).collect();
        Self { width: image.width() as usize, height: image.height() as usize, channels: 1, data }
    }

    /// The samples of a pixel.
    pub fn pixel(&self, x: usize, y: usize) -> &[f32] {
        let i = (y * self.width + x) * self.channels;
        &self.data[i..i + self.channels]
    }

    /// Rounded to 8 bits, clamped; three channels.
    pub fn to_rgb8(&self) -> RgbImage {
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        RgbImage::from_fn(self.width as u32, self.height as u32, |x, y| {
            let p = self.pixel(x as usize, y as usize);
            image::Rgb([
                byte(p[0]),
                byte(p[if self.channels > 1 { 1 } else { 0 }]),
                byte(p[self.channels - 1]),
            ])
        })
    }
}
