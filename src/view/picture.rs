//! Small pictures of frames and mattes.

use anyhow::Result;
use image::{GrayImage, Rgb, RgbImage};
use std::path::Path;

/// Longest side of a thumbnail, pixels. Source: the strip of the page, 96 points high, on a screen
/// of two pixels a point.
const THUMBNAIL: u32 = 192;
/// What lies behind an object that was cut out, 8-bit sRGB. Source: chosen by hand: no object and
/// no screen has it.
const BEHIND: [u8; 3] = [43, 47, 54];

/// A picture as JPEG.
pub(super) fn jpeg(picture: &RgbImage) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let encoder =
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, crate::pictures::JPEG_QUALITY);
    picture.write_with_encoder(encoder)?;
    Ok(bytes)
}

/// A frame, small, as JPEG; with a mask, what was cut out of it.
pub(super) fn thumbnail(frame: &Path, mask: Option<&Path>) -> Result<Vec<u8>> {
    let mut picture = scene::io::shrunk(&scene::io::load_rgb(frame)?, THUMBNAIL);
    if let Some(mask) = mask {
        let mask = scene::io::load_mask(mask)?;
        let mask = scene::io::resize_area(&mask, picture.width(), picture.height());
        cut_out(&mut picture, &mask);
    }
    jpeg(&picture)
}

/// Puts what the mask leaves out behind a plain colour.
fn cut_out(picture: &mut RgbImage, mask: &GrayImage) {
    for (pixel, kept) in picture.pixels_mut().zip(mask.pixels()) {
        let kept = f32::from(kept.0[0]) / f32::from(u8::MAX);
        let mixed = |c: usize| f32::from(pixel.0[c]) * kept + f32::from(BEHIND[c]) * (1.0 - kept);
        *pixel = Rgb([mixed(0), mixed(1), mixed(2)].map(|v| v.round() as u8));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_mask_leaves_out_lies_behind_a_plain_colour() {
        let mut picture = RgbImage::from_pixel(2, 1, Rgb([200, 100, 0]));
        cut_out(&mut picture, &GrayImage::from_vec(2, 1, vec![255, 0]).unwrap());
        assert_eq!(picture.into_raw(), [200, 100, 0, 43, 47, 54]);
    }
}
