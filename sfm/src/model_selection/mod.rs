//! Which of several models the evidence supports: camera model, principal point, shared cameras,
//! rotated images.

pub mod camera;
pub(crate) mod evidence;
pub mod noise;
pub(crate) mod principal_point;
pub mod rotated_images;
pub(crate) mod shared_cameras;
