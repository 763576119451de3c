//! Where a video comes round again: by tracks, by the photometric similarity of its frames.

pub(crate) mod close;
pub(crate) mod photometric;
pub(crate) mod tracks;

/// Views of an object that are turned by more than this have little in common, radians.
/// Source: decision 0019, frames within half a radian see the same.
const COMPARABLE: f64 = 0.5;
/// Fewest points of a frame, or pairs of pictures, that say something of a closed turn.
/// Source: chosen by hand, never measured.
const LEAST: usize = 6;
