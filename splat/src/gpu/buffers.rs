//! What lies on the device beside the model (`pages`): the view's intermediate results, the picture
//! and its target.

use super::context::Gpu;
use super::layout::{BLOCK, COUNTERS, Frame, SPAN};
use super::pages;
use crate::cpu::TILE;
use crate::error::SplatError;

/// Bytes of a job of scan or sort in the buffer of jobs: the strictest alignment of uniforms.
/// Source: WebGPU.
pub(crate) const JOB: u64 = 256;
/// Jobs: four scans, eight passes by depth, eight by tile. Source: derived.
pub(crate) const JOBS: u64 = 20;
/// Bytes that a step reports: counters, the loss's sums. Source: derived.
pub(crate) const REPORT: u64 = 4 * COUNTERS as u64 + 48;

/// Sizes that the buffers must have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Sizes {
    /// Gaussians.
    pub(crate) room: usize,
    /// Gaussian-tile pairs.
    pub(crate) pairs: usize,
    /// Pixels.
    pub(crate) pixels: usize,
    /// Tiles.
    pub(crate) tiles: usize,
    /// Whether a step will be taken: moments, targets and gradients are needed.
    pub(crate) training: bool,
}

impl Sizes {
    /// Whether buffers of these sizes serve a view that needs `other`.
    pub(crate) fn hold(&self, other: &Self) -> bool {
        self.room >= other.room
            && self.pairs >= other.pairs
            && self.pixels >= other.pixels
            && self.tiles >= other.tiles
            && self.training >= other.training
    }
}

/// Blocks of scan and sort for `n` values.
pub(crate) fn blocks(n: usize) -> u32 {
    (n.max(1) as u32).div_ceil(BLOCK)
}

/// Tiles of an image.
pub(crate) fn tiles(width: usize, height: usize) -> usize {
    width.div_ceil(TILE) * height.div_ceil(TILE)
}

/// Declares the buffers: name, and words of four bytes as a function of the sizes.
macro_rules! buffers {
    ($sizes:ident, $($(#[$doc:meta])* $name:ident: $words:expr,)*) => {
        /// The buffers by their names in the WGSL.
        pub(crate) struct Buffers { $($(#[$doc])* pub(crate) $name: wgpu::Buffer,)* }

        impl Buffers {
            /// Bytes of each buffer at these sizes.
            pub(crate) fn plan($sizes: &Sizes) -> Vec<(&'static str, u64)> {
                vec![$((stringify!($name), 4 * ($words) as u64),)*]
            }

            /// Allocates all of them; those of the same size as in `old` are taken over.
            pub(crate) fn new(gpu: &Gpu, $sizes: &Sizes, old: Option<Self>) -> Result<Self, SplatError> {
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
    /// \[N\]\[2\] vec4.
    records: s.room.max(1) * 8,
    /// \[N\] vec4.
    colours: s.room.max(1) * 4,
    /// \[N\] vec2.
    boxes: s.room.max(1) * 2,
    /// \[N\] flags, then positions.
    flags: s.room.max(1),
    /// \[N\].
    depth_keys_a: s.room.max(1),
    /// \[N\].
    depth_keys_b: s.room.max(1),
    /// \[N\].
    order_a: s.room.max(1),
    /// \[N\].
    order_b: s.room.max(1),
    /// \[N\] tiles of the Gaussian of each rank, then where its pairs begin.
    counts: s.room.max(1),
    /// \[N\] vec2.
    spans: s.room.max(1) * 2,
    /// Sums of blocks within a scan.
    block_sums: blocks(16 * blocks(s.room.max(s.pairs)) as usize).max(blocks(s.room)) as usize,
    /// [16][blocks].
    table: 16 * blocks(s.room.max(s.pairs)) as usize,
    /// \[pairs\].
    tile_keys_a: s.pairs,
    /// \[pairs\].
    tile_keys_b: s.pairs,
    /// \[pairs\].
    pairs_a: s.pairs,
    /// \[pairs\].
    pairs_b: s.pairs,
    /// \[pairs\].
    owners: s.pairs,
    /// \[pairs\] vec2.
    sorted: 2 * s.pairs,
    /// \[pairs\] vec4.
    sums_a: if s.training { 4 * s.pairs } else { 4 },
    /// \[pairs\] vec4.
    sums_b: if s.training { 4 * s.pairs } else { 4 },
    /// \[pairs\] vec2.
    sums_c: if s.training { 2 * s.pairs } else { 4 },
    /// [tiles + 1] vec4, then \[blocks of pairs\] vec4.
    ranges: 4 * (s.tiles + 1 + s.pairs.div_ceil(SPAN)),
    /// [H × W] vec4, then [blocks of pairs][256 pixels] vec4: their states where the block begins.
    image: 4 * (s.pixels + if s.training { s.pairs.next_multiple_of(SPAN) } else { 0 }),
    /// [H × W].
    depth: s.pixels,
    /// [H × W] rgba, 8 bits each.
    goal: if s.training { s.pixels } else { 1 },
    /// [3][H × W].
    by_mean: if s.training { 3 * s.pixels } else { 1 },
    /// [3][H × W].
    by_square: if s.training { 3 * s.pixels } else { 1 },
    /// [3][H × W].
    by_product: if s.training { 3 * s.pixels } else { 1 },
    /// [3 tiles] vec4.
    partial: if s.training { 12 * s.tiles } else { 4 },
    /// \[3\] vec4.
    result: 12,
);

/// Bytes of a pair in the largest buffer of pairs. Source: a vector of four.
const PAIR: u64 = 16;

/// The most pairs that buffers of `largest` bytes hold beside a picture's pixels: whole blocks.
pub(crate) fn most_pairs(largest: u64, pixels: usize) -> usize {
    let most = (largest / PAIR).saturating_sub(pixels as u64).min(u64::from(u32::MAX / 2)) as usize;
    (most / BLOCK as usize * BLOCK as usize).max(BLOCK as usize)
}

/// What keeps a model from being larger.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Limit {
    /// The largest buffer.
    Binding,
    /// The memory that may be used.
    Memory,
}

/// Tiles that a Gaussian touches, reckoned generously: room for its pairs. Where there is less, the
/// farthest are not drawn. Source: chosen by hand, never measured.
const PAIRS_EACH: usize = 8;
/// Part of the memory that photos may stay in; where they do not fit they are sent anew in
/// every step. Source: chosen by hand, never measured.
pub(crate) const PHOTOS: f64 = 0.25;

/// What keeps a model of `n` Gaussians from being trained, if anything does; see [`capacity`].
fn limit_of(n: usize, sh_stride: usize, pixels: usize, largest: u64, memory: Option<u64>) -> Option<Limit> {
    let sizes = Sizes {
        room: n,
        pairs: (PAIRS_EACH * n).clamp(BLOCK as usize, most_pairs(largest, pixels)),
        pixels,
        tiles: pixels.div_ceil(128),
        training: true,
    };
    let plan = Buffers::plan(&sizes);
    if plan.iter().any(|b| b.1 > largest) {
        return Some(Limit::Binding);
    }
    let each = pages::bytes_each(sh_stride, true) + pages::bytes_twice(sh_stride);
    let total = plan.iter().map(|b| b.1).sum::<u64>() + each * n as u64;
    memory.filter(|&m| total as f64 > m as f64 * (1.0 - PHOTOS)).map(|_| Limit::Memory)
}

/// The most Gaussians that can be trained on pictures of so many pixels, where no buffer may have
/// more than `largest` bytes and all of them together no more than `memory`; and which of the two
/// it is.
pub(crate) fn capacity(sh_stride: usize, pixels: usize, largest: u64, memory: Option<u64>) -> (usize, Limit) {
    // The greatest n that fits lies in low .. high.
    let (mut low, mut high, mut limit) = (0usize, 1usize << 27, Limit::Binding);
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        match limit_of(middle, sh_stride, pixels, largest, memory) {
            None => low = middle,
            Some(reason) => (high, limit) = (middle, reason),
        }
    }
    (low, limit)
}
