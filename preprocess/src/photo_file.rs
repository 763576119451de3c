//! One photo from its file: what the `image` crate reads, and HEIC and AVIF, whose tiles `ffmpeg`
//! decodes.

use crate::PreprocessError;
use crate::probe::file_url;
use crate::tool::{self, ONE_FILE};
use image::metadata::Orientation;
use image::{DynamicImage, GrayImage, ImageDecoder, RgbImage};
use scene::Progress;
use scene::io::heif::{HeifCodec, HeifPicture, HeifTiles};
use scene::io::load::{ImageInfo, LoadedImage, image_decoder, image_info, load_image};
use std::ffi::OsStr;
use std::path::Path;
use std::time::Duration;

/// A photo, decoded and upright.
pub(crate) struct PhotoFile {
    /// What its file says.
    pub info: ImageInfo,
    /// Its pixels.
    pub pixels: LoadedImage,
    /// What made the stored pixels upright.
    pub orientation: Orientation,
}

impl PhotoFile {
    /// Reads a file. `scratch`: a file that may be written meanwhile.
    pub(crate) fn read(path: &Path, scratch: &Path, progress: &Progress) -> Result<Self, PreprocessError> {
        if HeifPicture::is_in(path) {
            return Self::read_heif(path, scratch, progress);
        }
        let info = image_info(path).map_err(|e| unreadable(path, e))?;
        let pixels = load_image(path).map_err(|e| unreadable(path, e))?;
        let decoder = image_decoder(path).ok();
        let stored = decoder.and_then(|(mut d, _)| d.orientation().ok());
        Ok(Self { info, pixels, orientation: stored.unwrap_or(Orientation::NoTransforms) })
    }

    fn read_heif(path: &Path, scratch: &Path, progress: &Progress) -> Result<Self, PreprocessError> {
        let picture = HeifPicture::read(path).map_err(|e| unreadable(path, e))?;
        let (info, orientation) = (picture.info(), picture.orientation);
        let rgb = upright(decode(path, &picture.colour, scratch, progress)?, orientation);
        let alpha = match &picture.alpha {
            Some(tiles) if tiles.size == picture.colour.size => {
                let grey = upright(decode(path, tiles, scratch, progress)?, orientation);
                let values = grey.pixels().map(|p| p.0[1]).collect();
                GrayImage::from_raw(grey.width(), grey.height(), values)
            }
            _ => None,
        };
        Ok(Self { info, pixels: LoadedImage { rgb, alpha }, orientation })
    }
}

fn upright(image: RgbImage, orientation: Orientation) -> RgbImage {
    let mut image = DynamicImage::ImageRgb8(image);
    image.apply_orientation(orientation);
    image.into_rgb8()
}

fn unreadable(path: &Path, error: scene::io::IoError) -> PreprocessError {
    let text = error.to_string();
    let shown = path.display().to_string();
    let reason = text.replacen(&shown, "", 1).trim_start_matches([':', ' ']).to_owned();
    PreprocessError::Image { path: path.to_owned(), reason }
}

/// The longest that the decoder may take for a photo. Source: chosen by hand, never
/// measured.
const LIMIT: Duration = Duration::from_secs(120);

/// Decodes all tiles with one call of `ffmpeg` and puts them together.
fn decode(
    path: &Path,
    tiles: &HeifTiles,
    scratch: &Path,
    progress: &Progress,
) -> Result<RgbImage, PreprocessError> {
    let (format, stream) = match tiles.codec {
        HeifCodec::Hevc => ("hevc", tiles.tiles.concat()),
        HeifCodec::Av1 => ("ivf", ivf(tiles)),
    };
    std::fs::write(scratch, stream).map_err(PreprocessError::io(scratch))?;
    let raw = scratch.with_extension("rgb");
    let said = run_ffmpeg(path, tiles, format, scratch, &raw, progress);
    // Both lie in the folder for temporary files, which is removed at the end.
    let bytes = std::fs::read(&raw);
    let _ = (std::fs::remove_file(scratch), std::fs::remove_file(&raw));
    let said = said?;
    bytes.ok().and_then(|b| assembled(tiles, &b)).ok_or_else(|| {
        let codec = if tiles.codec == HeifCodec::Hevc { "HEVC" } else { "AV1" };
        let reason = format!("ffmpeg cannot decode its {codec} ({said}); convert it to JPEG or PNG");
        PreprocessError::Image { path: path.to_owned(), reason }
    })
}

/// Writes the tiles as raw RGB, one after another; returns the last line of what `ffmpeg` says.
fn run_ffmpeg(
    path: &Path,
    tiles: &HeifTiles,
    format: &str,
    from: &Path,
    to: &Path,
    progress: &Progress,
) -> Result<String, PreprocessError> {
    let matrix = match tiles.matrix {
        Some(1) => "bt709",
        Some(5 | 6) => "bt601",
        Some(9 | 10) => "bt2020",
        _ => "auto",
    };
    let range = match tiles.full_range {
        Some(true) => "full",
        Some(false) => "limited",
        None => "auto",
    };
    let (width, height) = tiles.tile_size;
    let filter = format!("scale={width}:{height}:flags=bicubic:in_color_matrix={matrix}:in_range={range}");
    let (from, to) = (file_url(from), file_url(to));
    let before = ["-nostdin", "-hide_banner", "-nostats", "-v", "error", "-y"];
    let after = ["-vf", &filter, "-fps_mode", "passthrough", "-f", "rawvideo", "-pix_fmt", "rgb24"];
    let args = [
        &before.map(OsStr::new)[..],
        &ONE_FILE.map(OsStr::new),
        &["-f", format, "-i"].map(OsStr::new),
        &[from.as_os_str()],
        &after.map(OsStr::new),
        &[to.as_os_str()],
    ];
    let output = tool::run("ffmpeg", &args.concat(), path, LIMIT, progress)?;
    Ok(output.reason())
}

/// The picture from its decoded tiles; `None` where some are missing.
fn assembled(tiles: &HeifTiles, decoded: &[u8]) -> Option<RgbImage> {
    let (width, height) = tiles.tile_size;
    let bytes = width as usize * height as usize * 3;
    if decoded.len() != bytes * tiles.tiles.len() {
        return None;
    }
    let mut picture = RgbImage::new(tiles.size.0, tiles.size.1);
    for (index, pixels) in (0_u32..).zip(decoded.chunks_exact(bytes)) {
        let tile = RgbImage::from_raw(width, height, pixels.to_vec())?;
        let (column, row) = (index % tiles.columns, index / tiles.columns);
        image::imageops::replace(&mut picture, &tile, i64::from(column * width), i64::from(row * height));
    }
    Some(picture)
}

/// The tiles as frames of an IVF file, the container that libvpx and libaom write: a head of 32
/// bytes, and before each frame its length and time.
fn ivf(tiles: &HeifTiles) -> Vec<u8> {
    let mut file = b"DKIF\0\0\x20\0AV01".to_vec();
    [tiles.tile_size.0, tiles.tile_size.1].iter().for_each(|s| file.extend((*s as u16).to_le_bytes()));
    [1, 1, tiles.tiles.len() as u32, 0].iter().for_each(|n: &u32| file.extend(n.to_le_bytes()));
    for (time, tile) in (0_u64..).zip(&tiles.tiles) {
        file.extend((tile.len() as u32).to_le_bytes());
        file.extend(time.to_le_bytes());
        file.extend_from_slice(tile);
    }
    file
}
