//! A stage's result is put in place as a whole, or not at all.
//!
//! A stage fills `.stages/NAME.new`, laid out like the output folder. When it is complete, its
//! record is written into it and the folder is renamed to `.stages/NAME.commit`: from that moment
//! the result counts. Then old outputs go to `.stages/NAME.old`, new ones to their places, and the
//! record last to `.stages/NAME.json`. After an interruption the next start does the rest of that
//! again ([`settle`]); everything else that it finds half done was not committed and is removed.

use super::{OutputFile, there};
use anyhow::{Context, Result};
use serde::Deserialize;
use std::ffi::OsStr;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// The record inside a workspace.
const RECORD: &str = "record.json";

/// A folder that a stage fills; removed with everything in it unless it is committed.
pub(super) struct Workspace<'a> {
    stages: &'a Path,
    name: &'a str,
}

/// Which paths a committed record is about.
#[derive(Deserialize)]
struct Manifest {
    owns: Vec<String>,
    outputs: Vec<OutputFile>,
}

impl<'a> Workspace<'a> {
    /// An empty folder.
    pub(super) fn new(stages: &'a Path, name: &'a str) -> Result<Self> {
        let workspace = Self { stages, name };
        let folder = workspace.folder();
        remove(&folder)?;
        fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        Ok(workspace)
    }

    /// Where the stage writes.
    pub(super) fn folder(&self) -> PathBuf {
        self.stages.join(format!("{}.new", self.name))
    }

    /// Where the record goes.
    pub(super) fn record(&self) -> PathBuf {
        self.folder().join(RECORD)
    }

    /// Puts the outputs and the record in their places.
    pub(super) fn commit(self, out: &Path) -> Result<()> {
        let committed = self.stages.join(format!("{}.commit", self.name));
        remove(&committed)?;
        rename(&self.folder(), &committed)?;
        finish(out, self.stages, self.name)
    }
}

impl Drop for Workspace<'_> {
    fn drop(&mut self) {
        let _ = remove(&self.folder()); // what cannot be removed is swept by the next start
    }
}

/// Finishes what was committed and removes what was not.
pub(super) fn settle(out: &Path, stages: &Path) -> Result<()> {
    for name in endings(stages, "commit")? {
        finish(out, stages, &name)?;
    }
    for ending in ["new", "old"] {
        for name in endings(stages, ending)? {
            remove(&stages.join(format!("{name}.{ending}")))?;
        }
    }
    [out, stages, &stages.join("train")].into_iter().try_for_each(sweep)
}

/// The names of the stages of which there is a folder with this ending.
fn endings(stages: &Path, ending: &str) -> Result<Vec<String>> {
    let entries = fs::read_dir(stages).with_context(|| format!("cannot list {}", stages.display()))?;
    let mut names = Vec::new();
    for entry in entries {
        let path = entry.with_context(|| format!("cannot list {}", stages.display()))?.path();
        let is_ours = path.extension() == Some(OsStr::new(ending));
        if is_ours && there::entry(&path)?.is_some_and(|meta| meta.is_dir()) {
            names.extend(path.file_stem().and_then(OsStr::to_str).map(str::to_owned));
        }
    }
    Ok(names)
}

/// Removes what interrupted writes have left.
fn sweep(folder: &Path) -> Result<()> {
    let Ok(entries) = fs::read_dir(folder) else { return Ok(()) };
    let names = entries.filter_map(|e| Some(e.ok()?.file_name()));
    let ours = names.filter(|n| scene::io::atomic::is_temporary(n) || n == ".frames.tmp");
    ours.into_iter().try_for_each(|name| remove(&folder.join(name)))
}

/// From the commit to the record; may be done again after an interruption at any point.
fn finish(out: &Path, stages: &Path, name: &str) -> Result<()> {
    let committed = stages.join(format!("{name}.commit"));
    let record = committed.join(RECORD);
    if let Some(text) = there::read(&record)? {
        let manifest: Manifest = serde_json::from_slice(&text)
            .with_context(|| format!("{} is damaged; delete it", committed.display()))?;
        let old = stages.join(format!("{name}.old"));
        for owned in &manifest.owns {
            let (new, target) = (committed.join(owned), out.join(owned));
            let is_ready = there::entry(&new)?.is_some();
            let is_placed = manifest.outputs.iter().any(|file| file.path.starts_with(owned));
            if is_ready || !is_placed {
                set_aside(&target, &old.join(owned))?;
            }
            if is_ready {
                make_parent(&target)?;
                rename(&new, &target)?;
            }
        }
        rename(&record, &stages.join(format!("{name}.json")))?;
        remove(&old)?;
    }
    remove(&committed)
}

/// Moves what is at `target` away, if something is.
fn set_aside(target: &Path, aside: &Path) -> Result<()> {
    if there::entry(target)?.is_none() {
        return Ok(());
    }
    make_parent(aside)?;
    remove(aside)?;
    rename(target, aside)
}

fn make_parent(path: &Path) -> Result<()> {
    let Some(parent) = path.parent() else { return Ok(()) };
    fs::create_dir_all(parent).with_context(|| format!("cannot make {}", parent.display()))
}

/// Renames, and makes the new name durable where the file system can.
fn rename(from: &Path, to: &Path) -> Result<()> {
    fs::rename(from, to).with_context(|| format!("cannot move {} to {}", from.display(), to.display()))?;
    if let Some(Ok(folder)) = to.parent().map(fs::File::open) {
        let _ = folder.sync_all(); // not every file system can
    }
    Ok(())
}

/// Removes a file, a link or a folder; what is not there is removed.
pub(super) fn remove(path: &Path) -> Result<()> {
    let is_folder = there::entry(path)?.is_some_and(|meta| meta.is_dir());
    let removed = if is_folder { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    match removed {
        Err(e) if e.kind() != ErrorKind::NotFound => {
            Err(e).with_context(|| format!("cannot remove {}", path.display()))
        }
        _ => Ok(()),
    }
}
