//! Files and folders that are whole or absent: written beside the target (by `tempfile`), renamed
//! when complete.

use super::error::IoError;
use std::ffi::OsStr;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::Path;
use tempfile::{Builder, TempDir, TempPath};

/// Buffer of written files, bytes. Source: chosen by hand, never measured.
const BUFFER_BYTES: usize = 1 << 16;

/// How the names of temporary files and folders begin and end.
const TEMPORARY: [&str; 2] = [".sat-recon-", ".tmp"];

/// Whether a file of this name was being written when the program was interrupted.
pub fn is_temporary(name: &OsStr) -> bool {
    name.to_str().is_some_and(|n| n.starts_with(TEMPORARY[0]) && n.ends_with(TEMPORARY[1]))
}

fn parent_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

fn create_parent(path: &Path) -> Result<(), IoError> {
    let parent = parent_of(path);
    fs::create_dir_all(parent).map_err(IoError::file("create the folder", parent))
}

/// The permissions that other programs give new files or folders; the process's mask applies.
fn with_usual_permissions<'a, 'b>(builder: &'a mut Builder<'b, 'b>, mode: u32) -> &'a mut Builder<'b, 'b> {
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(mode));
    #[cfg(not(unix))]
    let _ = mode;
    builder
}

/// A hidden file beside `path` that is removed unless it is kept.
fn file_beside(path: &Path) -> io::Result<TempPath> {
    let mut builder = Builder::new();
    let file = with_usual_permissions(builder.prefix(TEMPORARY[0]).suffix(TEMPORARY[1]), 0o666)
        .tempfile_in(parent_of(path))?;
    Ok(file.into_temp_path())
}

/// A hidden folder beside `path` that is removed unless it is kept.
fn folder_beside(path: &Path) -> io::Result<TempDir> {
    let mut builder = Builder::new();
    with_usual_permissions(builder.prefix(TEMPORARY[0]).suffix(TEMPORARY[1]), 0o777)
        .tempdir_in(parent_of(path))
}

/// Makes the new name of a file durable; not every file system can, so a failure is no error.
fn sync_parent(path: &Path) {
    if let Ok(folder) = File::open(parent_of(path)) {
        let _ = folder.sync_all();
    }
}

/// Writes a file through `write`: the target keeps its old content (or stays absent) unless all of
/// it has reached the disk. Missing parent folders are made.
pub fn write_atomic(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<(), IoError> {
    write_file_atomic(path, |temporary| {
        let mut out = BufWriter::with_capacity(BUFFER_BYTES, File::create(temporary)?);
        write(&mut out)?;
        out.flush()
    })
}

/// [`write_atomic`] for writers that want a path: `write` fills the file of that name, which is
/// empty.
pub(crate) fn write_file_atomic(
    path: &Path,
    write: impl FnOnce(&Path) -> io::Result<()>,
) -> Result<(), IoError> {
    create_parent(path)?;
    fill_and_rename(path, write).map_err(IoError::file("write", path))?;
    sync_parent(path);
    Ok(())
}

fn fill_and_rename(path: &Path, write: impl FnOnce(&Path) -> io::Result<()>) -> io::Result<()> {
    let temporary = file_beside(path)?;
    write(&temporary)?;
    OpenOptions::new().write(true).open(&temporary)?.sync_all()?;
    Ok(temporary.persist(path)?)
}

/// Fills a new folder through `fill` and puts it in the place of `path` when that succeeded; what
/// was there before is removed only then.
pub fn replace_folder<E: From<IoError>>(
    path: &Path,
    fill: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    create_parent(path)?;
    let temporary = folder_beside(path).map_err(IoError::file("create a folder beside", path))?;
    fill(temporary.path())?;
    swap_folder(temporary, path).map_err(IoError::file("replace", path))?;
    sync_parent(path);
    Ok(())
}

fn swap_folder(new: TempDir, target: &Path) -> io::Result<()> {
    // What was there goes with the temporary folder it is moved into.
    let old = folder_beside(target)?;
    let aside = old.path().join("old");
    let existed = target.exists();
    if existed {
        fs::rename(target, &aside)?;
    }
    if let Err(error) = fs::rename(new.path(), target) {
        if existed {
            fs::rename(&aside, target)?;
        }
        return Err(error);
    }
    let _ = new.keep(); // it has another name now
    old.close()
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
