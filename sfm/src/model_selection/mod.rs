//! Which of several models the evidence supports: camera model, principal point, shared cameras,
//! rotated images.

pub(crate) mod accept;
pub(crate) mod camera;
pub(crate) mod evidence;
pub(crate) mod noise;
pub(crate) mod principal_point;
pub(crate) mod rotated_images;
pub(crate) mod shared_cameras;
