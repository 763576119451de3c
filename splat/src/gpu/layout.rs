//! Rust twins of the structs in the WGSL, field by field; a test holds them against naga's offsets.

use crate::camera::CameraConstants;
use crate::cpu::TILE;
use crate::model::GEOMETRY;
use bytemuck::{Pod, Zeroable};

/// Bits of [`Frame::flags`], as `frame.wgsl` has them.
#[derive(Clone, Copy, Debug)]
#[repr(u32)]
pub(crate) enum FrameFlag {
    /// Opacity is scaled with the low-pass.
    Antialias = 1,
    /// The target's alpha is a weight.
    Weighted = 2,
    /// The target's alpha is coverage.
    Coverage = 4,
    /// Pairs beyond the buffers are left out.
    Truncate = 8,
    /// Each pixel's state is kept where a block of pairs begins.
    Keep = 16,
}

/// Entries of the counters, as `frame.wgsl` has them.
#[derive(Clone, Copy, Debug)]
#[repr(u32)]
pub(crate) enum Counter {
    /// Gaussians that are seen.
    Visible = 0,
    /// Pairs that are needed.
    Pairs = 1,
    /// Gradients that were not finite; of a round of densification, Gaussians that hardly any view
    /// has.
    NonFinite = 2,
    /// Where totals go that nobody reads.
    Spare = 3,
    /// Not zero once a step was not taken because its pairs did not fit: later ones wait for its
    /// repetition. Every step clears the counters before this one.
    Halt = 4,
}

/// Counters. Source: the entries above, rounded up to two vectors.
pub(crate) const COUNTERS: usize = 8;

/// Gaussians or keys that a block of scan and sort holds. Source: eight a thread of `scan.wgsl`.
pub(crate) const BLOCK: u32 = 2048;
/// Pairs of a block of `rasterise_backward`, as `frame.wgsl` has them. Source: the pixels of a
/// tile, so that a block's states take as many vectors as it has pairs.
pub(crate) const SPAN: usize = 256;
/// Threads of a group. Source: the most that every adapter has (WebGPU's default limits).
pub(crate) const GROUP: u32 = 256;
/// Planes of the geometry: parameters, first and second moments, second moments of three colour
/// channels, clock, two statistics. Source: derived.
pub(crate) const PLANES: usize = STATISTICS + 2;
/// First plane of the colours' second moments. Source: derived.
pub(crate) const COLOUR_MOMENTS: usize = 3 * GEOMETRY;
/// Plane of the clock. Source: derived.
pub(crate) const CLOCK: usize = COLOUR_MOMENTS + 3;
/// First plane of the statistics. Source: derived.
pub(crate) const STATISTICS: usize = CLOCK + 1;

/// A field as the WGSL must have it: name and offset.
#[cfg(test)]
pub(crate) type Field = (&'static str, usize);

/// Declares a struct that both sides know, and the table of its fields.
macro_rules! shared_struct {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $type:ty,)* }) => {
        $(#[$doc])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
        pub(crate) struct $name { $($(#[$field_doc])* pub(crate) $field: $type,)* }

        #[cfg(test)]
        impl $name {
            /// Names and offsets of the fields.
            pub(crate) const FIELDS: &[Field] = &[$((stringify!($field), std::mem::offset_of!($name, $field)),)*];
        }
    };
}

shared_struct!(
    /// What every kernel knows of the view and the step: frame.wgsl.
    Frame {
        /// First row of R of `x_cam = R x + t`, t in w.
        row0: [f32; 4],
        /// Second row.
        row1: [f32; 4],
        /// Third row.
        row2: [f32; 4],
        /// Camera centre.
        position: [f32; 4],
        /// Background colour.
        background: [f32; 4],
        /// Targets are multiplied by this: the inverse of the view's gain.
        unit: [f32; 4],
        /// Focal lengths, pixels.
        focal: [f32; 2],
        /// Principal point, pixels.
        centre: [f32; 2],
        /// Lower limits of x/z and y/z in the Jacobian.
        low: [f32; 2],
        /// Upper limits.
        high: [f32; 2],
        /// Width and height, pixels.
        size: [u32; 2],
        /// Tiles in x and y.
        tiles: [u32; 2],
        /// Gaussians.
        n: u32,
        /// Pairs that the buffers hold.
        pair_capacity: u32,
        /// SH values held for a Gaussian.
        sh_stride: u32,
        /// SH coefficients a channel in use.
        sh_used: u32,
        /// Flags above.
        flags: u32,
        /// Near plane.
        near: f32,
        /// Weight of D-SSIM.
        lambda: f32,
        /// 1 / (3 · sum of the weights).
        inv_count: f32,
        /// Step size of the means.
        rate_mean: f32,
        /// Of the log-scales.
        rate_log_scale: f32,
        /// Of the quaternions.
        rate_rotation: f32,
        /// Of the logits.
        rate_opacity: f32,
        /// Of the SH of degree 0.
        rate_sh0: f32,
        /// Of the other SH.
        rate_sh_rest: f32,
        /// Nothing.
        spare0: u32,
        /// Nothing.
        spare1: u32,
    }
);

shared_struct!(
    /// A page of the model: projection.wgsl.
    PageJob {
        /// Number of its first Gaussian.
        first: u32,
        /// Gaussians.
        count: u32,
        /// Entries of a plane.
        stride: u32,
        /// Nothing.
        spare: u32,
    }
);

shared_struct!(
    /// A round of densification, seen from a page: densify.wgsl.
    DensifyJob {
        /// The page.
        page_first: u32,
        /// Its Gaussians.
        page_count: u32,
        /// Entries of its planes.
        page_stride: u32,
        /// Gaussians of all pages.
        n: u32,
        /// Gaussians that may be added.
        room: u32,
        /// Views that are counted.
        views: u32,
        /// Views that must have a Gaussian in their picture.
        least: u32,
        /// Of training, for the random numbers.
        iteration: u32,
        /// Of training, for the random numbers.
        seed: u32,
        /// Logit below which a Gaussian is removed.
        floor: f32,
        /// Nothing.
        spare0: u32,
        /// Nothing.
        spare1: u32,
    }
);

shared_struct!(
    /// A camera of densify.wgsl.
    DensifyView {
        /// First row of R of `x_cam = R x + t`, t in w.
        row0: [f32; 4],
        /// Second row.
        row1: [f32; 4],
        /// Third row.
        row2: [f32; 4],
        /// Focal lengths, principal point, pixels.
        lens: [f32; 4],
        /// Width and height, pixels.
        size: [f32; 4],
    }
);

shared_struct!(
    /// From a page of the old model to one of the new: gather.wgsl.
    GatherJob {
        /// The new page.
        first: u32,
        /// Its Gaussians.
        count: u32,
        /// Entries of its planes.
        stride: u32,
        /// The old page.
        old_first: u32,
        /// Its Gaussians.
        old_count: u32,
        /// Entries of its planes.
        old_stride: u32,
        /// Planes.
        planes: u32,
        /// From this plane on halves of split Gaussians begin at zero.
        clear_fresh: u32,
        /// From this plane on all do.
        clear_all: u32,
        /// Nothing.
        spare0: u32,
        /// Nothing.
        spare1: u32,
        /// Nothing.
        spare2: u32,
    }
);

shared_struct!(
    /// A page whose halves of split Gaussians take their places: halve.wgsl.
    HalveJob {
        /// The page.
        first: u32,
        /// Its Gaussians.
        count: u32,
        /// Entries of its planes.
        stride: u32,
        /// Of training, for the random numbers.
        iteration: u32,
        /// Of training, for the random numbers.
        seed: u32,
        /// Nothing.
        spare0: u32,
        /// Nothing.
        spare1: u32,
        /// Nothing.
        spare2: u32,
    }
);

shared_struct!(
    /// A prefix sum: scan.wgsl.
    ScanJob {
        /// Values.
        n: u32,
        /// Counter that the total goes to.
        total: u32,
        /// Nothing.
        spare0: u32,
        /// Nothing.
        spare1: u32,
    }
);

shared_struct!(
    /// A pass of the radix sort: sort.wgsl.
    SortJob {
        /// Lowest bit of the digit.
        shift: u32,
        /// Counter that says how many pairs there are.
        count: u32,
        /// Columns of the table.
        blocks: u32,
        /// Never more pairs than this.
        limit: u32,
        /// 1: the value of a pair is its number.
        number: u32,
        /// Nothing.
        spare0: u32,
        /// Nothing.
        spare1: u32,
        /// Nothing.
        spare2: u32,
    }
);

impl Frame {
    /// The camera's part; the rest is zero.
    pub(crate) fn of_camera(c: &CameraConstants) -> Self {
        let [row0, row1, row2] = [0, 1, 2].map(|a| [c.r[a][0], c.r[a][1], c.r[a][2], c.t[a]]);
        let size = c.size.map(|v| v as u32);
        Self {
            row0,
            row1,
            row2,
            position: c.position.extend(0.0).to_array(),
            focal: c.focal,
            centre: c.centre,
            low: c.low,
            high: c.high,
            size,
            tiles: size.map(|v| v.div_ceil(TILE as u32)),
            sh_used: (c.sh_degree + 1).pow(2),
            flags: if c.antialias { FrameFlag::Antialias as u32 } else { 0 },
            near: c.near,
            ..Self::default()
        }
    }
}
