//! One run at a time in an output folder, and never in a folder that holds the files of others.

use anyhow::{Context, Result, bail};
use std::fs::{File, TryLockError};
use std::path::Path;

/// What a run writes that others could have written too.
const CONTESTED: [&str; 9] = [
    "images",
    "masks",
    "sparse",
    "undistorted",
    "refined",
    "eval",
    "transforms.json",
    "splat.ply",
    "field.bin",
];

/// Its name in `.stages`. Once it is there, the output folder is ours.
const LOCK: &str = "lock";

/// A folder that holds something that no run of ours made is not written over.
pub(super) fn refuse_foreign(out: &Path, stages: &Path) -> Result<()> {
    if stages.join(LOCK).exists() || stages.join("frames.json").exists() {
        return Ok(());
    }
    for path in CONTESTED.map(|name| out.join(name)) {
        let is_empty = std::fs::read_dir(&path).is_ok_and(|mut files| files.next().is_none());
        if path.symlink_metadata().is_ok() && !is_empty {
            bail!("{} was not written by sat-recon; choose another folder with -o", path.display());
        }
    }
    Ok(())
}

/// Takes the folder's lock, which the system gives back when the process ends, however it ends.
/// Where the file system knows no locks there is none.
pub(super) fn take(stages: &Path) -> Result<Option<File>> {
    let path = stages.join(LOCK);
    let file = File::options().create(true).truncate(false).write(true).open(&path);
    let file = file.with_context(|| format!("cannot write {}", path.display()))?;
    let is_taken = matches!(file.try_lock(), Err(TryLockError::WouldBlock));
    Ok((!is_taken).then_some(file))
}
