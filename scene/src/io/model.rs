//! A COLMAP model folder, whichever form it has.

use super::error::IoError;
use super::{colmap_bin, colmap_txt};
use crate::Reconstruction;
use std::path::{Path, PathBuf};

/// Whether the folder itself holds a COLMAP model (binary or text).
pub fn has_model(dir: &Path) -> bool {
    ["bin", "txt"]
        .iter()
        .any(|e| ["cameras", "images"].iter().all(|f| dir.join(f).with_extension(e).is_file()))
}

/// The model folder at or below `dir`: `dir`, `dir/sparse/0`, `dir/sparse`, `dir/0`.
pub fn find_model(dir: &Path) -> Option<PathBuf> {
    ["", "sparse/0", "sparse", "0"].into_iter().map(|sub| dir.join(sub)).find(|d| has_model(d))
}

/// Reads a COLMAP model (binary if both forms are there) from the folder that holds it or one above
/// (see [`find_model`]). `rigs` and `frames` files of COLMAP 3.12 and later are not needed:
/// `images` holds each image's own pose there too. The result is valid
/// ([`Reconstruction::validate`]).
pub fn read_model(dir: &Path) -> Result<Reconstruction, IoError> {
    let Some(found) = find_model(dir) else {
        return Err(IoError::format(
            dir,
            "expected a COLMAP model: cameras and images as .bin or .txt, here or in sparse/0; found none",
        ));
    };
    let binary = found.join("images.bin").is_file() && found.join("cameras.bin").is_file();
    consistent(&found, if binary { colmap_bin::read(&found)? } else { colmap_txt::read(&found)? })
}

fn consistent(dir: &Path, model: Reconstruction) -> Result<Reconstruction, IoError> {
    model
        .validate()
        .map_err(|message| IoError::format(dir, format!("the model contradicts itself: {message}")))?;
    Ok(model)
}

/// The model of the contents of a binary model's files, cameras and images, and points. `dir` names
/// them in messages.
pub fn parse_model_bin(
    dir: &Path,
    files: [&[u8]; 2],
    points: Option<&[u8]>,
) -> Result<Reconstruction, IoError> {
    consistent(dir, colmap_bin::parse(dir, files, points)?)
}

/// The same of a model in text form.
pub fn parse_model_txt(
    dir: &Path,
    files: [&str; 2],
    points: Option<&str>,
) -> Result<Reconstruction, IoError> {
    consistent(dir, colmap_txt::parse(dir, files, points)?)
}

/// Writes `cameras.bin`, `images.bin`, `points3D.bin`.
pub fn write_model_bin(model: &Reconstruction, dir: &Path) -> Result<(), IoError> {
    check(model, dir)?;
    colmap_bin::write(model, dir)
}

/// Writes `cameras.txt`, `images.txt`, `points3D.txt` with COLMAP's comment headers; numbers read
/// back exactly.
pub fn write_model_txt(model: &Reconstruction, dir: &Path) -> Result<(), IoError> {
    check(model, dir)?;
    colmap_txt::write(model, dir)
}

fn check(model: &Reconstruction, dir: &Path) -> Result<(), IoError> {
    model.validate().map_err(|m| {
        IoError::format(dir, format!("refused to write a model that contradicts itself: {m}"))
    })?;
    model.images.values().try_for_each(|i| super::safe_name(&i.name).map(|_| ()).map_err(IoError::name(dir)))
}
