//! A keypoint that may stay.

use scene::Keypoint;

/// A keypoint in the samples of its octave and level, with what selection needs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub keypoint: Keypoint,
    pub strength: f32,
    pub octave: u32,
    pub level: u32,
    pub x: f32,
    pub y: f32,
    pub sigma: f32,
}
