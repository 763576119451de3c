//! Images from disk: upright, 8-bit, within limits; and what their headers say.

use super::attitude::{XmpCamera, turned};
use super::error::IoError;
use super::exif::ExifCamera;
use super::limits::{DECODED_RATIO, IMAGE_BYTES, IMAGE_SIDE, PNG_METADATA_BYTES, SMALL_BYTES};
use super::tiff_directory::oversized_entry;
use glam::DVec3;
use image::metadata::Orientation;
use image::{
    DynamicImage, GrayImage, ImageBuffer, ImageDecoder, ImageFormat, ImageReader, Limits, Pixel, RgbImage,
};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// An upright 8-bit image.
#[derive(Clone, Debug)]
pub struct LoadedImage {
    /// Colour as stored (not multiplied by alpha).
    pub rgb: RgbImage,
    /// Alpha, where the file has a channel for it: 255 = opaque.
    pub alpha: Option<GrayImage>,
}

/// What the header of an image says.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageInfo {
    /// Width of the upright image, pixels.
    pub width: u32,
    /// Height of the upright image, pixels.
    pub height: u32,
    /// Whether it has an alpha channel.
    pub has_alpha: bool,
    /// What EXIF says.
    pub exif: ExifCamera,
    /// Focal length according to EXIF, pixels of this image.
    pub focal_prior_px: Option<f64>,
    /// The direction that is up in the upright picture, where its metadata say it: x right, y down,
    /// z forward, unit.
    pub up: Option<DVec3>,
    /// Whether its metadata say that it is an equirectangular panorama.
    pub is_panorama: bool,
}

fn image_error(path: &Path) -> impl Fn(image::ImageError) -> IoError + '_ {
    |error| match error {
        image::ImageError::IoError(source) if source.kind() == std::io::ErrorKind::NotFound => {
            IoError::File { action: "read", path: path.into(), source }
        }
        error => IoError::Image {
            path: path.into(),
            message: format!("{error}; convert it to an 8-bit PNG or JPEG"),
        },
    }
}

fn open(path: &Path) -> Result<ImageReader<BufReader<File>>, IoError> {
    let reader = ImageReader::open(path).map_err(IoError::file("read", path))?;
    let mut reader = reader.with_guessed_format().map_err(IoError::file("read", path))?;
    let mut limits = Limits::no_limits();
    limits.max_image_width = Some(IMAGE_SIDE);
    limits.max_image_height = Some(IMAGE_SIDE);
    // The decoder of PNG counts what it unpacks beside the pixels only.
    let is_png = reader.format() == Some(ImageFormat::Png);
    limits.max_alloc = Some(if is_png { PNG_METADATA_BYTES } else { IMAGE_BYTES });
    reader.limits(limits);
    Ok(reader)
}

fn check_size(path: &Path, decoder: &impl ImageDecoder) -> Result<(), IoError> {
    let (w, h) = decoder.dimensions();
    if w == 0 || h == 0 || w > IMAGE_SIDE || h > IMAGE_SIDE || decoder.total_bytes() > IMAGE_BYTES {
        let message = format!(
            "{w} × {h} pixels; accepted are 1 to {IMAGE_SIDE} a side and {IMAGE_BYTES} decoded bytes"
        );
        return Err(IoError::Image { path: path.into(), message });
    }
    Ok(())
}

/// An error where a file is too short for the pixels that it claims. (A lossless WebP of one colour
/// has no least size.)
fn refuse_bomb(path: &Path, decoded: u64, format: Option<ImageFormat>) -> Result<(), IoError> {
    let packed = std::fs::metadata(path).map_err(IoError::file("read", path))?.len();
    let most = SMALL_BYTES.max(packed.saturating_mul(DECODED_RATIO));
    match format {
        Some(ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::Tiff) if decoded > most => {
            let message = format!("its {packed} bytes cannot hold the {decoded} bytes of pixels it claims");
            Err(IoError::Image { path: path.into(), message })
        }
        _ => Ok(()),
    }
}

/// The EXIF orientation; damaged metadata counts as none.
fn orientation(decoder: &mut impl ImageDecoder) -> Orientation {
    decoder.orientation().unwrap_or(Orientation::NoTransforms)
}

/// A decoder of the image as it is stored, within limits, and the format that its content has.
pub fn image_decoder(path: &Path) -> Result<(impl ImageDecoder + use<>, Option<ImageFormat>), IoError> {
    let reader = open(path)?;
    let format = reader.format();
    if format == Some(ImageFormat::Tiff)
        && let Some(tag) = oversized_entry(path)
    {
        let message = format!("its entry {tag} claims more values than the file can hold");
        return Err(IoError::Image { path: path.into(), message });
    }
    let decoder = reader.into_decoder().map_err(image_error(path))?;
    check_size(path, &decoder)?;
    Ok((decoder, format))
}

fn decode(path: &Path) -> Result<DynamicImage, IoError> {
    let (mut decoder, format) = image_decoder(path)?;
    refuse_bomb(path, decoder.total_bytes(), format)?;
    let turn = orientation(&mut decoder);
    let mut image = DynamicImage::from_decoder(decoder).map_err(image_error(path))?;
    image.apply_orientation(turn);
    Ok(image)
}

/// An image of any bit depth and channel count as 8-bit colour and alpha, turned upright as EXIF
/// says.
pub fn load_image(path: &Path) -> Result<LoadedImage, IoError> {
    let image = decode(path)?;
    let alpha = image.color().has_alpha().then(|| {
        let rgba = image.to_rgba8();
        let values = rgba.pixels().map(|p| p.0[3]).collect();
        GrayImage::from_raw(rgba.width(), rgba.height(), values).unwrap_or_default()
    });
    Ok(LoadedImage { rgb: image.into_rgb8(), alpha })
}

/// The colours of an image, 8 bits, upright; alpha is left out, not multiplied in.
pub fn load_rgb(path: &Path) -> Result<RgbImage, IoError> {
    Ok(decode(path)?.into_rgb8())
}

/// A mask: grey value times alpha, 8 bits, upright; white = keep.
pub fn load_mask(path: &Path) -> Result<GrayImage, IoError> {
    let image = decode(path)?;
    if !image.color().has_alpha() {
        return Ok(image.into_luma8());
    }
    let both = image.into_luma_alpha8();
    let products = both.pixels().map(|p| (u16::from(p.0[0]) * u16::from(p.0[1]) + 127) / 255);
    let values = products.map(|v| v as u8).collect();
    Ok(GrayImage::from_raw(both.width(), both.height(), values).unwrap_or_default())
}

/// Size, alpha and EXIF of an image without decoding its pixels.
pub fn image_info(path: &Path) -> Result<ImageInfo, IoError> {
    let (mut decoder, _) = image_decoder(path)?;
    let exif = decoder.exif_metadata().ok().flatten().map(|c| ExifCamera::parse(&c)).unwrap_or_default();
    let xmp = decoder.xmp_metadata().ok().flatten().map(|p| XmpCamera::parse(&p)).unwrap_or_default();
    let (mut width, mut height) = decoder.dimensions();
    let orientation = orientation(&mut decoder);
    if turns_sideways(orientation) {
        std::mem::swap(&mut width, &mut height);
    }
    let focal_prior_px = exif.focal_px(width, height);
    let has_alpha = decoder.color_type().has_alpha();
    let up = xmp.up.or(exif.up).and_then(|up| turned(up, orientation));
    Ok(ImageInfo { width, height, has_alpha, exif, focal_prior_px, up, is_panorama: xmp.is_panorama })
}

pub(super) fn turns_sideways(orientation: Orientation) -> bool {
    use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    matches!(orientation, Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH)
}

/// For each target pixel along one axis: the first source pixel and the weights (summing to 1) of
/// its box.
fn boxes(from: u32, to: u32) -> Vec<(usize, Vec<f32>)> {
    let scale = f64::from(from) / f64::from(to);
    let spans = (0..to).map(|i| {
        let (a, b) = (f64::from(i) * scale, (f64::from(i + 1) * scale).min(f64::from(from)));
        let first = (a as usize).min(from as usize - 1);
        let last = (b.ceil() as usize).clamp(first + 1, from as usize);
        let overlaps = (first..last).map(|j| (b.min(j as f64 + 1.0) - a.max(j as f64)).max(0.0));
        let total: f64 = overlaps.clone().sum();
        (first, overlaps.map(|o| (o / total) as f32).collect())
    });
    spans.collect()
}

/// The image at another size: every target pixel is the mean of the source over its own area (exact
/// for any ratio; sRGB values, not linear light). Sizes of 0 become 1.
pub fn resize_area<P: Pixel<Subpixel = u8>>(
    image: &ImageBuffer<P, Vec<u8>>,
    width: u32,
    height: u32,
) -> ImageBuffer<P, Vec<u8>> {
    let (width, height) = (width.max(1), height.max(1));
    if (width, height) == image.dimensions() || image.is_empty() {
        return image.clone();
    }
    let channels = P::CHANNEL_COUNT as usize;
    let stride = image.width() as usize * channels;
    let columns = boxes(image.width(), width);
    let mut out = ImageBuffer::new(width, height);
    let mut sums = vec![0.0_f32; stride];
    let target_stride = width as usize * channels;
    for ((first, weights), target) in
        boxes(image.height(), height).iter().zip(out.chunks_exact_mut(target_stride))
    {
        sums.fill(0.0);
        for (row, &weight) in image.as_raw()[first * stride..].chunks_exact(stride).zip(weights) {
            sums.iter_mut().zip(row).for_each(|(s, &v)| *s += weight * f32::from(v));
        }
        for ((first, weights), pixel) in columns.iter().zip(target.chunks_exact_mut(channels)) {
            for (c, value) in pixel.iter_mut().enumerate() {
                let source = sums[first * channels + c..].iter().step_by(channels);
                *value = (source.zip(weights).map(|(s, w)| s * w).sum::<f32>() + 0.5) as u8;
            }
        }
    }
    out
}

/// The image with its longer side at most `side` pixels, its proportions kept.
pub fn shrunk(image: &RgbImage, side: u32) -> RgbImage {
    let (width, height) = image.dimensions();
    let scale = (f64::from(side) / f64::from(width.max(height).max(1))).min(1.0);
    let [width, height] = [width, height].map(|v| (f64::from(v) * scale).round() as u32);
    resize_area(image, width, height)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::test_folder;

    #[test]
    fn area_resizing_averages_boxes_exactly() {
        let image = RgbImage::from_fn(6, 4, |x, y| image::Rgb([(x * 40) as u8, (y * 60) as u8, 7]));
        let half = resize_area(&image, 3, 2);
        assert_eq!(half.get_pixel(1, 0).0, [100, 30, 7]);
        let odd = resize_area(&image, 4, 4); // boxes 1.5 wide: (0 + 40/2) / 1.5 …
        assert_eq!(odd.get_pixel(0, 3).0, [13, 180, 7]);
        assert_eq!(resize_area(&image, 1, 1).get_pixel(0, 0).0, [100, 90, 7]);
        assert_eq!(resize_area(&image, 12, 8).get_pixel(11, 7), image.get_pixel(5, 3));
        assert_eq!(resize_area(&image, 0, 2).dimensions(), (1, 2));
        assert_eq!(shrunk(&image, 3).dimensions(), (3, 2));
        assert_eq!(shrunk(&image, 100).dimensions(), (6, 4));
    }

    #[test]
    fn sixteen_bit_grey_and_alpha_become_eight_bit_colour() {
        let dir = test_folder("load");
        let path = dir.join("grey16.png");
        image::ImageBuffer::<image::Luma<u16>, _>::from_pixel(3, 2, image::Luma([0x8080]))
            .save(&path)
            .unwrap();
        assert_eq!(load_rgb(&path).unwrap().get_pixel(2, 1).0, [128; 3]);
        assert!(load_image(&path).unwrap().alpha.is_none());
        let path = dir.join("rgba.png");
        image::RgbaImage::from_pixel(3, 2, image::Rgba([200, 100, 50, 51])).save(&path).unwrap();
        let loaded = load_image(&path).unwrap();
        assert_eq!(loaded.rgb.get_pixel(0, 0).0, [200, 100, 50]);
        assert_eq!(loaded.alpha.unwrap().get_pixel(0, 0).0, [51]);
        let path = dir.join("mask.png");
        image::GrayAlphaImage::from_pixel(2, 2, image::LumaA([100, 51])).save(&path).unwrap();
        assert_eq!(load_mask(&path).unwrap().get_pixel(0, 0).0, [20]);
        assert!(image_info(&path).unwrap().has_alpha);
    }

    #[test]
    fn an_image_that_claims_to_be_enormous_is_refused_quickly() {
        let path = test_folder("bomb").join("bomb.png");
        image::GrayImage::new(4, 4).save(&path).unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        for (side, at) in [(60_000u32, 16), (60_000, 20)] {
            bytes[at..at + 4].copy_from_slice(&side.to_be_bytes());
        }
        let crc = crc32(&bytes[12..29]);
        bytes[29..33].copy_from_slice(&crc.to_be_bytes());
        std::fs::write(&path, &bytes).unwrap();
        assert!(matches!(load_rgb(&path), Err(IoError::Image { .. })));
        std::fs::write(&path, b"not an image").unwrap();
        assert!(load_rgb(&path).is_err() && image_info(&path).is_err());
        assert!(
            load_rgb(&path.with_file_name("none.png")).unwrap_err().to_string().starts_with("cannot read")
        );
    }

    /// A PNG of one pixel whose colour profile unpacks to `mib` MiB of zeros.
    fn png_with_profile(path: &Path, mib: usize) {
        image::GrayImage::new(1, 1).save(path).unwrap();
        let bytes = std::fs::read(path).unwrap();
        let mut zlib = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
        (0..mib).for_each(|_| std::io::Write::write_all(&mut zlib, &vec![0; 1 << 20]).unwrap());
        let data = [b"iCCPx\0\0", &zlib.finish().unwrap()[..]].concat();
        let length = (data.len() as u32 - 4).to_be_bytes();
        let chunk = [&length[..], &data, &crc32(&data).to_be_bytes()].concat();
        std::fs::write(path, [&bytes[..33], &chunk, &bytes[33..]].concat()).unwrap();
    }

    #[test]
    fn a_colour_profile_is_unpacked_up_to_a_limit() {
        let path = test_folder("profile").join("a.png");
        png_with_profile(&path, 1);
        let (mut decoder, _) = image_decoder(&path).unwrap();
        assert_eq!(decoder.icc_profile().unwrap().map(|p| p.len()), Some(1 << 20));
        png_with_profile(&path, 64);
        let unpacked = image_decoder(&path).ok().and_then(|(mut d, _)| d.icc_profile().ok().flatten());
        assert!(unpacked.is_none_or(|p| p.len() <= PNG_METADATA_BYTES as usize));
    }

    fn crc32(data: &[u8]) -> u32 {
        !data.iter().fold(!0u32, |crc, &b| {
            (0..8).fold(crc ^ u32::from(b), |c, _| if c & 1 == 1 { (c >> 1) ^ 0xedb8_8320 } else { c >> 1 })
        })
    }
}
