//! Files and folders that are whole or absent: written beside the target, renamed when complete.

use super::error::IoError;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// A name beside `path` that nobody else uses: hidden, with process and running number.
fn beside(path: &Path, what: &str) -> PathBuf {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let number = NEXT.fetch_add(1, Ordering::Relaxed);
    path.with_file_name(format!(".{name}.{}.{number}.{what}", std::process::id()))
}

fn create_parent(path: &Path) -> Result<(), IoError> {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => {
            fs::create_dir_all(parent).map_err(IoError::file("create the folder", parent))
        }
        _ => Ok(()),
    }
}

/// Makes the new name of a file durable; not every file system can, so a failure is no error.
fn sync_parent(path: &Path) {
    let parent = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if let Ok(folder) = File::open(parent) {
        let _ = folder.sync_all();
    }
}

/// Writes a file through `write`: the target keeps its old content (or stays absent) unless all of it has
/// reached the disk. Missing parent folders are made.
pub fn write_atomic(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<(), IoError> {
    write_file_atomic(path, |temporary| {
        let mut out = BufWriter::with_capacity(1 << 16, File::create(temporary)?);
        write(&mut out)?;
        out.flush()
    })
}

/// [`write_atomic`] for writers that want a path: `write` makes a file of the given name, which does not exist yet.
pub(crate) fn write_file_atomic(
    path: &Path,
    write: impl FnOnce(&Path) -> io::Result<()>,
) -> Result<(), IoError> {
    create_parent(path)?;
    let temporary = beside(path, "tmp");
    let result = write(&temporary).and_then(|()| {
        OpenOptions::new().write(true).open(&temporary)?.sync_all()?;
        fs::rename(&temporary, path)
    });
    if result.is_err() {
        let _ = fs::remove_file(&temporary);
    }
    result.map_err(IoError::file("write", path))?;
    sync_parent(path);
    Ok(())
}

/// Fills a new folder through `fill` and puts it in the place of `path` when that succeeded; what was there
/// before is removed only then.
pub fn replace_folder<E: From<IoError>>(
    path: &Path,
    fill: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    create_parent(path)?;
    let temporary = beside(path, "tmp");
    fs::create_dir(&temporary).map_err(IoError::file("create the folder", &temporary))?;
    let done = fill(&temporary)
        .and_then(|()| Ok(swap_folder(&temporary, path).map_err(IoError::file("replace", path))?));
    if done.is_err() {
        let _ = fs::remove_dir_all(&temporary);
        return done;
    }
    sync_parent(path);
    Ok(())
}

fn swap_folder(new: &Path, target: &Path) -> io::Result<()> {
    if !target.exists() {
        return fs::rename(new, target);
    }
    let old = beside(target, "old");
    fs::rename(target, &old)?;
    if let Err(error) = fs::rename(new, target) {
        fs::rename(&old, target)?;
        return Err(error);
    }
    fs::remove_dir_all(&old)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::test_folder;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_rubbish() {
        let dir = test_folder("atomic_file");
        let path = dir.join("deep/er/a.txt");
        write_atomic(&path, |w| w.write_all(b"first")).unwrap();
        let error = write_atomic(&path, |w| {
            w.write_all(b"second")?;
            Err(io::Error::other("disk full"))
        });
        assert!(error.unwrap_err().to_string().contains("disk full"));
        assert_eq!(fs::read(&path).unwrap(), b"first");
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn a_folder_is_replaced_as_a_whole_or_not_at_all() {
        let dir = test_folder("atomic_folder");
        let path = dir.join("out");
        let fill = |text: &'static str| {
            move |d: &Path| fs::write(d.join(text), text).map_err(IoError::file("write", d))
        };
        replace_folder(&path, fill("one")).unwrap();
        replace_folder(&path, fill("two")).unwrap();
        assert!(path.join("two").exists() && !path.join("one").exists());
        let failed: Result<(), IoError> = replace_folder(&path, |d| Err(IoError::format(d, "no")));
        assert!(failed.is_err() && path.join("two").exists());
        assert_eq!(fs::read_dir(&dir).unwrap().count(), 1);
    }
}
