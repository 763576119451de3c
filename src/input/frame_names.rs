//! Frames, found by the names that a file of poses calls their photos.

use scene::{Frame, FrameSet};
use std::collections::BTreeMap;
use std::path::Path;

/// Frames by their names, with and without extension.
pub(crate) struct FrameNames<'a>(BTreeMap<String, &'a Frame>);

impl<'a> FrameNames<'a> {
    pub(crate) fn of(frames: &'a FrameSet) -> Self {
        let mut by_name = BTreeMap::new();
        for frame in &frames.frames {
            by_name.entry(stem(&frame.name)).or_insert(frame);
            by_name.insert(frame.name.clone(), frame);
        }
        Self(by_name)
    }

    /// The frame of a photo: by its name, by its path (the frame of `train/a.png` is
    /// `train_a.png`), or by its bare name, each with any extension.
    pub(crate) fn find(&self, photo: &str) -> Option<&'a Frame> {
        let path = photo.replace('/', "_");
        let bare = photo.rsplit('/').next().unwrap_or(photo);
        let names = [photo.to_owned(), stem(&path), bare.to_owned(), stem(bare)];
        names.iter().find_map(|name| self.0.get(name).copied())
    }
}

fn stem(name: &str) -> String {
    Path::new(name).with_extension("").to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photos_are_found_by_path_before_they_are_by_bare_name() {
        let frame = |name: &&str| Frame { name: (*name).to_owned(), ..Frame::default() };
        let frames = ["a.png", "train_a.png", "b.jpg"].iter().map(frame).collect();
        let frames = FrameSet { frames, ..FrameSet::default() };
        let names = FrameNames::of(&frames);
        let found = |photo| names.find(photo).map(|f| f.name.as_str());
        assert_eq!(found("train/a.png"), Some("train_a.png"));
        assert_eq!(found("images/a.jpg"), Some("a.png"));
        assert_eq!(found("images/b"), Some("b.jpg"));
        assert_eq!(found("c.png"), None);
    }
}
