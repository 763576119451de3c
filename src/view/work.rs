//! Frames and mattes of a run, also while their stage writes them.

use scene::{FrameSet, Reconstruction};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Where frames and masks lie while their stage works, before it is committed, and after. Source:
/// `preprocess` fills the first, the stage renames it into the second and that into the third.
const FOLDERS: [&str; 3] = [".stages/frames.new/.frames.tmp", ".stages/frames.new", "."];

/// A frame, and its mask where it has one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Work {
    pub(super) image: PathBuf,
    pub(super) mask: Option<PathBuf>,
}

/// The frames of a run: names in the order in which they appeared, or those that were chosen.
#[derive(Clone, Debug, Default)]
pub(super) struct Works {
    names: Vec<String>,
    chosen: Option<Vec<Work>>,
}

impl Works {
    /// The frames that were chosen.
    pub(super) fn choose(&mut self, frames: &FrameSet) {
        self.names = frames.frames.iter().map(|f| f.name.clone()).collect();
        let work = frames.frames.iter().map(|f| Work { image: f.path.clone(), mask: f.mask.clone() });
        self.chosen = Some(work.collect());
    }

    /// Looks for new frames; says whether earlier ones have other numbers now.
    pub(super) fn look(&mut self, folder: &Path) -> bool {
        if self.chosen.is_some() {
            return false;
        }
        // Those of an earlier run lie in the last folder until the stage puts new ones there.
        let found =
            FOLDERS[..2].iter().map(|f| files(&folder.join(f).join("images"))).find(|f| !f.is_empty());
        let found = found.unwrap_or_default();
        let is_new_start = self.names.iter().any(|name| !found.contains(name)) && !found.is_empty();
        if is_new_start {
            self.names.clear();
        }
        let new: Vec<String> = found.into_iter().filter(|name| !self.names.contains(name)).collect();
        self.names.extend(new);
        is_new_start
    }

    /// The number of a frame.
    pub(super) fn number_of(&self, name: &str) -> Option<usize> {
        self.names.iter().position(|n| n == name)
    }

    /// How many frames there are.
    pub(super) fn len(&self) -> usize {
        self.names.len()
    }

    /// How many mattes there are.
    pub(super) fn mattes(&self, folder: &Path) -> usize {
        match &self.chosen {
            Some(chosen) => chosen.iter().filter(|work| work.mask.is_some()).count(),
            None => {
                let found = FOLDERS[..2].iter().map(|f| files(&folder.join(f).join("masks")).len());
                found.max().unwrap_or(0)
            }
        }
    }

    /// A frame by its number.
    pub(super) fn at(&self, folder: &Path, index: usize) -> Option<Work> {
        if let Some(chosen) = &self.chosen {
            return chosen.get(index).cloned();
        }
        let name = scene::io::safe_name(self.names.get(index)?).ok()?;
        let find = |kind: &str, name: &str| {
            FOLDERS.iter().find_map(|f| super::inside(folder, &format!("{f}/{kind}/{name}")))
        };
        let mask = Path::new(name).with_extension("png");
        Some(Work { image: find("images", name)?, mask: find("masks", &mask.to_string_lossy()) })
    }

    /// Names the images of an interim model.
    pub(super) fn name(&self, model: &mut Reconstruction) {
        for image in model.images.values_mut().filter(|i| i.name.is_empty()) {
            let name = (image.id as usize).checked_sub(1).and_then(|i| self.names.get(i));
            image.name = name.cloned().unwrap_or_else(|| image.id.to_string());
        }
    }
}

/// Names of the files of a folder, in order.
fn files(folder: &Path) -> BTreeSet<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    names.filter(|name| !name.starts_with('.')).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_keep_their_numbers_while_others_appear_and_their_folder_moves() {
        let dir = std::env::temp_dir().join(format!("sat-recon-work-{}", std::process::id()));
        let staging = dir.join(FOLDERS[0]);
        std::fs::create_dir_all(staging.join("images")).unwrap();
        std::fs::create_dir_all(staging.join("masks")).unwrap();
        let mut works = Works::default();
        for name in ["b.png", "a.png"] {
            std::fs::write(staging.join("images").join(name), name).unwrap();
            assert!(!works.look(&dir));
        }
        std::fs::write(staging.join("masks/b.png"), "").unwrap();
        assert_eq!((works.len(), works.mattes(&dir)), (2, 1));
        let b = works.at(&dir, 0).unwrap();
        assert_eq!((std::fs::read(&b.image).unwrap(), b.mask.is_some()), (b"b.png".to_vec(), true));
        std::fs::rename(staging.join("images"), dir.join(".stages/frames.new/images")).unwrap();
        assert!(!works.look(&dir) && works.at(&dir, 1).unwrap().mask.is_none());
        assert_eq!(works.at(&dir, 2), None);
        std::fs::remove_dir_all(dir).unwrap();
    }
}
