//! File formats: COLMAP models and databases, `transforms.json`, poses of other programs, PLY,
//! images, ground truth.
//!
//! Every reader treats its file as hostile: counts are checked against the size of the file before
//! memory is reserved, numbers against NaN, names against paths that lead out of the folder. Every
//! writer goes through [`atomic`]: what exists under its final name is whole.

pub mod atomic;
mod attitude;
mod bytes;
mod colmap_bin;
pub mod colmap_db;
mod colmap_txt;
mod error;
pub mod exif;
mod gltf_builder;
pub mod heif;
mod limits;
pub mod load;
mod mesh;
mod mesh_out;
mod model;
mod moving_glb;
mod name;
pub mod ply;
pub mod poses;
pub mod splats;
mod tiff_directory;
pub mod transforms;
pub mod truth;

pub use atomic::{replace_folder, write_atomic};
pub use attitude::XmpCamera;
#[cfg(feature = "colmap-db")]
pub use colmap_db::{read_database, write_database};
pub use error::IoError;
pub(crate) use error::read_file;
pub use load::{
    ImageInfo, LoadedImage, image_decoder, image_info, load_image, load_mask, load_rgb, resize_area, shrunk,
};
pub use mesh::{parse_mesh, read_mesh};
pub use mesh_out::{write_mesh, write_textured_mesh};
pub use model::{
    find_model, has_model, parse_model_bin, parse_model_txt, read_model, write_model_bin, write_model_txt,
};
pub use moving_glb::{Hinge, MovingMesh, write_moving_glb};
pub use name::{UnsafeName, safe_name};
pub use ply::{
    CloudPoint, parse_points_ply, read_points_ply, read_splat_ply, write_points_ply, write_splat_ply,
};
pub use poses::{ImportedPoses, find_poses, is_poses_file, listed_images, read_poses, write_metashape};
pub use splats::{SplatFormat, parse_splat, read_splat, write_splat};
pub use transforms::{
    TransformsFile, TransformsFrame, TransformsOptions, WORLD_FROM_TRANSFORMS, read_transforms,
    write_transforms,
};
pub use truth::{parse_middlebury, read_truth};

/// A fresh folder for a test.
#[cfg(test)]
pub(crate) fn test_folder(name: &str) -> std::path::PathBuf {
    let dir = std::env::temp_dir().join(format!("scene_test_{name}_{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&dir);
    std::fs::create_dir_all(&dir).expect("a temporary folder");
    dir
}
