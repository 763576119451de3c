//! The steps from features to a model.

pub(super) mod constant_step;
pub(super) mod densify;
pub(super) mod features;
pub(super) mod mapping;
pub(super) mod matching;
pub(super) mod plane_tracks;
pub(super) mod rotation;
pub(super) mod shared_cameras;
pub(super) mod subpixel;
