//! Which kernel sees which buffers, and the commands of a step.

use super::buffers::{Buffers, JOB, JOBS, Sizes, blocks};
use super::context::Gpu;
use super::kernels::{Kernels, Module};
use super::layout::{GROUP, PAIRS, SPARE, ScanJob, SortJob, VISIBLE};
use std::ops::RangeInclusive;

/// Passes of the sort by depth: 32 bits, four at a time.
const DEPTH_PASSES: usize = 8;
/// The most passes of the sort by tile.
const TILE_PASSES: usize = 8;

/// What a step consists of, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Gaussians to the screen.
    Project,
    /// By depth, then by tile.
    Sort,
    /// Pixels.
    Forward,
    /// Loss and its gradient.
    Loss,
    /// Pixels to pairs.
    Backward,
    /// Pairs to Gaussians, which move.
    Optimise,
}

impl Stage {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Project, Self::Sort, Self::Forward, Self::Loss, Self::Backward, Self::Optimise];
}

/// The bind groups; valid as long as the buffers are.
pub struct Bound {
    project: wgpu::BindGroup,
    scan_flags: wgpu::BindGroup,
    scan_counts: wgpu::BindGroup,
    scan_depth_table: wgpu::BindGroup,
    scan_tile_table: wgpu::BindGroup,
    compact: wgpu::BindGroup,
    by_depth: Vec<wgpu::BindGroup>,
    by_tile: Vec<wgpu::BindGroup>,
    pairs: wgpu::BindGroup,
    ranges: wgpu::BindGroup,
    rasterise: wgpu::BindGroup,
    training: Option<[wgpu::BindGroup; 3]>,
    sizes: Sizes,
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
    pub fn new(gpu: &Gpu, kernels: &Kernels, b: &Buffers, sizes: &Sizes) -> Self {
        let group = |module: &Module, buffers: &[&wgpu::Buffer]| {
            let resources: Vec<_> = buffers.iter().map(|b| b.as_entire_binding()).collect();
            module.bind(gpu, &resources)
        };
        let mut jobs = Jobs { gpu, buffer: &b.jobs, next: 0 };
        let mut scan = |n: u32, total: u32, data: &wgpu::Buffer| {
            let job = jobs.put(ScanJob { n, total, ..ScanJob::default() });
            let rest = [data, &b.block_sums, &b.counters].map(|b| b.as_entire_binding());
            kernels.scan.bind(gpu, &[&[job][..], &rest[..]].concat())
        };
        let (n, depth_blocks, tile_blocks) = (sizes.n as u32, blocks(sizes.n), blocks(sizes.pairs));
        let scan_flags = scan(n, VISIBLE, &b.flags);
        let scan_counts = scan(n, PAIRS, &b.counts);
        let scan_depth_table = scan(16 * depth_blocks, SPARE, &b.table);
        let scan_tile_table = scan(16 * tile_blocks, SPARE, &b.table);
        let mut sort = |pass: u32, job: SortJob, keys: [&wgpu::Buffer; 2], values: [&wgpu::Buffer; 2]| {
            let (from, to) = (pass as usize % 2, 1 - pass as usize % 2);
            let job = jobs.put(SortJob { shift: 4 * pass, ..job });
            let rest = [&b.counters, &b.table, keys[from], values[from], keys[to], values[to]];
            kernels.sort.bind(gpu, &[&[job][..], &rest.map(|b| b.as_entire_binding())[..]].concat())
        };
        let job = SortJob { count: VISIBLE, blocks: depth_blocks, limit: n, ..SortJob::default() };
        let (keys, order) = ([&b.depth_keys_a, &b.depth_keys_b], [&b.order_a, &b.order_b]);
        let by_depth = (0..DEPTH_PASSES as u32).map(|pass| sort(pass, job, keys, order)).collect();
        let limit = sizes.pairs as u32;
        let job = SortJob { count: PAIRS, blocks: tile_blocks, limit, ..SortJob::default() };
        let (keys, pairs) = ([&b.tile_keys_a, &b.tile_keys_b], [&b.pairs_a, &b.pairs_b]);
        let by_tile = (0..TILE_PASSES as u32)
            .map(|pass| sort(pass, SortJob { number: u32::from(pass == 0), ..job }, keys, pairs))
            .collect();
        let f = &b.frame;
        let training = sizes.training.then(|| {
            [
                group(&kernels.loss, &[f, &b.image, &b.goal, &b.maps, &b.gradient, &b.partial, &b.result]),
                group(
                    &kernels.backward,
                    &[
                        f,
                        &b.records,
                        &b.owners,
                        &b.pairs_a,
                        &b.ranges,
                        &b.used,
                        &b.image,
                        &b.gradient,
                        &b.sums,
                    ],
                ),
                group(
                    &kernels.optimise,
                    &[f, &b.geometry, &b.sh, &b.sh_moments, &b.statistics, &b.sums, &b.spans, &b.counters],
                ),
            ]
        });
        Self {
            project: group(&kernels.project, &[f, &b.geometry, &b.sh, &b.records, &b.boxes, &b.flags]),
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
            ranges: group(&kernels.ranges, &[f, &b.counters, &b.tile_keys_a, &b.ranges]),
            rasterise: group(
                &kernels.rasterise,
                &[f, &b.records, &b.owners, &b.pairs_a, &b.ranges, &b.image, &b.depth, &b.used],
            ),
            training,
            sizes: *sizes,
        }
    }

    /// Encodes the stages for a view of `tiles` tiles.
    pub fn encode(
        &self,
        kernels: &Kernels,
        buffers: &Buffers,
        encoder: &mut wgpu::CommandEncoder,
        stages: RangeInclusive<Stage>,
        tiles: u32,
        stamps: Option<&wgpu::QuerySet>,
    ) {
        if stages.contains(&Stage::Project) {
            for buffer in [&buffers.counters, &buffers.ranges, &buffers.used, &buffers.spans] {
                encoder.clear_buffer(buffer, 0, None);
            }
        }
        for (k, stage) in (0..).zip(Stage::ALL) {
            if !stages.contains(&stage) {
                continue;
            }
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: None,
                timestamp_writes: stamps.map(|query_set| wgpu::ComputePassTimestampWrites {
                    query_set,
                    beginning_of_pass_write_index: Some(2 * k),
                    end_of_pass_write_index: Some(2 * k + 1),
                }),
            });
            self.stage(kernels, &mut pass, stage, tiles);
        }
    }

    fn stage(&self, kernels: &Kernels, pass: &mut wgpu::ComputePass, stage: Stage, tiles: u32) {
        let groups = (self.sizes.n as u32).div_ceil(GROUP);
        match (stage, &self.training) {
            (Stage::Project, _) => {
                kernels.project.run(pass, 0, &self.project, groups, 1);
            }
            (Stage::Sort, _) => self.sort(kernels, pass, groups, tiles),
            (Stage::Forward, _) => kernels.rasterise.run(pass, 0, &self.rasterise, tiles, 1),
            (Stage::Loss, Some([loss, ..])) => {
                kernels.loss.run(pass, 0, loss, tiles, 3);
                kernels.loss.run(pass, 1, loss, tiles, 3);
                kernels.loss.run(pass, 2, loss, 1, 1);
            }
            // One more than there are tiles: the pairs that belong to none.
            (Stage::Backward, Some([_, backward, _])) => {
                kernels.backward.run(pass, 0, backward, tiles + 1, 1);
            }
            (Stage::Optimise, Some([.., optimise])) => kernels.optimise.run(pass, 0, optimise, groups, 1),
            (_, None) => {}
        }
    }

    fn sort(&self, kernels: &Kernels, pass: &mut wgpu::ComputePass, groups: u32, tiles: u32) {
        let scan = |pass: &mut wgpu::ComputePass, bound: &wgpu::BindGroup, n: u32| {
            let blocks = blocks(n as usize);
            for (entry, groups) in [blocks, 1, blocks].into_iter().enumerate() {
                kernels.scan.run(pass, entry, bound, groups, 1);
            }
        };
        let radix = |pass: &mut wgpu::ComputePass, bound: &wgpu::BindGroup, table, blocks: u32| {
            kernels.sort.run(pass, 0, bound, blocks, 1);
            scan(pass, table, 16 * blocks);
            kernels.sort.run(pass, 1, bound, blocks, 1);
        };
        let n = self.sizes.n as u32;
        scan(pass, &self.scan_flags, n);
        kernels.compact.run(pass, 0, &self.compact, groups, 1);
        for bound in &self.by_depth {
            radix(pass, bound, &self.scan_depth_table, blocks(self.sizes.n));
        }
        kernels.pairs.run(pass, 0, &self.pairs, groups, 1);
        scan(pass, &self.scan_counts, n);
        kernels.pairs.run(pass, 1, &self.pairs, groups, 1);
        for bound in &self.by_tile[..tile_passes(tiles)] {
            radix(pass, bound, &self.scan_tile_table, blocks(self.sizes.pairs));
        }
        kernels.ranges.run(pass, 0, &self.ranges, (self.sizes.pairs as u32).div_ceil(GROUP), 1);
    }
}

/// Passes that the numbers 0 to `tiles` need, made even so that the result lies where it began.
fn tile_passes(tiles: u32) -> usize {
    let bits = u32::BITS - tiles.leading_zeros();
    (bits.div_ceil(8) as usize * 2).clamp(2, TILE_PASSES)
}
