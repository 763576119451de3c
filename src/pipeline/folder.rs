//! The output folder: its name, and what is remembered of the files in it.

use crate::config::former_run;
use anyhow::{Result, bail};
use scene::FrameSet;
use std::path::{Path, PathBuf};

/// The output folder: the one that was named, or the input's name with `_recon` in the current
/// folder; where that holds the results of another input, the folder of the input comes before it.
pub(crate) fn output_folder(named: Option<&Path>, input: &Path) -> Result<PathBuf> {
    let input = std::path::absolute(input)?;
    let out = match named {
        Some(named) => named.to_path_buf(),
        None => free_output(&input)?,
    };
    if out.is_file() {
        bail!("{} is a file; name a folder with -o", out.display());
    }
    Ok(out)
}

/// The first of the names of an output folder that holds nothing, or results of this input.
fn free_output(input: &Path) -> Result<PathBuf> {
    let mut taken = Vec::new();
    for name in default_names(input) {
        match former_run(&name)? {
            Some(former) if former.input != input => {
                taken.push(format!("{} holds the results of {}", name.display(), former.input.display()));
            }
            _ => return Ok(name),
        }
    }
    bail!("{}; name another folder with -o", taken.join(", "))
}

/// `video_recon`, then `a_video_recon` for `a/video.mp4`.
fn default_names(input: &Path) -> Vec<PathBuf> {
    let text = |part: Option<&std::ffi::OsStr>| part.map(|s| s.to_string_lossy().into_owned());
    let stem = text(input.file_stem()).unwrap_or_else(|| "scene".into());
    let parent = text(input.parent().and_then(Path::file_name));
    let longer = parent.map(|parent| format!("{parent}_{stem}_recon"));
    std::iter::once(format!("{stem}_recon")).chain(longer).map(PathBuf::from).collect()
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
