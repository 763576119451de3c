//! Which captures a batch has, and what each is called.

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The list of captures in the output folder.
pub(super) const LIST: &str = "captures.json";
/// Endings of files that are taken for videos in a folder.
const VIDEOS: [&str; 8] = ["mp4", "mov", "mkv", "avi", "webm", "m4v", "mts", "mpg"];

/// A capture of a batch.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Capture {
    /// Name of its folder in the output folder.
    pub name: String,
    /// The video, the folder of photos or the data set; absolute.
    pub input: PathBuf,
}

/// The captures of a list (a path a line, `#` begins a comment; paths are relative to the list's
/// folder) or of a folder (its videos, and its folders of photos).
pub(super) fn captures(source: &Path) -> Result<Vec<Capture>> {
    let inputs = if source.is_dir() { of_folder(source)? } else { of_list(source)? };
    if inputs.is_empty() {
        bail!("{}: neither videos nor folders of photos were found", source.display());
    }
    Ok(named(inputs))
}

fn of_list(list: &Path) -> Result<Vec<PathBuf>> {
    let text = std::fs::read_to_string(list).with_context(|| format!("cannot read {}", list.display()))?;
    let folder = list.parent().unwrap_or(Path::new("."));
    let lines = text.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with('#'));
    lines.map(|l| std::path::absolute(folder.join(l)).with_context(|| format!("cannot use {l}"))).collect()
}

fn of_folder(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in entries(folder)? {
        let is_capture = if entry.is_dir() {
            entry.join("images").is_dir()
                || entries(&entry)?.iter().any(|f| ends_with(f, &preprocess::PHOTO_EXTENSIONS))
        } else {
            ends_with(&entry, &VIDEOS)
        };
        if is_capture {
            found.push(std::path::absolute(&entry)?);
        }
    }
    Ok(found)
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let listed = std::fs::read_dir(folder).with_context(|| format!("cannot list {}", folder.display()))?;
    let mut paths: Vec<PathBuf> = listed.flatten().map(|e| e.path()).collect();
    paths.sort();
    Ok(paths)
}

fn ends_with(path: &Path, endings: &[&str]) -> bool {
    path.extension().is_some_and(|e| endings.iter().any(|known| e.eq_ignore_ascii_case(known)))
}

/// The name of the file or folder; where several have the same, those of the folders above are put
/// before it until they differ.
fn named(inputs: Vec<PathBuf>) -> Vec<Capture> {
    let mut depth = vec![1; inputs.len()];
    loop {
        let names: Vec<String> = inputs.iter().zip(&depth).map(|(path, d)| name(path, *d)).collect();
        let mut seen: BTreeMap<String, Vec<usize>> = BTreeMap::new();
        names.iter().enumerate().for_each(|(i, n)| seen.entry(n.to_lowercase()).or_default().push(i));
        let twice: Vec<usize> = seen.into_values().filter(|same| same.len() > 1).flatten().collect();
        let deeper: Vec<usize> =
            twice.into_iter().filter(|&i| depth[i] < inputs[i].components().count()).collect();
        if deeper.is_empty() {
            let numbered = names.into_iter().zip(inputs).enumerate();
            let mut used = std::collections::BTreeSet::new();
            return numbered
                .map(|(i, (name, input))| {
                    // The same path twice is told apart by its place in the list.
                    let own = used.insert(name.to_lowercase());
                    Capture { name: if own { name } else { format!("{name}_{}", i + 1) }, input }
                })
                .collect();
        }
        deeper.into_iter().for_each(|i| depth[i] += 1);
    }
}

/// The last so many parts of a path, without ending, joined by `_`.
fn name(path: &Path, parts: usize) -> String {
    let plain = path.with_extension("");
    let all: Vec<String> = plain
        .components()
        .filter(|c| matches!(c, std::path::Component::Normal(_)))
        .map(|c| c.as_os_str().to_string_lossy().replace(char::is_whitespace, "_"))
        .collect();
    let kept = all[all.len().saturating_sub(parts)..].join("_");
    if kept.starts_with('.') || kept.is_empty() { format!("capture{kept}") } else { kept }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn captures_of_one_name_are_told_apart_by_their_folders() {
        let paths = ["/d/a/video.mp4", "/d/b/video.mp4", "/d/other.mov", "/d/b/video.mp4"];
        let all = named(paths.map(PathBuf::from).to_vec());
        let names: Vec<&str> = all.iter().map(|c| &*c.name).collect();
        assert_eq!(names, ["a_video", "d_b_video", "other", "d_b_video_4"]);
    }

    #[test]
    fn a_folder_has_its_videos_and_its_folders_of_photos() {
        let dir = std::env::temp_dir().join(format!("sat-recon-batch-list-{}", std::process::id()));
        for folder in ["photos", "set/images", "notes"] {
            std::fs::create_dir_all(dir.join(folder)).unwrap();
        }
        for file in ["b.MP4", "photos/1.jpg", "notes/a.txt", "readme.md"] {
            std::fs::write(dir.join(file), "").unwrap();
        }
        let names = |source: &Path| captures(source).unwrap().into_iter().map(|c| c.name).collect::<Vec<_>>();
        assert_eq!(names(&dir), ["b", "photos", "set"]);
        std::fs::write(dir.join("list.txt"), "# two\nb.MP4\n\n  photos\n").unwrap();
        assert_eq!(names(&dir.join("list.txt")), ["b", "photos"]);
        std::fs::write(dir.join("list.txt"), "# none\n").unwrap();
        assert!(captures(&dir.join("list.txt")).is_err());
        std::fs::remove_dir_all(dir).unwrap();
    }
}
