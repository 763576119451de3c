//! The files that a stage wrote, known again by size, time and content.

use super::there;
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
    let Some(meta) = there::entry(&path)? else { return Ok(()) };
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
pub(super) fn difference(folder: &Path, files: &[OutputFile]) -> Result<Option<String>> {
    files.par_iter().find_map_first(|known| how_changed(folder, known).transpose()).transpose()
}

fn how_changed(folder: &Path, known: &OutputFile) -> Result<Option<String>> {
    let path = folder.join(&known.path);
    let Some(meta) = there::if_there(path.metadata(), &path)? else {
        return Ok(Some(format!("{} is missing", path.display())));
    };
    let mut is_same = meta.is_file() && meta.len() == known.bytes;
    if is_same && modified_ns(&meta) != known.modified_ns {
        let hash = there::if_there(File::open(&path).and_then(content_hash), &path)?;
        is_same = hash.as_ref() == Some(&known.hash);
    }
    Ok((!is_same).then(|| format!("{} has changed", path.display())))
}
