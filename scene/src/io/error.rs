//! What can go wrong with a file.

use super::name::UnsafeName;
use std::path::{Path, PathBuf};

/// A file that cannot be read or written: which one, what was expected and found, what to do.
#[derive(Debug, thiserror::Error)]
pub enum IoError {
    /// The operating system refused.
    #[error("cannot {action} {}: {source}", path.display())]
    File {
        /// "read", "write", …
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file ends before what it announces.
    #[error(
        "{}: damaged or cut off: {what} needs {needed} bytes where {left} are left; copy or export the file again",
        path.display()
    )]
    Truncated {
        /// The file.
        path: PathBuf,
        /// What was being read.
        what: String,
        /// Bytes it needs (saturated).
        needed: u64,
        /// Bytes there are.
        left: u64,
    },
    /// The content is not what the format says.
    #[error("{}: {message}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What was expected, what was found, what to do.
        message: String,
    },
    /// A camera model that is not handled.
    #[error(
        "{}: camera model {model} is not supported (SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL and OPENCV are); \
         undistort the images first, for instance with `colmap image_undistorter`",
        path.display()
    )]
    UnsupportedCamera {
        /// The file.
        path: PathBuf,
        /// Its name or number.
        model: String,
    },
    /// A name that would lead out of the folder.
    #[error("{}: {source}", path.display())]
    Name {
        /// The file that holds the name.
        path: PathBuf,
        /// The name and what is wrong with it.
        source: UnsafeName,
    },
    /// A number that is NaN or infinite.
    #[error("{}: {what} is not finite; the file is damaged or comes from a failed run", path.display())]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// Which number of which item.
        what: String,
    },
    /// An image that cannot be decoded.
    #[error("{}: not a readable image: {message}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// What the decoder said, what to do.
        message: String,
    },
}

impl IoError {
    /// Wraps an operating-system error: `.map_err(IoError::file("read", path))`.
    pub fn file(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self + use<> {
        let path = path.to_path_buf();
        move |source| Self::File { action, path, source }
    }

    /// The content is not what the format says.
    pub fn format(path: &Path, message: impl Into<String>) -> Self {
        Self::Format { path: path.to_path_buf(), message: message.into() }
    }

    pub(crate) fn not_finite(path: &Path, what: impl Into<String>) -> Self {
        Self::NotFinite { path: path.to_path_buf(), what: what.into() }
    }

    pub(crate) fn name(path: &Path) -> impl FnOnce(UnsafeName) -> Self + use<> {
        let path = path.to_path_buf();
        move |source| Self::Name { path, source }
    }
}

/// The whole file in memory.
pub(crate) fn read_file(path: &Path) -> Result<Vec<u8>, IoError> {
    std::fs::read(path).map_err(IoError::file("read", path))
}

/// The whole file as text.
pub(crate) fn read_text(path: &Path) -> Result<String, IoError> {
    String::from_utf8(read_file(path)?)
        .map_err(|_| IoError::format(path, "expected UTF-8 text, found other bytes"))
}
