//! The volume into which depth maps are fused: sparse blocks of voxels.

/// Voxels along a side of a block. Source: docs/decisions/16.
pub(super) const SIDE: i32 = 8;
/// Voxels of a block. Source: derived from [`SIDE`].
pub(super) const VOXELS: usize = (SIDE * SIDE * SIDE) as usize;

/// How depth maps are fused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusionOptions {
    /// Side of a voxel, scene units.
    pub voxel: f64,
    /// Distances are cut off here, voxels.
    pub truncation: f64,
    /// Surfaces are fused as if they lay this much nearer to the cameras, voxels, and put back.
    pub thicken: f64,
    /// A voxel counts if at least so many views saw it.
    pub least_views: u8,
    /// Most memory of the volume, bytes.
    pub most_bytes: usize,
}

/// A block of voxels.
#[derive(Clone)]
pub(super) struct FusionBlock {
    /// Place of the first voxel, in blocks.
    pub(super) at: [i32; 3],
    /// Mean distance in [-1, 1] truncations, positive outside, and its weight.
    pub(super) distance: Vec<f32>,
    pub(super) weight: Vec<f32>,
    /// How many views saw it, 255 at most.
    pub(super) views: Vec<u8>,
    /// Sums of colours, and their weight.
    pub(super) colour: Vec<[f32; 4]>,
}
