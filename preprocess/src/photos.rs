//! From a folder of photos to upright 8-bit images with masks.

use crate::film::FILM;
use crate::masks::{MaskFiles, read_mask};
use crate::names::{natural_order, safe_name};
use crate::output::{Staging, write_png};
use crate::photo_file::PhotoFile;
use crate::pixels::fitted;
use crate::{FrameConfig, PreprocessError, wide};
use image::metadata::Orientation;
use image::{ExtendedColorType, GrayImage, ImageDecoder, ImageFormat};
use rayon::prelude::*;
use scene::io::load::{ImageInfo, image_decoder, image_info, resize_area};
use scene::{Frame, FrameSet, Progress};
use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};

/// How the names of photos end that are read.
pub const PHOTO_EXTENSIONS: [&str; 10] =
    ["png", "jpg", "jpeg", "tif", "tiff", "webp", "heic", "heif", "hif", "avif"];
const NOT_READ: [&str; 9] = ["dng", "cr2", "cr3", "nef", "arw", "raf", "bmp", "gif", "jxl"];

/// Brings the photos of `input_dir` (not of folders inside it) to `out/images`: upright by EXIF,
/// 8-bit, without alpha, at most `--max-size` long; those that are so already are copied byte for
/// byte. Masks come from files or from the alpha channel and go to `out/masks`. Photos that cannot
/// be read are left out and named in the notes.
pub fn photo_frames(
    input_dir: &Path,
    out: &Path,
    config: &FrameConfig,
    progress: &Progress,
) -> Result<FrameSet, PreprocessError> {
    let mut listing = Listing::read(input_dir)?;
    let nested = input_dir.join("images");
    if listing.names.is_empty() && nested.is_dir() {
        listing = Listing::read(&nested)?;
    }
    frames_of(listing, out, config, progress)
}

/// The same for the photos of these names alone, which may lie in folders inside `input_dir`: the
/// frame of `train/a.png` is `train_a.png`.
pub fn listed_photo_frames(
    input_dir: &Path,
    names: &[String],
    out: &Path,
    config: &FrameConfig,
    progress: &Progress,
) -> Result<FrameSet, PreprocessError> {
    let root = input_dir.canonicalize().map_err(PreprocessError::io(input_dir))?;
    let mut listing = Listing::empty(input_dir);
    for name in names {
        listing.add(input_dir.join(name), name.clone(), &root);
    }
    listing.names.sort_by(|a, b| natural_order(a, b));
    frames_of(listing, out, config, progress)
}

fn frames_of(
    mut listing: Listing,
    out: &Path,
    config: &FrameConfig,
    progress: &Progress,
) -> Result<FrameSet, PreprocessError> {
    config.validate()?;
    let input_dir = &listing.folder.clone();
    let masks = MaskFiles::find(&listing.folder, &mut listing.names, config)?;
    if listing.names.is_empty() {
        return Err(PreprocessError::NoImages { path: input_dir.to_owned(), detail: listing.detail() });
    }
    let mut notes = listing.notes();
    if config.frames.is_some()
        || config.fps.is_some()
        || config.every.is_some()
        || config.start.is_some()
        || config.end.is_some()
    {
        notes.push(
            "all photos are taken: --frames, --fps, --every, --start and --end choose from videos".to_owned(),
        );
    }
    let lens = config.lens.wide(|| listing.are_panoramas());
    let given = config;
    let config = &given.before_cutting(lens);
    let staging = Staging::new(out)?;
    staging.make("masks")?;
    staging.make("coded")?;
    let writer = PhotoWriter { folder: &listing.folder, config, masks: &masks, staging: &staging };
    let mut used = HashSet::new();
    let named: Vec<(usize, &String, String)> =
        listing.names.iter().enumerate().map(|(i, n)| (i, n, writer.target_name(n, &mut used))).collect();
    progress.begin("photos", named.len());
    let results: Result<Vec<_>, PreprocessError> = named
        .par_iter()
        .map(|(index, name, target)| {
            progress.tick()?;
            match writer.photo(*index, name, target, progress) {
                Err(e @ PreprocessError::Image { .. }) => Ok(Err(e)),
                Err(e) => Err(e),
                Ok(photo) => Ok(Ok(photo)),
            }
        })
        .collect();
    let (photos, failed): (Vec<_>, Vec<_>) = results?.into_iter().partition(Result::is_ok);
    let failed: Vec<String> = failed.into_iter().filter_map(Result::err).map(|e| e.to_string()).collect();
    let photos: Vec<WrittenPhoto> = photos.into_iter().flatten().collect();
    if photos.is_empty() {
        let detail = format!(
            "; {} cannot be read, the first: {}",
            failed.len(),
            failed.first().cloned().unwrap_or_default()
        );
        return Err(PreprocessError::NoImages { path: input_dir.to_owned(), detail });
    }
    notes.extend(failed.iter().map(|e| format!("left out: {e}")));
    notes.extend(mask_notes(&photos, &masks)?);
    let frames = grouped(photos, &mut notes);
    let has_masks = frames.iter().any(|f| f.mask.is_some());
    progress.check()?;
    if has_masks {
        staging.publish(&["images", "masks"], &[FILM])?
    } else {
        staging.publish(&["images"], &["masks", FILM])?
    }
    let frames = FrameSet { frames, notes, ..FrameSet::default() };
    match lens {
        Some(lens) => wide::cut(frames, lens, out, given, progress),
        None => Ok(frames),
    }
}

/// What lies in a folder.
struct Listing {
    folder: PathBuf,
    names: Vec<String>,
    unread: BTreeMap<String, usize>,
    outside: Vec<String>,
}

impl Listing {
    fn read(folder: &Path) -> Result<Self, PreprocessError> {
        let meta = std::fs::metadata(folder).map_err(|e| match e.kind() {
            std::io::ErrorKind::NotFound => PreprocessError::NotFound { path: folder.to_owned() },
            _ => PreprocessError::io(folder)(e),
        })?;
        if !meta.is_dir() {
            return Err(PreprocessError::WrongKind {
                path: folder.to_owned(),
                found: "a file",
                expected: "a folder of photos",
            });
        }
        let root = folder.canonicalize().map_err(PreprocessError::io(folder))?;
        let mut listing = Self::empty(folder);
        for entry in std::fs::read_dir(folder).map_err(PreprocessError::io(folder))? {
            let entry = entry.map_err(PreprocessError::io(folder))?;
            let name = entry.file_name().to_string_lossy().into_owned();
            if name.starts_with('.') {
                continue;
            }
            let extension = name.rsplit_once('.').map(|(_, e)| e.to_lowercase()).unwrap_or_default();
            if NOT_READ.contains(&extension.as_str()) {
                *listing.unread.entry(extension).or_default() += 1;
            } else if PHOTO_EXTENSIONS.contains(&extension.as_str()) {
                listing.add(entry.path(), name, &root);
            }
        }
        listing.names.sort_by(|a, b| natural_order(a, b));
        Ok(listing)
    }

    fn empty(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), names: Vec::new(), unread: BTreeMap::new(), outside: Vec::new() }
    }

    fn add(&mut self, path: PathBuf, name: String, root: &Path) {
        let is_inside = path.canonicalize().is_ok_and(|p| p.starts_with(root));
        if !is_inside || !path.ends_with(&name) {
            self.outside.push(name);
        } else if path.is_file() {
            self.names.push(name);
        }
    }

    /// Whether all photos say that they are panoramas.
    fn are_panoramas(&self) -> bool {
        self.names.iter().all(|name| image_info(&self.folder.join(name)).is_ok_and(|info| info.is_panorama))
    }

    fn detail(&self) -> String {
        let kinds: Vec<String> = self.unread.iter().map(|(kind, n)| format!("{n} .{kind}")).collect();
        if kinds.is_empty() {
            String::new()
        } else {
            format!("; found {}, which must be converted to JPEG or PNG first", kinds.join(", "))
        }
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if !self.unread.is_empty() {
            notes.push(format!("left out{}", self.detail()));
        }
        if !self.outside.is_empty() {
            notes.push(format!(
                "left out because they are links out of the folder or have a name that is not text: {}",
                self.outside.join(", ")
            ));
        }
        notes
    }
}

/// A photo that was written.
struct WrittenPhoto {
    frame: Frame,
    key: String,
    mask_problem: Option<String>,
    source: MaskSource,
}

#[derive(Clone, Copy, PartialEq)]
enum MaskSource {
    None,
    File,
    Alpha,
}

struct PhotoWriter<'a> {
    folder: &'a Path,
    config: &'a FrameConfig,
    masks: &'a MaskFiles,
    staging: &'a Staging,
}

impl PhotoWriter<'_> {
    /// The file name in the output: the same where the file can be copied.
    fn target_name(&self, name: &str, used: &mut HashSet<String>) -> String {
        let (stem, extension) = name.rsplit_once('.').unwrap_or((name, "png"));
        let info = image_info(&self.folder.join(name));
        let copies = info.is_ok_and(|i| self.can_copy(&self.folder.join(name), &i));
        safe_name(stem, if copies { extension } else { "png" }, used)
    }

    /// Whether the file is already what is wanted: upright, 8-bit, opaque, small enough, and of the
    /// format it says.
    fn can_copy(&self, path: &Path, info: &ImageInfo) -> bool {
        let Ok((mut decoder, format)) = image_decoder(path) else { return false };
        let says = path.extension().and_then(ImageFormat::from_extension);
        let upright = decoder.orientation().is_ok_and(|o| o == Orientation::NoTransforms);
        let depth = decoder.color_type().bytes_per_pixel() / decoder.color_type().channel_count();
        let size = fitted(info.width, info.height, self.config.max_size);
        let common = matches!(format, Some(ImageFormat::Png | ImageFormat::Jpeg));
        upright
            && depth == 1
            && !info.has_alpha
            && size == (info.width, info.height)
            && common
            && format == says
    }

    fn photo(
        &self,
        index: usize,
        name: &str,
        target: &str,
        progress: &Progress,
    ) -> Result<WrittenPhoto, PreprocessError> {
        let path = self.folder.join(name);
        let scratch = self.staging.path("coded", &index.to_string());
        let PhotoFile { info, pixels, orientation } = PhotoFile::read(&path, &scratch, progress)?;
        let upright = pixels.rgb.dimensions();
        let size = fitted(upright.0, upright.1, self.config.max_size);
        let written = self.staging.path("images", target);
        if self.can_copy(&path, &info) {
            std::fs::copy(&path, &written).map_err(PreprocessError::io(&written))?;
        } else {
            let rgb = resize_area(&pixels.rgb, size.0, size.1);
            write_png(&written, rgb.as_raw(), size.0, size.1, ExtendedColorType::Rgb8)?;
        }
        let (mask, source, mask_problem) = self.mask(name, orientation, pixels.alpha, upright, size);
        let mask_name = format!("{}.png", target.rsplit_once('.').map_or(target, |(stem, _)| stem));
        if let Some(mask) = &mask {
            write_png(
                &self.staging.path("masks", &mask_name),
                mask.as_raw(),
                size.0,
                size.1,
                ExtendedColorType::L8,
            )?;
        }
        let exif = &info.exif;
        let frame = Frame {
            name: target.to_owned(),
            path: self.staging.final_path("images", target),
            width: size.0,
            height: size.1,
            mask: mask.map(|_| self.staging.final_path("masks", &mask_name)),
            time_s: None,
            source_index: index,
            focal_prior_px: info.focal_prior_px.map(|f| f * f64::from(size.0) / f64::from(upright.0)),
            gps: info.exif.gps,
            up: info.up.map(|up| up.to_array()),
            camera_group: 0,
        };
        let key =
            format!("{size:?} {:?} {:?} {:?} {:?}", exif.make, exif.model, exif.focal_mm, exif.focal_35mm);
        Ok(WrittenPhoto { frame, key, mask_problem, source })
    }

    fn mask(
        &self,
        name: &str,
        orientation: Orientation,
        alpha: Option<GrayImage>,
        upright: (u32, u32),
        size: (u32, u32),
    ) -> (Option<GrayImage>, MaskSource, Option<String>) {
        if let Some(file) = self.masks.of(name) {
            return match read_mask(file, orientation, upright, size, self.config.invert_masks) {
                Ok(mask) => (Some(mask), MaskSource::File, None),
                Err(e) => (None, MaskSource::None, Some(e.to_string())),
            };
        }
        let alpha = alpha.filter(|a| self.config.masks != "off" && a.iter().any(|v| *v < 255));
        match alpha {
            Some(alpha) => (Some(resize_area(&alpha, size.0, size.1)), MaskSource::Alpha, None),
            None => (None, MaskSource::None, None),
        }
    }
}

fn mask_notes(photos: &[WrittenPhoto], masks: &MaskFiles) -> Result<Vec<String>, PreprocessError> {
    let [files, alpha] = [MaskSource::File, MaskSource::Alpha]
        .map(|source| photos.iter().filter(|p| p.source == source).count());
    let mut notes = Vec::new();
    if let Some(folder) = &masks.folder
        && files == 0
    {
        return Err(PreprocessError::NoMaskMatches { masks: folder.clone(), images: photos.len() });
    }
    if masks.len() > 0 {
        notes.push(format!("{files} of {} masks matched", photos.len()));
    }
    if alpha > 0 {
        notes.push(format!("{alpha} of {} masks taken from the alpha channel", photos.len()));
    }
    notes.extend(photos.iter().filter_map(|p| p.mask_problem.clone()).map(|e| format!("mask left out: {e}")));
    Ok(notes)
}

/// Numbers the cameras: photos of one size, device and focal length share one.
fn grouped(photos: Vec<WrittenPhoto>, notes: &mut Vec<String>) -> Vec<Frame> {
    let mut groups: Vec<String> = Vec::new();
    let mut sizes = HashSet::new();
    let mut frames = Vec::with_capacity(photos.len());
    for mut photo in photos {
        let known = groups.iter().position(|k| *k == photo.key);
        let group = known.unwrap_or_else(|| {
            groups.push(photo.key.clone());
            groups.len() - 1
        });
        photo.frame.camera_group = group as u32;
        sizes.insert((photo.frame.width, photo.frame.height));
        frames.push(photo.frame);
    }
    if groups.len() > 1 {
        notes.push(format!(
            "{} cameras told apart by size, device and focal length ({} image sizes)",
            groups.len(),
            sizes.len()
        ));
    }
    frames
}
