//! The files that a stage wrote, known again by size, time and content.

use anyhow::{Context, Result};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::fs::{File, Metadata};
use std::path::{Path, PathBuf};

/// A file that a stage wrote.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputFile {
    /// Relative to the output folder.
    pub path: PathBuf,
    bytes: u64,
    modified_ns: u64,
    /// Of the content.
    pub hash: String,
}

/// Lists, brings to the disk and hashes everything below `names` in `folder`; names that are
/// missing have no files.
pub(super) fn list(folder: &Path, names: &[&str]) -> Result<Vec<OutputFile>> {
    let mut files = Vec::new();
    for name in names {
        collect(folder, Path::new(name), &mut files)?;
    }
    files.sort();
    files.into_par_iter().map(|path| described(folder, path)).collect()
}

fn collect(folder: &Path, name: &Path, files: &mut Vec<PathBuf>) -> Result<()> {
    let path = folder.join(name);
    let Ok(meta) = path.symlink_metadata() else { return Ok(()) };
    if !meta.is_dir() {
        files.push(name.to_path_buf());
        return Ok(());
    }
    for entry in std::fs::read_dir(&path).with_context(|| format!("cannot list {}", path.display()))? {
        collect(folder, &name.join(entry?.file_name()), files)?;
    }
    Ok(())
}

fn described(folder: &Path, path: PathBuf) -> Result<OutputFile> {
    let whole = folder.join(&path);
    let read = || -> std::io::Result<OutputFile> {
        let file = File::open(&whole)?;
        file.sync_all()?;
        let meta = file.metadata()?;
        let hash = content_hash(file)?;
        Ok(OutputFile { path, bytes: meta.len(), modified_ns: modified_ns(&meta), hash })
    };
    read().with_context(|| format!("cannot read {}", whole.display()))
}

fn content_hash(mut file: File) -> std::io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    std::io::copy(&mut file, &mut hasher)?;
    Ok(hasher.finalize().to_hex()[..32].to_owned())
}

fn modified_ns(meta: &Metadata) -> u64 {
    let since = meta.modified().ok().and_then(|t| t.duration_since(std::time::UNIX_EPOCH).ok());
    since.map_or(0, |d| d.as_nanos() as u64)
}

/// What is no longer as it was written, in words; a file whose time alone differs is read.
pub(super) fn difference(folder: &Path, files: &[OutputFile]) -> Option<String> {
    files.par_iter().find_map_first(|known| {
        let path = folder.join(&known.path);
        let Ok(meta) = path.metadata() else { return Some(format!("{} is missing", path.display())) };
        let same_time = modified_ns(&meta) == known.modified_ns;
        let is_same = meta.is_file()
            && meta.len() == known.bytes
            && (same_time || File::open(&path).and_then(content_hash).is_ok_and(|h| h == known.hash));
        (!is_same).then(|| format!("{} has changed", path.display()))
    })
}
