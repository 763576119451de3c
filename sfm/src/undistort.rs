//! Pinhole images for training: distortion removed, no black borders.

use crate::error::SfmError;
use crate::outline_pieces;
use crate::sift::unreadable;
use glam::DVec2;
use image::{DynamicImage, ImageFormat, RgbImage, RgbaImage};
use rayon::prelude::*;
use scene::decision::Decision;
use scene::{Camera, CameraModel, Frame, FrameSet, PosedImage, Progress, Reconstruction};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Quality of resampled JPEG files.
/// Source: judgement: a second compression that is hardly seen.
const JPEG_QUALITY: u8 = 97;
/// An undistorted image is at most this much larger or smaller than its source, each way.
/// Source: COLMAP, `max_scale` of its undistortion.
const SIZE_LIMIT: f64 = 2.0;

/// Images without distortion.
#[derive(Clone, Debug)]
pub struct Undistorted {
    /// PINHOLE cameras, observations moved along.
    pub model: Reconstruction,
    /// What was removed from masks.
    pub decisions: Vec<Decision>,
}

/// Writes `images/`, `masks/` (where frames have masks) and the model `sparse/0` without distortion
/// into `out_dir`. Masks lose the pieces that most other views contradict.
///
/// Focal lengths stay as they are and the image becomes the largest rectangle without blank pixels
/// (COLMAP's `blank_pixels = 0`). Images of cameras without distortion are linked or copied. Frames
/// without a pose are not written.
pub fn undistort(
    frames: &FrameSet,
    reconstruction: &Reconstruction,
    out_dir: &Path,
    progress: &Progress,
) -> Result<Undistorted, SfmError> {
    progress.begin("undistort", reconstruction.images.len());
    let mut model = reconstruction.clone();
    for camera in model.cameras.values_mut() {
        *camera = pinhole(camera);
    }
    for image in model.images.values_mut() {
        let (old, new) = (&reconstruction.cameras[&image.camera], &model.cameras[&image.camera]);
        let (focal, centre) = (new.focal(), new.principal_point());
        image.observations.iter_mut().for_each(|o| o.pixel = old.unproject(o.pixel) * focal + centre);
    }
    let by_name: BTreeMap<&str, &Frame> = frames.frames.iter().map(|f| (f.name.as_str(), f)).collect();
    let images: Vec<&PosedImage> = model.images.values().collect();
    images.par_iter().try_for_each(|image| {
        let Some(frame) = by_name.get(image.name.as_str()) else {
            let reason = "the model names it, but it is not among the frames".to_owned();
            return Err(SfmError::UnreadableImage { path: PathBuf::from(&image.name), reason });
        };
        let (old, new) = (&reconstruction.cameras[&image.camera], &model.cameras[&image.camera]);
        let target = out_dir.join("images").join(&image.name);
        transfer(&frame.path, &target, old, new)?;
        if let Some(mask) = &frame.mask {
            transfer(mask, &out_dir.join("masks").join(format!("{}.png", image.name)), old, new)?;
        }
        progress.tick().map_err(SfmError::from)
    })?;
    let removed = outline_pieces::remove_contradicted(&out_dir.join("masks"), &model, progress)?;
    let sparse = out_dir.join("sparse").join("0");
    fs::create_dir_all(&sparse).map_err(|e| cannot_write(&sparse, &e))?;
    scene::io::write_model_bin(&model, &sparse).map_err(|e| cannot_write(&sparse, &e))?;
    Ok(Undistorted { model, decisions: removed.decision().into_iter().collect() })
}

/// The PINHOLE camera whose image is the largest rectangle inside the undistorted image of
/// `camera`.
pub(crate) fn pinhole(camera: &Camera) -> Camera {
    let (focal, size) = (camera.focal(), DVec2::new(f64::from(camera.width), f64::from(camera.height)));
    if camera.distortion().iter().all(|&k| k == 0.0) {
        return with_size(camera, camera.width, camera.height, camera.principal_point());
    }
    let (x, y) = (DVec2::X * size.x, DVec2::Y * size.y);
    let left = along(camera, DVec2::ZERO, y).map(|u| u.x).fold(f64::NEG_INFINITY, f64::max);
    let right = along(camera, x, size).map(|u| u.x).fold(f64::INFINITY, f64::min);
    let top = along(camera, DVec2::ZERO, x).map(|u| u.y).fold(f64::NEG_INFINITY, f64::max);
    let bottom = along(camera, y, size).map(|u| u.y).fold(f64::INFINITY, f64::min);
    let width = whole_pixels((right - left) * focal.x, size.x);
    let height = whole_pixels((bottom - top) * focal.y, size.y);
    // The rectangle's middle stays in the middle.
    let middle = DVec2::new((left + right) / 2.0, (top + bottom) / 2.0);
    let middle = if middle.is_finite() { middle } else { camera.unproject(size / 2.0) };
    with_size(camera, width as u32, height as u32, DVec2::new(width, height) / 2.0 - middle * focal)
}

/// The PINHOLE camera with the same focal lengths and this size and principal point.
fn with_size(camera: &Camera, width: u32, height: u32, centre: DVec2) -> Camera {
    let focal = camera.focal();
    let params = vec![focal.x, focal.y, centre.x, centre.y];
    Camera { model: CameraModel::Pinhole, width, height, params, ..camera.clone() }
}

/// Undistorted places of 201 pixels from one to another.
fn along(camera: &Camera, from: DVec2, to: DVec2) -> impl Iterator<Item = DVec2> + '_ {
    (0..=200).map(move |i| camera.unproject(from.lerp(to, f64::from(i) / 200.0)))
}

/// A length rounded inwards to whole pixels, within the limits; `full` where it is not finite.
fn whole_pixels(length: f64, full: f64) -> f64 {
    let pixels = length.floor();
    if pixels.is_finite() { pixels.clamp((full / SIZE_LIMIT).ceil(), full * SIZE_LIMIT) } else { full }
}

/// The error of a file that cannot be written.
pub(crate) fn cannot_write(path: &Path, error: &impl std::fmt::Display) -> SfmError {
    SfmError::CannotWrite { path: path.to_owned(), reason: error.to_string() }
}

/// Brings one file over: linked or copied where the pixels do not change, resampled where they do.
fn transfer(source: &Path, target: &Path, old: &Camera, new: &Camera) -> Result<(), SfmError> {
    if let Some(folder) = target.parent() {
        fs::create_dir_all(folder).map_err(|e| cannot_write(folder, &e))?;
    }
    match fs::remove_file(target) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(cannot_write(target, &e)),
        _ => {}
    }
    let unchanged = old.distortion().iter().all(|&k| k == 0.0);
    if unchanged && source.extension() == target.extension() {
        if fs::hard_link(source, target).is_err() {
            fs::copy(source, target).map_err(|e| cannot_write(target, &e))?;
        }
        return Ok(());
    }
    let (decoder, _) = scene::io::image_decoder(source).map_err(|e| unreadable(source, &e))?;
    let decoded = DynamicImage::from_decoder(decoder).map_err(|e| unreadable(source, &e))?;
    if (decoded.width(), decoded.height()) != (old.width, old.height) {
        return Err(SfmError::SizeMismatch {
            path: source.to_owned(),
            found_width: decoded.width(),
            found_height: decoded.height(),
            width: old.width,
            height: old.height,
        });
    }
    save(&resample(&decoded, old, new), target)
}

/// Bilinear: each new pixel's centre is distorted into the old image.
fn resample(image: &DynamicImage, old: &Camera, new: &Camera) -> DynamicImage {
    let rgba = image.color().has_alpha();
    let source = if rgba { image.to_rgba8().into_raw() } else { image.to_rgb8().into_raw() };
    let channels = if rgba { 4 } else { 3 };
    let (width, height) = (old.width as usize, old.height as usize);
    let mut out = vec![0u8; new.width as usize * new.height as usize * channels];
    for (y, row) in out.chunks_exact_mut((new.width as usize * channels).max(1)).enumerate() {
        for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
            let u = new.unproject(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
            let at = old.distort(u) * old.focal() + old.principal_point() - 0.5;
            let at = at.clamp(DVec2::ZERO, DVec2::new(width as f64 - 1.0, height as f64 - 1.0));
            let (x0, y0) = (at.x as usize, at.y as usize);
            let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
            let (fx, fy) = (at.x - x0 as f64, at.y - y0 as f64);
            let sample = |x: usize, y: usize, c: usize| f64::from(source[(y * width + x) * channels + c]);
            for (c, value) in pixel.iter_mut().enumerate() {
                let upper = sample(x0, y0, c) * (1.0 - fx) + sample(x1, y0, c) * fx;
                let lower = sample(x0, y1, c) * (1.0 - fx) + sample(x1, y1, c) * fx;
                *value = (upper * (1.0 - fy) + lower * fy).round() as u8;
            }
        }
    }
    let (w, h) = (new.width, new.height);
    if rgba {
        DynamicImage::ImageRgba8(RgbaImage::from_raw(w, h, out).unwrap_or_default())
    } else {
        DynamicImage::ImageRgb8(RgbImage::from_raw(w, h, out).unwrap_or_default())
    }
}

fn save(image: &DynamicImage, target: &Path) -> Result<(), SfmError> {
    let format = ImageFormat::from_path(target).unwrap_or(ImageFormat::Png);
    let mut bytes = std::io::Cursor::new(Vec::new());
    let encoded = if format == ImageFormat::Jpeg {
        let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY);
        DynamicImage::ImageRgb8(image.to_rgb8()).write_with_encoder(encoder)
    } else {
        image.write_to(&mut bytes, format)
    };
    encoded.map_err(|e| cannot_write(target, &e))?;
    fs::write(target, bytes.into_inner()).map_err(|e| cannot_write(target, &e))
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::{Observation, Pose};

    fn folder(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("sat-recon-undistort-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        path
    }

    /// A smooth picture given by a function of the ideal (undistorted) direction.
    fn pattern(u: DVec2) -> [u8; 3] {
        [(128.0 + 100.0 * (9.0 * u.x).sin()) as u8, (128.0 + 100.0 * (7.0 * u.y).cos()) as u8, 90]
    }

    fn world(dir: &Path, camera: &Camera) -> (FrameSet, Reconstruction) {
        let picture = RgbImage::from_fn(camera.width, camera.height, |x, y| {
            image::Rgb(pattern(camera.unproject(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5))))
        });
        let path = dir.join("a.png");
        picture.save(&path).unwrap();
        let frame = Frame {
            name: "a.png".into(),
            path: path.clone(),
            width: camera.width,
            height: camera.height,
            mask: Some(path),
            ..Frame::default()
        };
        let mut model = Reconstruction::default();
        model.cameras.insert(1, camera.clone());
        let observations = vec![Observation { pixel: DVec2::new(30.0, 20.0), point: None }];
        let image = PosedImage { id: 1, camera: 1, name: "a.png".into(), pose: Pose::IDENTITY, observations };
        model.images.insert(1, image);
        (FrameSet { frames: vec![frame], ..FrameSet::default() }, model)
    }

    #[test]
    fn the_undistorted_picture_is_what_a_pinhole_camera_would_have_seen() {
        for k in [-0.2, 0.15] {
            let mut camera = Camera::centred(1, CameraModel::SimpleRadial, 200, 140, 180.0);
            camera.params[3] = k;
            let dir = folder(&format!("picture{k}"));
            let (frames, model) = world(&dir, &camera);
            let flat = undistort(&frames, &model, &dir.join("out"), &Progress::silent()).unwrap().model;
            let new = &flat.cameras[&1];
            let picture = image::open(dir.join("out/images/a.png")).unwrap().to_rgb8();
            assert_eq!(picture.dimensions(), (new.width, new.height));
            let mut worst = 0;
            for (x, y, pixel) in picture.enumerate_pixels() {
                let wanted = pattern(new.unproject(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)));
                worst = worst.max((0..3).map(|c| pixel.0[c].abs_diff(wanted[c])).max().unwrap_or(0));
            }
            assert!(worst <= 2, "k {k}: {worst} grey levels, also at the borders");
            assert!(dir.join("out/masks/a.png.png").exists());
            assert!(scene::io::read_model(&dir.join("out/sparse/0")).is_ok());
            let ray = camera.unproject(DVec2::new(30.0, 20.0));
            assert!((new.unproject(flat.images[&1].observations[0].pixel) - ray).length() < 1e-9);
            fs::remove_dir_all(dir).unwrap();
        }
    }

    #[test]
    fn without_distortion_the_file_is_the_same() {
        let camera = Camera::centred(1, CameraModel::SimplePinhole, 60, 40, 50.0);
        let dir = folder("same");
        let (frames, model) = world(&dir, &camera);
        for _ in 0..2 {
            undistort(&frames, &model, &dir.join("out"), &Progress::silent()).unwrap();
        }
        assert_eq!(fs::read(dir.join("a.png")).unwrap(), fs::read(dir.join("out/images/a.png")).unwrap());
        fs::remove_dir_all(dir).unwrap();
    }
}
