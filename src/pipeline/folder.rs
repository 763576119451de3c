//! The output folder: its name, and what is remembered of the files in it.

use crate::config::former_run;
use anyhow::{Result, bail};
use scene::FrameSet;
use std::path::{Path, PathBuf};

/// The output folder: the one that was named, or the input's name with `_recon` in the current
/// folder, unless that holds the results of another input.
pub(crate) fn output_folder(named: Option<&Path>, input: &Path) -> Result<PathBuf> {
    let out = named.map_or_else(|| default_output(input), Path::to_path_buf);
    if out.is_file() {
        bail!("{} is a file; name a folder with -o", out.display());
    }
    let former = if named.is_none() { former_run(&out)? } else { None };
    if let Some(former) = former
        && former.input != std::path::absolute(input)?
    {
        bail!(
            "{} holds the results of {}; name another folder with -o",
            out.display(),
            former.input.display()
        );
    }
    Ok(out)
}

fn default_output(input: &Path) -> PathBuf {
    let absolute = std::path::absolute(input).unwrap_or_else(|_| input.to_path_buf());
    let stem = absolute.file_stem().map_or_else(|| "scene".into(), |s| s.to_string_lossy().into_owned());
    PathBuf::from(format!("{stem}_recon"))
}

/// The output folder can be moved: what is remembered of it are relative paths.
pub(crate) fn relative_to(mut frames: FrameSet, out: &Path) -> FrameSet {
    for frame in &mut frames.frames {
        frame.path = without_prefix(&frame.path, out);
        frame.mask = frame.mask.as_deref().map(|mask| without_prefix(mask, out));
    }
    if let Some(film) = &mut frames.film {
        film.path = without_prefix(&film.path, out);
    }
    frames
}

fn without_prefix(path: &Path, prefix: &Path) -> PathBuf {
    path.strip_prefix(prefix).unwrap_or(path).to_path_buf()
}

/// The remembered frames where the output folder lies now.
pub(crate) fn absolute_in(mut frames: FrameSet, out: &Path) -> FrameSet {
    for frame in &mut frames.frames {
        frame.path = out.join(&frame.path);
        frame.mask = frame.mask.as_deref().map(|m| out.join(m));
    }
    if let Some(film) = &mut frames.film {
        film.path = out.join(&film.path);
    }
    frames
}
