use crate::memory::memory_note;
use std::path::PathBuf;

/// What can go wrong between an input and its frames; each says what to do about it.
#[derive(Debug, thiserror::Error)]
pub enum PreprocessError {
    /// The user asked to stop.
    #[error(transparent)]
    Cancelled(#[from] scene::Cancelled),
    /// Nothing lies at the path.
    #[error("{}: no such file or folder", .path.display())]
    NotFound {
        /// The path given.
        path: PathBuf,
    },
    /// A folder was given for a video or a file for a folder.
    #[error("{}: {found} where {expected} is needed", .path.display())]
    WrongKind {
        /// The path given.
        path: PathBuf,
        /// What lies there.
        found: &'static str,
        /// What should lie there.
        expected: &'static str,
    },
    /// Zero bytes.
    #[error("{}: the file is empty (0 bytes); copy it again from the camera", .path.display())]
    EmptyFile {
        /// The file.
        path: PathBuf,
    },
    /// The container cannot be read.
    #[error("{}: not a video that can be read ({reason}); {}if it plays elsewhere, convert it with `ffmpeg -i INPUT -c:v libx264 -crf 16 fixed.mp4`", .path.display(), memory_note())]
    NotAVideo {
        /// The file.
        path: PathBuf,
        /// The demuxer's words.
        reason: String,
    },
    /// The system failed to read a video that is there.
    #[error("{}: cannot be read whole ({reason}); try again, and if it fails again copy the file to another disk", .path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The system's words.
        reason: String,
    },
    /// A container without a picture stream.
    #[error("{}: has no video stream ({found}); give the file that holds the pictures", .path.display())]
    NoVideoStream {
        /// The file.
        path: PathBuf,
        /// What it has instead.
        found: String,
    },
    /// DRM.
    #[error("{}: the video is encrypted; give an unprotected copy", .path.display())]
    Encrypted {
        /// The file.
        path: PathBuf,
    },
    /// The stream has a header and no picture that decodes.
    #[error("{}: none of {expected} expected frames can be decoded ({reason}); {}the file is damaged or not finished: copy it again", .path.display(), memory_note())]
    NothingDecodes {
        /// The file.
        path: PathBuf,
        /// Frames that the container announces.
        expected: usize,
        /// The decoder's words.
        reason: String,
    },
    /// `--start/--end` leave nothing.
    #[error("{}: no frame between {start:.3} s and {end:.3} s; the video runs from {first:.3} s to {last:.3} s", .path.display())]
    EmptyRange {
        /// The file.
        path: PathBuf,
        /// Asked start, seconds.
        start: f64,
        /// Asked end, seconds.
        end: f64,
        /// First frame, seconds.
        first: f64,
        /// Last frame, seconds.
        last: f64,
    },
    /// A folder without a usable image.
    #[error("{}: no readable image (png, jpg, tif, webp, heic, avif){detail}", .path.display())]
    NoImages {
        /// The folder.
        path: PathBuf,
        /// What was found instead, starting with `; `, or empty.
        detail: String,
    },
    /// A mask folder from which nothing fits.
    #[error("{}: 0 of {images} images have a mask there; name masks like their image (a.png, a.jpg.png or a.mask.png) or give `--masks off`", .masks.display())]
    NoMaskMatches {
        /// The mask folder.
        masks: PathBuf,
        /// Images that looked for one.
        images: usize,
    },
    /// A setting outside its range.
    #[error("{0}")]
    Config(String),
    /// A program that is needed is not installed.
    #[error(
        "{tool} is not installed or does not start ({reason}); `apt-get install ffmpeg` or run `make setup`"
    )]
    MissingTool {
        /// Its name.
        tool: &'static str,
        /// The system's words.
        reason: String,
    },
    /// A helper program hung.
    #[error("{}: {tool} did not finish within {seconds} s and was stopped; the file is probably damaged", .path.display())]
    Timeout {
        /// Its name.
        tool: &'static str,
        /// The input.
        path: PathBuf,
        /// Time given.
        seconds: u64,
    },
    /// The operating system refused to read or write.
    #[error("{}: {source}", .path.display())]
    Io {
        /// The path.
        path: PathBuf,
        /// The system's words.
        source: std::io::Error,
    },
    /// An image cannot be decoded or encoded.
    #[error("{}: {reason}", .path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// The codec's words.
        reason: String,
    },
}

impl PreprocessError {
    /// For `map_err` on a file operation.
    pub(crate) fn io(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, source }
    }

    /// For `map_err` on a codec.
    pub(crate) fn image<E: std::fmt::Display>(path: impl Into<PathBuf>) -> impl FnOnce(E) -> Self {
        let path = path.into();
        move |e| Self::Image { path, reason: e.to_string() }
    }
}
