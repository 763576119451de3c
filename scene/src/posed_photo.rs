//! A photo with its camera and pose, borrowed: what surfaces are measured and painted from.

use crate::{Camera, Pose};

/// A photo without distortion, with its camera and pose.
#[derive(Clone, Copy, Debug)]
pub struct PosedPhoto<'a> {
    /// A pinhole of the photo's size.
    pub camera: &'a Camera,
    /// `cam_from_world`.
    pub pose: Pose,
    /// [height × width × 3] sRGB.
    pub rgb: &'a [u8],
    /// [height × width] white = the object; everything without one.
    pub mask: Option<&'a [u8]>,
}
