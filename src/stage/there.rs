//! Reading what may be missing. That something is not there is an answer; that it could not be read
//! is an error: a result that is there must not be made again, or removed, because a disk or a
//! network failed for a moment.

use anyhow::{Context, Result};
use std::fs::{self, Metadata};
use std::io::{self, ErrorKind};
use std::path::Path;

/// The bytes of a file; `None` where there is none.
pub(super) fn read(path: &Path) -> Result<Option<Vec<u8>>> {
    if_there(fs::read(path), path)
}

/// What is at a path, where it is a link the link; `None` where nothing is.
pub(super) fn entry(path: &Path) -> Result<Option<Metadata>> {
    if_there(path.symlink_metadata(), path)
}

/// What was read of a path; `None` where nothing is there.
pub(super) fn if_there<T>(found: io::Result<T>, path: &Path) -> Result<Option<T>> {
    match found {
        Ok(found) => Ok(Some(found)),
        Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => Ok(None),
        Err(e) => Err(e).with_context(|| format!("cannot read {}", path.display())),
    }
}
