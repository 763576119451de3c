//! File formats: COLMAP models and databases, `transforms.json`, PLY, images, ground truth.
//!
//! Every reader treats its file as hostile: counts are checked against the size of the file before memory is
//! reserved, numbers against NaN, names against paths that lead out of the folder. Every writer goes through
//! [`atomic`]: what exists under its final name is whole.

pub mod atomic;
mod bytes;
mod colmap_bin;
mod colmap_txt;
mod error;
mod model;
mod name;

pub use atomic::{replace_folder, write_atomic};
pub use error::IoError;
pub use model::{find_model, has_model, read_model, write_model_bin, write_model_txt};
pub use name::{UnsafeName, safe_name};

/// A fresh folder for a test.
#[cfg(test)]
pub(crate) fn test_folder(name: &str) -> std::path::PathBuf {
    let dir = std::env::temp_dir().join(format!("scene_test_{name}_{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&dir);
    std::fs::create_dir_all(&dir).expect("a temporary folder");
    dir
}
