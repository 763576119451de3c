//! Masks that lie beside photos, in the namings in use.

use crate::{FrameConfig, PreprocessError};
use image::metadata::Orientation;
use image::{DynamicImage, GrayImage};
use scene::io::load::{load_mask, resize_area};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Mask files of a capture, by the name of their image.
#[derive(Debug, Default)]
pub(crate) struct MaskFiles {
    /// The folder they were looked for in, where there is one.
    pub folder: Option<PathBuf>,
    found: HashMap<String, PathBuf>,
}

impl MaskFiles {
    /// Takes mask files out of `names` (they lie among the photos), then looks through the mask
    /// folder.
    pub(crate) fn find(
        photos: &Path,
        names: &mut Vec<String>,
        config: &FrameConfig,
    ) -> Result<Self, PreprocessError> {
        let folder = match config.masks.as_str() {
            "off" => return Ok(Self::default()),
            "auto" => [Some(photos.join("masks")), photos.parent().map(|p| p.join("masks"))]
                .into_iter()
                .flatten()
                .find(|f| f.is_dir() && f != photos),
            given => Some(PathBuf::from(given)),
        };
        if config.masks == "auto"
            && let Some(folder) = &folder
            && leads_out(folder, photos.parent().unwrap_or(photos))
        {
            return Err(linked(folder, "name it with --masks"));
        }
        let mut masks = Self { folder, found: HashMap::new() };
        let images = names.clone();
        for image in &images {
            let beside = spellings(image)
                .into_iter()
                .find(|m| m != image && m.len() > image.len() && images.contains(m));
            if let Some(mask) = beside {
                names.retain(|n| *n != mask);
                masks.found.insert(image.clone(), photos.join(mask));
            }
        }
        if let Some(folder) = &masks.folder {
            let entries = std::fs::read_dir(folder).map_err(PreprocessError::io(folder))?;
            let present: std::collections::HashSet<_> = entries.flatten().map(|e| e.file_name()).collect();
            for image in names.iter() {
                if let Some(mask) =
                    spellings(image).into_iter().find(|m| present.contains(std::ffi::OsStr::new(m)))
                {
                    let mask = folder.join(mask);
                    if leads_out(&mask, folder) {
                        return Err(linked(&mask, "copy the file there"));
                    }
                    masks.found.insert(image.clone(), mask);
                }
            }
        }
        Ok(masks)
    }

    /// The file for this image.
    pub(crate) fn of(&self, image: &str) -> Option<&Path> {
        self.found.get(image).map(PathBuf::as_path)
    }

    /// Number of images with a file.
    pub(crate) fn len(&self) -> usize {
        self.found.len()
    }
}

/// Whether a path, links followed, lies outside a folder.
fn leads_out(path: &Path, folder: &Path) -> bool {
    match (path.canonicalize(), folder.canonicalize()) {
        (Ok(path), Ok(folder)) => !path.starts_with(folder),
        _ => true,
    }
}

fn linked(path: &Path, what_to_do: &str) -> PreprocessError {
    PreprocessError::Config(format!("{} is a link out of its folder; {what_to_do}", path.display()))
}

/// How the mask of `a.jpg` may be called, the most specific first.
fn spellings(image: &str) -> Vec<String> {
    let stem = image.rsplit_once('.').map_or(image, |(stem, _)| stem);
    vec![
        format!("{image}.png"),
        format!("{stem}.mask.png"),
        format!("{image}.mask.png"),
        format!("{stem}.png"),
        image.to_owned(),
    ]
}

/// Reads a mask for an image stored with `orientation` and brings it to the image's final size.
///
/// A mask belongs to the stored pixels and is turned with them, unless only its upright shape fits.
pub(crate) fn read_mask(
    path: &Path,
    orientation: Orientation,
    upright: (u32, u32),
    target: (u32, u32),
    invert: bool,
) -> Result<GrayImage, PreprocessError> {
    let mut mask = load_mask(path).map_err(PreprocessError::image(path))?;
    let fits = |m: &GrayImage| {
        let (a, b) =
            (f64::from(m.width()) * f64::from(upright.1), f64::from(m.height()) * f64::from(upright.0));
        m.width() > 0 && (a / b - 1.0).abs() < 0.01
    };
    let mut turned = DynamicImage::ImageLuma8(mask.clone());
    turned.apply_orientation(orientation);
    let turned = turned.into_luma8();
    if fits(&turned) {
        mask = turned;
    } else if !fits(&mask) {
        let reason = format!(
            "the mask has {} x {} pixels, its image {} x {}",
            mask.width(),
            mask.height(),
            upright.0,
            upright.1
        );
        return Err(PreprocessError::Image { path: path.to_owned(), reason });
    }
    let mut mask = resize_area(&mask, target.0, target.1);
    if invert {
        mask.iter_mut().for_each(|v| *v = 255 - *v);
    }
    Ok(mask)
}
