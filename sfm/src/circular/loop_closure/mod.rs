//! Where a video comes round again: by tracks, by the photometric similarity of its frames.

pub(crate) mod close;
pub(crate) mod photometric;
pub(crate) mod tracks;
