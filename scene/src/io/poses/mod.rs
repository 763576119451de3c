//! Poses that other programs have found: Metashape, RealityScan, Bundler, OpenSfM, nerfstudio; data
//! sets of NeRF, D-NeRF and HyperNeRF.
//!
//! Cameras and poses are read; points are not, since these files hold no observations of them or
//! number them by features that are not there.

mod bundler;
mod hypernerf;
mod imported;
mod metashape;
mod opensfm;
mod realityscan;

pub use imported::ImportedPoses;
pub use metashape::{parse as parse_metashape, write_metashape};
pub use opensfm::parse as parse_opensfm;

use super::error::IoError;
use super::read_model;
use super::transforms::{SPLIT, WORLD_FROM_TRANSFORMS, read_transforms};
use crate::sim3::Sim3;
use std::path::{Path, PathBuf};

/// Names under which [`find_poses`] looks for files, with those that only this program knows by
/// their ending in other folders left out.
const NAMES: [&str; 8] = [
    "transforms.json",
    SPLIT[0],
    "reconstruction.json",
    "cameras.xml",
    "bundle.out",
    "bundle/bundle.out",
    "cameras.csv",
    hypernerf::DATASET,
];

/// Whether a file with this name is one that [`read_poses`] reads.
pub fn is_poses_file(path: &Path) -> bool {
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    matches!(ending.as_deref(), Some("json" | "xml" | "out" | "csv"))
}

/// The file of poses that lies in a folder of images, if there is one.
pub fn find_poses(folder: &Path) -> Option<PathBuf> {
    NAMES.iter().map(|n| folder.join(n)).find(|p| p.is_file())
}

fn is_named(path: &Path, name: &str) -> bool {
    path.file_name().is_some_and(|n| n == name)
}

/// The images of data sets whose images lie in several folders, beside others that do not belong to
/// them: names relative to the folder of the file of poses. Empty for all other files of poses.
pub fn listed_images(path: &Path) -> Result<Vec<String>, IoError> {
    if !is_named(path, SPLIT[0]) && !is_named(path, hypernerf::DATASET) {
        return Ok(Vec::new());
    }
    let found = read_poses(path, path.parent().unwrap_or(Path::new(".")))?;
    Ok(found.model.images.into_values().map(|image| image.name).collect())
}

/// Reads poses in whatever form they have: a folder with a COLMAP model, `transforms.json`,
/// HyperNeRF's `dataset.json`, OpenSfM's `reconstruction.json`, Metashape's `.xml`, Bundler's
/// `.out` (with a list of images beside it), RealityScan's `.csv`. `images`: the folder of the
/// images, for files that do not tell their size.
pub fn read_poses(path: &Path, images: &Path) -> Result<ImportedPoses, IoError> {
    if path.is_dir() {
        return Ok(ImportedPoses::of(read_model(path)?, Sim3::IDENTITY));
    }
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    let imported = match ending.as_deref() {
        Some("xml") => metashape::read(path)?,
        Some("out") => bundler::read(path, images)?,
        Some("csv") => realityscan::read(path, images)?,
        Some("json") if is_named(path, hypernerf::DATASET) => hypernerf::read(path)?,
        Some("json") if opensfm::is_reconstruction(path)? => opensfm::read(path)?,
        _ => {
            let file = read_transforms(path)?;
            let times = file.frames.iter().filter_map(|f| Some((f.file_path.clone(), f.time?))).collect();
            let world = WORLD_FROM_TRANSFORMS;
            ImportedPoses { times, held_out: file.held_out, ..ImportedPoses::of(file.reconstruction, world) }
        }
    };
    if imported.model.images.is_empty() {
        return Err(IoError::format(path, "expected images with poses, found none"));
    }
    Ok(imported)
}
