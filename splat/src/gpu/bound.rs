//! Which kernel sees which buffers, and the commands of a step.

use super::buffers::{Buffers, JOB, JOBS, Sizes, blocks};
use super::context::Gpu;
use super::kernels::{Kernels, Module};
use super::layout::{BLOCK, Counter, GROUP, SPAN, ScanJob, SortJob};
use super::pages::Pages;
use std::ops::RangeInclusive;

/// The most passes of a sort: keys of 32 bits, four at a time. Source: derived.
pub(super) const SORT_PASSES: usize = 8;

/// What a step consists of, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Stage {
    /// Gaussians to the screen.
    Project,
    /// By depth, then by tile.
    Sort,
    /// Pixels.
    Forward,
    /// Sums that gains are found by; only after Forward, in place of what follows.
    Products,
    /// Loss and its gradient, which takes the picture's place.
    Loss,
    /// Pixels to pairs.
    Backward,
    /// Pairs to Gaussians, which move.
    Optimise,
}

impl Stage {
    /// All of them.
    pub(crate) const ALL: [Self; 7] = [
        Self::Project,
        Self::Sort,
        Self::Forward,
        Self::Products,
        Self::Loss,
        Self::Backward,
        Self::Optimise,
    ];

    /// Its place in a step; products are where the loss would be.
    pub(crate) fn number(self) -> u32 {
        match self {
            Self::Project => 0,
            Self::Sort => 1,
            Self::Forward => 2,
            Self::Products | Self::Loss => 3,
            Self::Backward => 4,
            Self::Optimise => 5,
        }
    }

    /// What is run of a range.
    pub(crate) fn of(range: &RangeInclusive<Self>) -> impl Iterator<Item = Self> + use<> {
        let (first, last) = (*range.start(), *range.end());
        Self::ALL
            .into_iter()
            .filter(move |s| (first..=last).contains(s) && (*s != Self::Products || last == *s))
    }
}

/// The bind groups; valid as long as the buffers are.
pub(crate) struct Bound {
    /// By page: project, optimise, and for how many Gaussians.
    pages: Vec<(wgpu::BindGroup, Option<wgpu::BindGroup>, u32)>,
    scan_flags: wgpu::BindGroup,
    scan_counts: wgpu::BindGroup,
    scan_depth_table: wgpu::BindGroup,
    scan_tile_table: wgpu::BindGroup,
    compact: wgpu::BindGroup,
    pub(super) by_depth: Vec<wgpu::BindGroup>,
    by_tile: Vec<wgpu::BindGroup>,
    pairs: wgpu::BindGroup,
    ranges: wgpu::BindGroup,
    rasterise: wgpu::BindGroup,
    training: Option<[wgpu::BindGroup; 2]>,
    /// Gaussians, and room for pairs.
    n: u32,
    pairs_room: u32,
}

/// Places jobs in the buffer of jobs.
struct Jobs<'a> {
    gpu: &'a Gpu,
    buffer: &'a wgpu::Buffer,
    next: u64,
}

impl<'a> Jobs<'a> {
    fn put<T: bytemuck::Pod>(&mut self, job: T) -> wgpu::BindingResource<'a> {
        let offset = self.next * JOB;
        debug_assert!(self.next < JOBS);
        self.next += 1;
        self.gpu.write(self.buffer, offset, &[job]);
        let size = wgpu::BufferSize::new(size_of::<T>() as u64);
        wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: self.buffer, offset, size })
    }
}

impl Bound {
    /// Binds everything and writes the jobs of scan and sort.
    pub(crate) fn new(gpu: &Gpu, kernels: &Kernels, b: &Buffers, pages: &Pages, sizes: &Sizes) -> Self {
        let group = |module: &Module, buffers: &[&wgpu::Buffer]| {
            let resources: Vec<_> = buffers.iter().map(|b| b.as_entire_binding()).collect();
            module.bind(gpu, &resources)
        };
        let mut jobs = Jobs { gpu, buffer: &b.jobs, next: 0 };
        let mut scan = |n: u32, total: Counter, data: &wgpu::Buffer| {
            let job = jobs.put(ScanJob { n, total: total as u32, ..ScanJob::default() });
            let rest = [data, &b.block_sums, &b.counters].map(|b| b.as_entire_binding());
            kernels.scan.bind(gpu, &[&[job][..], &rest[..]].concat())
        };
        let (n, depth_blocks, tile_blocks) = (pages.n as u32, blocks(pages.n), blocks(sizes.pairs));
        let scan_flags = scan(n, Counter::Visible, &b.flags);
        let scan_counts = scan(n, Counter::Pairs, &b.counts);
        let scan_depth_table = scan(16 * depth_blocks, Counter::Spare, &b.table);
        let scan_tile_table = scan(16 * tile_blocks, Counter::Spare, &b.table);
        let mut sort = |pass: u32, job: SortJob, keys: [&wgpu::Buffer; 2], values: [&wgpu::Buffer; 2]| {
            let (from, to) = (pass as usize % 2, 1 - pass as usize % 2);
            let job = jobs.put(SortJob { shift: 4 * pass, ..job });
            let rest = [&b.counters, &b.table, keys[from], values[from], keys[to], values[to]];
            kernels.sort.bind(gpu, &[&[job][..], &rest.map(|b| b.as_entire_binding())[..]].concat())
        };
        let job =
            SortJob { count: Counter::Visible as u32, blocks: depth_blocks, limit: n, ..SortJob::default() };
        let (keys, order) = ([&b.depth_keys_a, &b.depth_keys_b], [&b.order_a, &b.order_b]);
        let by_depth = (0..SORT_PASSES as u32).map(|pass| sort(pass, job, keys, order)).collect();
        let limit = sizes.pairs as u32;
        let job = SortJob { count: Counter::Pairs as u32, blocks: tile_blocks, limit, ..SortJob::default() };
        let (keys, pairs) = ([&b.tile_keys_a, &b.tile_keys_b], [&b.pairs_a, &b.pairs_b]);
        let by_tile = (0..SORT_PASSES as u32)
            .map(|pass| sort(pass, SortJob { number: u32::from(pass == 0), ..job }, keys, pairs))
            .collect();
        let f = &b.frame;
        let training = sizes.training.then(|| {
            let loss = [f, &b.image, &b.goal, &b.by_mean, &b.by_square, &b.by_product, &b.partial, &b.result];
            let backward =
                [f, &b.records, &b.colours, &b.sorted, &b.ranges, &b.image, &b.sums_a, &b.sums_b, &b.sums_c];
            [group(&kernels.loss, &loss), group(&kernels.rasterise_backward, &backward)]
        });
        let page = |p: &super::pages::Page| {
            let project = [f, &p.uniform, &p.geometry, &p.sh, &b.records, &b.colours, &b.boxes, &b.flags];
            let optimise = || {
                let model = [f, &p.uniform, &p.geometry, &p.sh];
                let rest = [&b.sums_a, &b.sums_b, &b.sums_c, &b.spans, &b.counters];
                group(&kernels.adam, &[&model[..], &rest[..]].concat())
            };
            (
                group(&kernels.project, &project),
                (sizes.training && pages.training).then(optimise),
                p.job.count,
            )
        };
        Self {
            pages: pages.list.iter().map(page).collect(),
            scan_flags,
            scan_counts,
            scan_depth_table,
            scan_tile_table,
            compact: group(
                &kernels.compact,
                &[f, &b.boxes, &b.flags, &b.records, &b.depth_keys_a, &b.order_a],
            ),
            by_depth,
            by_tile,
            pairs: group(
                &kernels.pairs,
                &[
                    f,
                    &b.counters,
                    &b.order_a,
                    &b.boxes,
                    &b.records,
                    &b.counts,
                    &b.tile_keys_a,
                    &b.owners,
                    &b.spans,
                ],
            ),
            ranges: group(
                &kernels.ranges,
                &[f, &b.counters, &b.tile_keys_a, &b.pairs_a, &b.owners, &b.ranges, &b.sorted],
            ),
            rasterise: group(
                &kernels.rasterise,
                &[f, &b.records, &b.colours, &b.sorted, &b.ranges, &b.image, &b.depth],
            ),
            training,
            n,
            pairs_room: sizes.pairs as u32,
        }
    }

    /// Encodes the stages for a view of `tiles` tiles.
    pub(crate) fn encode(
        &self,
        kernels: &Kernels,
        buffers: &Buffers,
        encoder: &mut wgpu::CommandEncoder,
        stages: RangeInclusive<Stage>,
        tiles: u32,
        stamps: Option<(&wgpu::QuerySet, u32)>,
    ) {
        if stages.contains(&Stage::Project) {
            encoder.clear_buffer(&buffers.counters, 0, Some(4 * Counter::Halt as u64));
            encoder.clear_buffer(&buffers.ranges, 0, None);
            encoder.clear_buffer(&buffers.spans, 0, None);
        }
        for stage in Stage::of(&stages) {
            let k = stage.number();
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: None,
                timestamp_writes: stamps.map(|(query_set, first)| wgpu::ComputePassTimestampWrites {
                    query_set,
                    beginning_of_pass_write_index: Some(first + 2 * k),
                    end_of_pass_write_index: Some(first + 2 * k + 1),
                }),
            });
            self.stage(kernels, &mut pass, stage, tiles);
        }
    }

    fn stage(&self, kernels: &Kernels, pass: &mut wgpu::ComputePass, stage: Stage, tiles: u32) {
        let groups = self.n.div_ceil(GROUP);
        match (stage, &self.training) {
            (Stage::Project, _) => {
                for (project, _, count) in &self.pages {
                    kernels.project.run(pass, 0, project, count.div_ceil(GROUP), 1);
                }
            }
            (Stage::Sort, _) => self.sort(kernels, pass, groups, tiles),
            (Stage::Forward, _) => kernels.rasterise.run(pass, 0, &self.rasterise, tiles, 1),
            (Stage::Loss, Some([loss, _])) => {
                kernels.loss.run(pass, 0, loss, tiles, 3);
                kernels.loss.run(pass, 1, loss, tiles, 1);
                kernels.loss.run(pass, 4, loss, 1, 1);
            }
            (Stage::Products, Some([loss, _])) => {
                kernels.loss.run(pass, 2, loss, tiles, 3);
                kernels.loss.run(pass, 3, loss, 1, 3);
            }
            (Stage::Backward, Some([_, backward])) => {
                let blocks = self.pairs_room.div_ceil(SPAN as u32);
                kernels.rasterise_backward.run(pass, 0, backward, blocks, 1);
            }
            (Stage::Optimise, Some(_)) => {
                for (_, optimise, count) in &self.pages {
                    if let Some(optimise) = optimise {
                        kernels.adam.run(pass, 0, optimise, count.div_ceil(GROUP), 1);
                    }
                }
            }
            (_, None) => {}
        }
    }

    /// Sorts the first `n` keys of `depth_keys_a` with their values in `order_a`, n being
    /// [`Counter::Visible`].
    pub(super) fn sort_by_key(&self, kernels: &Kernels, pass: &mut wgpu::ComputePass) {
        for bound in &self.by_depth {
            radix(kernels, pass, bound, &self.scan_depth_table, blocks(self.n as usize));
        }
    }

    fn sort(&self, kernels: &Kernels, pass: &mut wgpu::ComputePass, groups: u32, tiles: u32) {
        scan(kernels, pass, &self.scan_flags, self.n);
        kernels.compact.run(pass, 0, &self.compact, groups, 1);
        self.sort_by_key(kernels, pass);
        kernels.pairs.run(pass, 0, &self.pairs, groups, 1);
        scan(kernels, pass, &self.scan_counts, self.n);
        kernels.pairs.run(pass, 1, &self.pairs, groups, 1);
        for bound in &self.by_tile[..tile_passes(tiles)] {
            radix(kernels, pass, bound, &self.scan_tile_table, blocks(self.pairs_room as usize));
        }
        kernels.ranges.run(pass, 0, &self.ranges, self.pairs_room.div_ceil(GROUP), 1);
    }
}

/// Values up to which one group scans all of them: a dispatch of three costs more. Source: chosen
/// by hand, never measured.
const WHOLE: u32 = 4 * BLOCK;

/// Prefix sums of `n` values.
pub(crate) fn scan(kernels: &Kernels, pass: &mut wgpu::ComputePass, bound: &wgpu::BindGroup, n: u32) {
    if n <= WHOLE {
        kernels.scan.run(pass, 3, bound, 1, 1);
        return;
    }
    let blocks = blocks(n as usize);
    for (entry, groups) in [blocks, 1, blocks].into_iter().enumerate() {
        kernels.scan.run(pass, entry, bound, groups, 1);
    }
}

/// One pass of the radix sort.
fn radix(
    kernels: &Kernels,
    pass: &mut wgpu::ComputePass,
    bound: &wgpu::BindGroup,
    table: &wgpu::BindGroup,
    blocks: u32,
) {
    kernels.sort.run(pass, 0, bound, blocks, 1);
    scan(kernels, pass, table, 16 * blocks);
    kernels.sort.run(pass, 1, bound, blocks, 1);
}

/// Passes that the numbers 0 to `tiles` need, made even so that the result lies where it began.
fn tile_passes(tiles: u32) -> usize {
    let bits = u32::BITS - tiles.leading_zeros();
    (bits.div_ceil(8) as usize * 2).clamp(2, SORT_PASSES)
}
