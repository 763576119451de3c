//! Rust twins of the structs in the WGSL, field by field; a test holds them against naga's offsets.

use crate::cpu::project::CameraConstants;
use bytemuck::{Pod, Zeroable};

/// Opacity is scaled with the low-pass.
pub const ANTIALIAS: u32 = 1;
/// The target's alpha is a weight.
pub const WEIGHTED: u32 = 2;
/// The target's alpha is coverage.
pub const COVERAGE: u32 = 4;
/// Gradients are written in place of moving parameters.
pub const PLAIN_GRADIENT: u32 = 8;
/// Statistics sum |dL/dxy| over pixels.
pub const MAGNITUDES: u32 = 16;

/// Entries of the counters: Gaussians seen, pairs needed, gradients that are not finite, sums nobody reads.
pub const COUNTERS: usize = 4;
/// Counter of the Gaussians that are seen.
pub const VISIBLE: u32 = 0;
/// Counter of the pairs that are needed.
pub const PAIRS: u32 = 1;
/// Counter of gradients that were not finite.
pub const NON_FINITE: u32 = 2;
/// Where totals go that nobody reads.
pub const SPARE: u32 = 3;

/// Gaussians or keys a block of scan and sort holds.
pub const BLOCK: u32 = 2048;
/// Threads of a group.
pub const GROUP: u32 = 256;
/// Side of a tile, pixels.
pub const TILE: u32 = 16;
/// Sums of backward for a pair.
pub const SUMS: u32 = 12;
/// Planes of the geometry: parameters, first and second moments, clock.
pub const PLANES: u32 = 34;
/// Plane of the clock.
pub const CLOCK: usize = 33;
/// Planes of the statistics.
pub const STATISTICS: u32 = 4;

/// A field as the WGSL must have it: name and offset.
pub type Field = (&'static str, usize);

/// Declares a struct that both sides know, and the table of its fields.
macro_rules! shared_struct {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $type:ty,)* }) => {
        $(#[$doc])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
        pub struct $name { $($(#[$field_doc])* pub $field: $type,)* }

        impl $name {
            /// Names and offsets of the fields.
            pub const FIELDS: &[Field] = &[$((stringify!($field), std::mem::offset_of!($name, $field)),)*];
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
        /// Entries of a plane of parameters.
        stride: u32,
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
        /// See [`crate::backend::StepInput`].
        opacity_penalty: f32,
        /// See [`crate::backend::StepInput`].
        scale_penalty: f32,
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
    pub fn of_camera(c: &CameraConstants) -> Self {
        let row = |a: usize| [c.r[a][0], c.r[a][1], c.r[a][2], c.t[a]];
        let size = c.size.map(|v| v as u32);
        Self {
            row0: row(0),
            row1: row(1),
            row2: row(2),
            position: c.position.extend(0.0).to_array(),
            focal: c.focal,
            centre: c.centre,
            low: c.low,
            high: c.high,
            size,
            tiles: size.map(|v| v.div_ceil(TILE)),
            sh_used: (c.sh_degree + 1).pow(2),
            flags: if c.antialias { ANTIALIAS } else { 0 },
            near: c.near,
            ..Self::default()
        }
    }
}
