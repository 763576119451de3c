//! Reading `.sog`.

use super::{LARGEST_W, Meta, ORDER, PALETTE_ROW, others};
use crate::Gaussians;
use crate::io::error::IoError;
use crate::io::limits::{GAUSSIANS, IMAGE_BYTES};
use crate::io::splats::item::{Item, push};
use glam::{Quat, Vec3};
use image::{ImageFormat, ImageReader, Limits, RgbaImage};
use std::io::{Cursor, Read};
use std::path::Path;
use zip::ZipArchive;

/// Longest side of an image, pixels. Source: WebP's own limit.
const MAX_SIDE: u32 = 1 << 14;

/// Parses a `.sog` file, version 2.
pub(in crate::io::splats) fn parse(path: &Path, data: &[u8]) -> Result<Gaussians, IoError> {
    let mut archive = Archive::open(path, data)?;
    let meta: Meta = serde_json::from_slice(&archive.file("meta.json")?)
        .map_err(|e| IoError::format(path, format!("its meta.json is not of version 2: {e}")))?;
    if meta.version != 2 || meta.count > GAUSSIANS as usize {
        let found = format!("version {}, {} gaussians", meta.version, meta.count);
        return Err(IoError::format(path, format!("expected .sog version 2, found {found}")));
    }
    let n = meta.count;
    let [low, high] = [&meta.means.files[0], &meta.means.files[1]];
    let (low, high) = (archive.image(low, n)?, archive.image(high, n)?);
    let scales = archive.image(&meta.scales.files[0], n)?;
    let quats = archive.image(&meta.quats.files[0], n)?;
    let colours = archive.image(&meta.sh0.files[0], n)?;
    let harmonics = Harmonics::read(&meta, &mut archive)?;
    let mut g = Gaussians { sh_degree: meta.sh_n.as_ref().map_or(0, |s| s.bands), ..Default::default() };
    let mut sh = Vec::new();
    for i in 0..n {
        let [a, b, c, d, e] = [&low, &high, &scales, &quats, &colours].map(|image| pixel(image, i));
        let mean = [0, 1, 2].map(|k| {
            let share = f32::from(u16::from_le_bytes([a[k], b[k]])) / 65_535.0;
            let log = meta.means.mins[k] + share * (meta.means.maxs[k] - meta.means.mins[k]);
            log.signum() * log.abs().exp_m1()
        });
        let mut log_scale = Vec3::ZERO;
        for k in 0..3 {
            log_scale[k] = decoded(path, &meta.scales.codebook, c[k])?;
        }
        sh.clear();
        for code in &e[..3] {
            sh.push(decoded(path, &meta.sh0.codebook, *code)?);
        }
        if let Some(harmonics) = &harmonics {
            harmonics.of(i, |code| decoded(path, harmonics.book, code), &mut sh).map_err(|e| {
                e.unwrap_or_else(|| {
                    IoError::format(path, "a label lies outside the palette; the file is damaged")
                })
            })?;
        }
        let opacity = f32::from(e[3]) / 255.0;
        push(path, &mut g, &Item { mean: mean.into(), log_scale, rotation: rotation(d), opacity, sh: &sh })?;
    }
    Ok(g)
}

/// The number of a codebook that a code stands for.
fn decoded(path: &Path, book: &[f32], code: u8) -> Result<f32, IoError> {
    let found = book.get(usize::from(code)).copied();
    found.ok_or_else(|| IoError::format(path, "a code lies outside its codebook; the file is damaged"))
}

/// The palette of the harmonics and the entry of each Gaussian.
struct Harmonics<'a> {
    book: &'a [f32],
    coefficients: usize,
    count: usize,
    palette: RgbaImage,
    labels: RgbaImage,
}

impl<'a> Harmonics<'a> {
    fn read(meta: &'a Meta, archive: &mut Archive<'_>) -> Result<Option<Self>, IoError> {
        let Some(sh) = &meta.sh_n else { return Ok(None) };
        if !(1..=3).contains(&sh.bands) {
            return Err(IoError::format(archive.path, format!("expected 1 to 3 bands, found {}", sh.bands)));
        }
        let coefficients = (sh.bands as usize + 1).pow(2) - 1;
        let palette = archive.image(&sh.files[0], sh.count.saturating_mul(coefficients))?;
        if palette.width() as usize != PALETTE_ROW * coefficients {
            let message = format!("expected a palette of {PALETTE_ROW} entries a row");
            return Err(IoError::format(archive.path, message));
        }
        let labels = archive.image(&sh.files[1], meta.count)?;
        Ok(Some(Self { book: &sh.codebook, coefficients, count: sh.count, palette, labels }))
    }

    /// Adds the coefficients of Gaussian `i`; `Err(None)`: its label is outside the palette.
    fn of(
        &self,
        i: usize,
        value: impl Fn(u8) -> Result<f32, IoError>,
        sh: &mut Vec<f32>,
    ) -> Result<(), Option<IoError>> {
        let label = pixel(&self.labels, i);
        let entry = usize::from(u16::from_le_bytes([label[0], label[1]]));
        if entry >= self.count {
            return Err(None);
        }
        for k in 0..self.coefficients {
            for code in &pixel(&self.palette, entry * self.coefficients + k)[..3] {
                sh.push(value(*code).map_err(Some)?);
            }
        }
        Ok(())
    }
}

/// The pixel of a number, row by row; the caller knows that there are so many.
fn pixel(image: &RgbaImage, i: usize) -> [u8; 4] {
    let bytes = image.as_raw().get(4 * i..4 * i + 4).unwrap_or(&[0; 4]);
    [bytes[0], bytes[1], bytes[2], bytes[3]]
}

fn rotation(pixel: [u8; 4]) -> Quat {
    let largest = usize::from(pixel[3].saturating_sub(LARGEST_W));
    let mut wxyz = [0.0_f32; 4];
    for (c, byte) in others(largest).into_iter().zip(pixel) {
        wxyz[c] = (f32::from(byte) / 255.0 * 2.0 - 1.0) * std::f32::consts::FRAC_1_SQRT_2;
    }
    wxyz[largest] = (1.0 - wxyz.iter().map(|v| v * v).sum::<f32>()).max(0.0).sqrt();
    let mut xyzw = [0.0; 4];
    ORDER.iter().zip(wxyz).for_each(|(c, v)| xyzw[*c] = v);
    Quat::from_array(xyzw)
}

struct Archive<'a> {
    path: &'a Path,
    zip: ZipArchive<Cursor<&'a [u8]>>,
}

impl<'a> Archive<'a> {
    fn open(path: &'a Path, data: &'a [u8]) -> Result<Self, IoError> {
        let zip = ZipArchive::new(Cursor::new(data))
            .map_err(|e| IoError::format(path, format!("expected a .sog file, a zip archive: {e}")))?;
        Ok(Self { path, zip })
    }

    fn file(&mut self, name: &str) -> Result<Vec<u8>, IoError> {
        let wrong = |e: &dyn std::fmt::Display| IoError::format(self.path, format!("{name}: {e}"));
        let mut bytes = Vec::new();
        let file = self.zip.by_name(name).map_err(|e| wrong(&e))?;
        file.take(IMAGE_BYTES).read_to_end(&mut bytes).map_err(|e| wrong(&e))?;
        Ok(bytes)
    }

    /// An image of at least so many pixels.
    fn image(&mut self, name: &str, pixels: usize) -> Result<RgbaImage, IoError> {
        let bytes = self.file(name)?;
        let mut reader = ImageReader::with_format(Cursor::new(bytes), ImageFormat::WebP);
        let mut limits = Limits::no_limits();
        limits.max_image_width = Some(MAX_SIDE);
        limits.max_image_height = Some(MAX_SIDE);
        limits.max_alloc = Some(IMAGE_BYTES);
        reader.limits(limits);
        let image = reader.decode().map_err(|e| IoError::format(self.path, format!("{name}: {e}")))?;
        let image = image.into_rgba8();
        if image.pixels().len() < pixels {
            let message = format!("{name}: expected {pixels} pixels, found {}", image.pixels().len());
            return Err(IoError::format(self.path, message));
        }
        Ok(image)
    }
}
