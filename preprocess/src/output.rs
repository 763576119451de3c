//! Folders that appear under their final name only when they are whole.

use crate::PreprocessError;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// `out/images` and `out/masks` while they are being written: temporary folders beside, removed
/// when dropped.
pub(crate) struct Staging {
    out: PathBuf,
    folder: PathBuf,
}

impl Staging {
    /// Makes the temporary folder inside `out` (made too where it is missing).
    pub(crate) fn new(out: &Path) -> Result<Self, PreprocessError> {
        let folder = out.join(".frames.tmp");
        remove(&folder)?;
        std::fs::create_dir_all(folder.join("images")).map_err(PreprocessError::io(&folder))?;
        Ok(Self { out: out.to_owned(), folder })
    }

    /// Where an image or mask is written now.
    pub(crate) fn path(&self, kind: &str, name: &str) -> PathBuf {
        self.folder.join(kind).join(name)
    }

    /// Makes a further folder.
    pub(crate) fn make(&self, kind: &str) -> Result<(), PreprocessError> {
        let path = self.folder.join(kind);
        std::fs::create_dir_all(&path).map_err(PreprocessError::io(path))
    }

    /// Where it will lie at the end.
    pub(crate) fn final_path(&self, kind: &str, name: &str) -> PathBuf {
        self.out.join(kind).join(name)
    }

    /// Puts each folder in the place of an older one; of `stale`, older ones are removed.
    pub(crate) fn publish(self, kinds: &[&str], stale: &[&str]) -> Result<(), PreprocessError> {
        for kind in kinds.iter().chain(stale) {
            let (target, old) = (self.out.join(kind), self.folder.join(format!("old-{kind}")));
            if target.symlink_metadata().is_ok() {
                std::fs::rename(&target, &old).map_err(PreprocessError::io(&target))?;
            }
        }
        for kind in kinds {
            let target = self.out.join(kind);
            std::fs::rename(self.folder.join(kind), &target).map_err(PreprocessError::io(&target))?;
        }
        Ok(())
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        // What cannot be removed is hidden and cleared by the next run.
        let _ = remove(&self.folder);
    }
}

fn remove(folder: &Path) -> Result<(), PreprocessError> {
    match std::fs::remove_dir_all(folder) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(PreprocessError::io(folder)(e)),
        _ => Ok(()),
    }
}

/// Writes 8-bit grey, RGB or RGBA samples as PNG, compressed fast.
pub(crate) fn write_png(
    path: &Path,
    samples: &[u8],
    width: u32,
    height: u32,
    colour: ExtendedColorType,
) -> Result<(), PreprocessError> {
    let file = std::fs::File::create(path).map_err(PreprocessError::io(path))?;
    let mut writer = BufWriter::with_capacity(1 << 18, file);
    PngEncoder::new_with_quality(&mut writer, CompressionType::Fast, FilterType::Adaptive)
        .write_image(samples, width, height, colour)
        .map_err(PreprocessError::image(path))?;
    writer.flush().map_err(PreprocessError::io(path))
}
