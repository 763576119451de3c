//! A round of densification on the device: candidates by score, halves, what stays, and the model
//! gathered anew. Only the number of Gaussians comes back. Twin of `cpu/densify.rs`; its random
//! numbers are others.

use super::backend::GpuBackend;
use super::bound::scan;
use super::buffers::{Sizes, blocks};
use super::context::Gpu;
use super::layout::{Counter, DensifyJob, DensifyView, HalveJob, ScanJob};
use crate::backend::Round;
use crate::cpu::densify::{MIN_OPACITY, least_views};
use crate::error::SplatError;
use scene::Decision;
use scene::decision::{Choice, Rule, Subject};

impl GpuBackend {
    /// Carries the round out; how many were removed because hardly any view has them. Nothing, and
    /// nothing has changed, where the host has to do it: no moments yet, or nothing would be left.
    pub(super) fn densify_here(&mut self, round: &Round) -> Result<Option<usize>, SplatError> {
        let n = self.pages.as_ref().filter(|p| p.training).map_or(0, |p| p.n);
        if n == 0 {
            return Ok(None);
        }
        let wanted = round.room.min(n);
        let more = Sizes { room: self.roomy(n + wanted), ..self.sizes };
        let room = if self.try_resize(more)? {
            wanted
        } else {
            self.no_room(n);
            self.sizes.room.saturating_sub(n).min(wanted)
        };
        let (Some(pages), Some((buffers, bound))) = (self.pages.as_mut(), self.screen.as_ref()) else {
            return Ok(None);
        };
        let (gpu, kernels) = (&self.gpu, &self.kernels);
        let views = round.remove_unseen.unwrap_or(&[]);
        let job = DensifyJob {
            n: n as u32,
            room: room as u32,
            views: views.len() as u32,
            least: least_views(views.len()) as u32,
            iteration: round.iteration,
            seed: round.seed as u32 ^ (round.seed >> 32) as u32,
            floor: (MIN_OPACITY / (1.0 - MIN_OPACITY)).ln(),
            ..DensifyJob::default()
        };
        let (flags, source) = (words(gpu, "stays", n + room)?, words(gpu, "source", n + room)?);
        let sums = words(gpu, "stays' sums", blocks(n + room) as usize)?;
        let cameras: Vec<DensifyView> = views.iter().map(camera).collect();
        let cameras = if cameras.is_empty() { vec![DensifyView::default()] } else { cameras };
        let view_buffer = words(gpu, "views", cameras.len() * size_of::<DensifyView>() / 4)?;
        gpu.write(&view_buffer, 0, &cameras);
        gpu.write(&buffers.counters, 0, &[n as u32, 0, 0, 0, 0]);
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        encoder.clear_buffer(&buffers.counts, 0, None);
        encoder.clear_buffer(&flags, 0, None);
        let bindings = |uniform| {
            let lists = [&buffers.depth_keys_a, &buffers.order_a, &buffers.counts];
            [uniform, lists[0], lists[1], lists[2], &flags, &view_buffer, &buffers.counters, &source]
        };
        let mut jobs = Vec::new();
        for page in &pages.list {
            let [page_first, page_count, page_stride] = [page.job.first, page.job.count, page.job.stride];
            jobs.push(gpu.uniform(DensifyJob { page_first, page_count, page_stride, ..job })?);
        }
        let each = |encoder: &mut wgpu::CommandEncoder, entry, threads: &dyn Fn(u32) -> u32, all: bool| {
            for (page, uniform) in pages.list.iter().zip(&jobs).take(if all { usize::MAX } else { 1 }) {
                let [u, rest @ ..] = bindings(uniform);
                let bound = [&[u, &page.geometry][..], &rest].concat();
                kernels.densify.once(gpu, encoder, entry, &bound, threads(page.job.count));
            }
        };
        let room = room as u32;
        each(&mut encoder, 0, &|count| count, true);
        bound.sort_by_key(kernels, &mut encoder.begin_compute_pass(&Default::default()));
        each(&mut encoder, 1, &|_| room, false);
        each(&mut encoder, 2, &|count| count + room, true);
        let scan_job = gpu.uniform(ScanJob {
            n: n as u32 + room,
            total: Counter::Visible as u32,
            ..ScanJob::default()
        })?;
        let scanned = [&scan_job, &flags, &sums, &buffers.counters].map(wgpu::Buffer::as_entire_binding);
        let scanned = kernels.scan.bind(gpu, &scanned);
        scan(kernels, &mut encoder.begin_compute_pass(&Default::default()), &scanned, n as u32 + room);
        each(&mut encoder, 3, &|_| n as u32 + room, false);
        gpu.queue.submit([encoder.finish()]);
        let counters: Vec<u32> = gpu.read(&buffers.counters, 0, 4)?;
        let (kept, unseen) =
            (counters[Counter::Visible as usize] as usize, counters[Counter::NonFinite as usize] as usize);
        if kept == 0 {
            return Ok(None);
        }
        if !pages.gather(gpu, kernels, &source, kept)? {
            self.no_room(n);
            return Ok(Some(0));
        }
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        for page in &pages.list {
            let [first, count, stride] = [page.job.first, page.job.count, page.job.stride];
            let (iteration, seed) = (job.iteration, job.seed);
            let uniform =
                gpu.uniform(HalveJob { first, count, stride, iteration, seed, ..HalveJob::default() })?;
            kernels.halve.once(gpu, &mut encoder, 0, &[&uniform, &source, &page.geometry], count);
        }
        gpu.queue.submit([encoder.finish()]);
        if let Some(pages) = self.pages.take() {
            self.turn(pages)?;
        }
        Ok(Some(unseen))
    }

    fn no_room(&mut self, n: usize) {
        if self.remarks.iter().any(|r| r.subject == Subject::GrowthLimit) {
            return;
        }
        let decision = Decision::new(Subject::GrowthLimit, Choice::count(n), Rule::OutOfMemory);
        self.remarks.push(decision.quoting(self.gpu.adapter.to_string()));
    }
}

/// A buffer of `count` words of four bytes, of one at least.
fn words(gpu: &Gpu, name: &str, count: usize) -> Result<wgpu::Buffer, SplatError> {
    gpu.buffer(name, 4 * count.max(1) as u64, None)
}

fn camera(v: &crate::view::PinholeView) -> DensifyView {
    let [row0, row1, row2] = [0, 1, 2].map(|k| v.rotation.row(k).extend(v.translation[k]).to_array());
    DensifyView {
        row0,
        row1,
        row2,
        lens: [v.focal[0], v.focal[1], v.centre[0], v.centre[1]],
        size: [v.width as f32, v.height as f32, 0.0, 0.0],
    }
}
