//! What lies on the device: the model, the view's intermediate results, the picture and its target.

use super::context::Gpu;
use super::layout::{BLOCK, COUNTERS, Frame, PLANES, STATISTICS, SUMS, TILE};
use crate::SplatError;
use crate::model::padded;

/// Bytes of a job of scan or sort in the buffer of jobs: the strictest alignment of uniforms.
pub const JOB: u64 = 256;
/// Jobs: four scans, eight passes by depth, eight by tile.
pub const JOBS: u64 = 20;
/// Bytes that a step reads back: counters, the loss's sums.
pub const REPORT: u64 = 4 * COUNTERS as u64 + 16;

/// Sizes that the buffers must have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sizes {
    /// Gaussians.
    pub n: usize,
    /// SH values of a Gaussian.
    pub sh_stride: usize,
    /// Gaussian-tile pairs.
    pub pairs: usize,
    /// Pixels.
    pub pixels: usize,
    /// Tiles.
    pub tiles: usize,
    /// Whether a step will be taken: moments, targets and gradients are needed.
    pub training: bool,
}

impl Sizes {
    /// Whether buffers of these sizes serve a view that needs `other`.
    pub fn hold(&self, other: &Self) -> bool {
        (self.n, self.sh_stride) == (other.n, other.sh_stride)
            && self.pairs >= other.pairs
            && self.pixels >= other.pixels
            && self.tiles >= other.tiles
            && self.training >= other.training
    }
}

/// Blocks of scan and sort for `n` values.
pub fn blocks(n: usize) -> u32 {
    (n.max(1) as u32).div_ceil(BLOCK)
}

/// Tiles of an image.
pub fn tiles(width: usize, height: usize) -> usize {
    width.div_ceil(TILE as usize) * height.div_ceil(TILE as usize)
}

/// Declares the buffers: name, and words of four bytes as a function of the sizes.
macro_rules! buffers {
    ($sizes:ident, $($(#[$doc:meta])* $name:ident: $words:expr,)*) => {
        /// The buffers by their names in the WGSL.
        pub struct Buffers { $($(#[$doc])* pub $name: wgpu::Buffer,)* }

        impl Buffers {
            /// Bytes of each buffer at these sizes.
            pub fn plan($sizes: &Sizes) -> Vec<(&'static str, u64)> {
                vec![$((stringify!($name), 4 * ($words) as u64),)*]
            }

            /// Allocates all of them; those of the same size as in `old` are taken over.
            pub fn new(gpu: &Gpu, $sizes: &Sizes, old: Option<Self>) -> Result<Self, SplatError> {
                $(let $name = old.as_ref().map(|o| o.$name.clone());)*
                drop(old);
                Ok(Self { $($name: gpu.buffer(stringify!($name), 4 * ($words) as u64, $name)?,)* })
            }
        }
    };
}

buffers!(
    s,
    /// The view and the step.
    frame: size_of::<Frame>() / 4,
    /// Jobs of scan and sort, `JOB` bytes apart.
    jobs: (JOB * JOBS / 4) as usize,
    /// [`COUNTERS`] numbers.
    counters: COUNTERS,
    /// [34][stride].
    geometry: (if s.training { PLANES as usize } else { 11 }) * padded(s.n.max(1)),
    /// [N][sh_stride].
    sh: s.n.max(1) * s.sh_stride.max(3),
    /// [N][2][sh_stride].
    sh_moments: if s.training { s.n.max(1) * 2 * s.sh_stride.max(3) } else { 1 },
    /// [4][stride].
    statistics: if s.training { STATISTICS as usize * padded(s.n.max(1)) } else { 1 },
    /// [N][3] vec4.
    records: s.n.max(1) * 12,
    /// [N] vec2.
    boxes: s.n.max(1) * 2,
    /// [N] flags, then positions.
    flags: s.n.max(1),
    /// [N].
    depth_keys_a: s.n.max(1),
    /// [N].
    depth_keys_b: s.n.max(1),
    /// [N].
    order_a: s.n.max(1),
    /// [N].
    order_b: s.n.max(1),
    /// [N] tiles of the Gaussian of each rank, then where its pairs begin.
    counts: s.n.max(1),
    /// [N] vec2.
    spans: s.n.max(1) * 2,
    /// Sums of blocks within a scan.
    block_sums: blocks(16 * blocks(s.n.max(s.pairs)) as usize).max(blocks(s.n)) as usize,
    /// [16][blocks].
    table: 16 * blocks(s.n.max(s.pairs)) as usize,
    /// [pairs].
    tile_keys_a: s.pairs,
    /// [pairs].
    tile_keys_b: s.pairs,
    /// [pairs].
    pairs_a: s.pairs,
    /// [pairs].
    pairs_b: s.pairs,
    /// [pairs].
    owners: s.pairs,
    /// [pairs][12].
    sums: if s.training { s.pairs * SUMS as usize } else { 1 },
    /// [tiles + 1] vec2.
    ranges: 2 * (s.tiles + 1),
    /// [tiles + 1].
    used: s.tiles + 1,
    /// [H × W] vec4.
    image: s.pixels * 4,
    /// [H × W].
    depth: s.pixels,
    /// [H × W] rgba, 8 bits each.
    goal: if s.training { s.pixels } else { 1 },
    /// [9][H × W].
    maps: if s.training { 9 * s.pixels } else { 1 },
    /// [3][H × W].
    gradient: if s.training { 3 * s.pixels } else { 1 },
    /// [3 tiles] vec4.
    partial: if s.training { 12 * s.tiles } else { 4 },
    /// vec4.
    result: 4,
);

/// What keeps a model from being larger.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limit {
    /// The largest buffer.
    Binding,
    /// The memory that may be used.
    Memory,
}

/// Tiles that a Gaussian touches, reckoned generously: room for its pairs.
const PAIRS_EACH: usize = 8;

/// The most Gaussians that can be trained on pictures of so many pixels, where no buffer may have more than `largest` bytes
/// and all of them together no more than `memory`; and which of the two it is.
pub fn capacity(sh_stride: usize, pixels: usize, largest: u64, memory: Option<u64>) -> (usize, Limit) {
    let fits = |n: usize| -> Option<Limit> {
        let sizes = Sizes {
            n,
            sh_stride,
            pairs: PAIRS_EACH * n,
            pixels,
            tiles: pixels.div_ceil(128),
            training: true,
        };
        let plan = Buffers::plan(&sizes);
        if plan.iter().any(|b| b.1 > largest) {
            return Some(Limit::Binding);
        }
        let total: u64 = plan.iter().map(|b| b.1).sum();
        memory.filter(|&m| total > m).map(|_| Limit::Memory)
    };
    // The greatest n that fits lies in low .. high.
    let (mut low, mut high, mut limit) = (0usize, 1usize << 27, Limit::Binding);
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        match fits(middle) {
            None => low = middle,
            Some(reason) => (high, limit) = (middle, reason),
        }
    }
    (low, limit)
}
