//! Steps under way: submitted one after the other, reported together, so that the device never
//! waits for the host. One report a step (64 bytes) is written on the device; a window of them is
//! read back at a time.

use super::bound::{Bound, Stage};
use super::buffers::{Buffers, REPORT};
use super::context::Gpu;
use super::kernels::Kernels;
use super::layout::{COUNTERS, Counter, Frame};
use super::photos::PlacedPhoto;
use crate::backend::KernelTimes;
use crate::error::SplatError;
use std::ops::RangeInclusive;
use wgpu::QUERY_RESOLVE_BUFFER_ALIGNMENT;

/// The most steps that are under way. Source: chosen by hand, never measured.
pub(crate) const WINDOW: usize = 16;
/// Time stamps of a step: begin and end of each stage. Source: twice its six stages.
const STAMPS: u32 = 12;

/// A step that was submitted.
#[derive(Clone)]
pub(crate) struct Pending {
    /// What the kernels know.
    pub(crate) frame: Frame,
    /// What is run.
    pub(crate) stages: RangeInclusive<Stage>,
    /// The target.
    pub(crate) photo: Option<PlacedPhoto>,
    /// Weight of D-SSIM, and whether it is a training step that is to be reported.
    pub(crate) step: Option<f32>,
}

/// What comes back from the device after a step.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Report {
    /// By their numbers.
    pub(crate) counters: [u32; COUNTERS],
    /// First row: sums of w S, w |C − G|, w (C − G)². After products: a row a channel.
    pub(crate) sums: [[f32; 4]; 3],
}

impl Report {
    /// Loss and mean squared error over a sum of weights.
    pub(crate) fn loss(&self, weights: f64, lambda: f32) -> (f32, f32) {
        if weights <= 0.0 {
            return (0.0, 0.0);
        }
        let [similarity, l1, mse, _] = self.sums[0].map(|sum| f64::from(sum) / (3.0 * weights));
        let lambda = f64::from(lambda);
        (((1.0 - lambda) * l1 + lambda * (1.0 - similarity)) as f32, mse as f32)
    }

    /// Pairs that the view needs.
    pub(crate) fn pairs(&self) -> usize {
        self.counters[Counter::Pairs as usize] as usize
    }
}

/// Reports and time stamps of the steps under way.
pub(crate) struct Flight {
    reports: wgpu::Buffer,
    staging: wgpu::Buffer,
    stamps: Option<(wgpu::QuerySet, wgpu::Buffer)>,
    pending: Vec<Pending>,
    /// Seconds by kernel so far.
    pub(crate) times: KernelTimes,
}

/// Word `k` of a report.
fn word(report: &[u8], k: usize) -> u32 {
    bytemuck::pod_read_unaligned(&report[4 * k..4 * k + 4])
}

fn buffer(gpu: &Gpu, label: &str, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
    let label = Some(label);
    gpu.device.create_buffer(&wgpu::BufferDescriptor { label, size, usage, mapped_at_creation: false })
}

impl Flight {
    /// None under way.
    pub(crate) fn new(gpu: &Gpu) -> Result<Self, SplatError> {
        let steps = WINDOW as u64;
        let stamps = gpu.device.features().contains(wgpu::Features::TIMESTAMP_QUERY).then(|| {
            let set = gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: None,
                ty: wgpu::QueryType::Timestamp,
                count: STAMPS * WINDOW as u32,
            });
            let usage = wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC;
            (set, buffer(gpu, "stamps", QUERY_RESOLVE_BUFFER_ALIGNMENT * steps, usage))
        });
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        Ok(Self {
            reports: gpu.buffer("reports", REPORT * steps, None)?,
            staging: buffer(gpu, "staging", (REPORT + QUERY_RESOLVE_BUFFER_ALIGNMENT) * steps, usage),
            stamps,
            pending: Vec::new(),
            times: KernelTimes::default(),
        })
    }

    /// Steps under way.
    pub(crate) fn count(&self) -> usize {
        self.pending.len()
    }

    /// Submits a step; at most [`WINDOW`] until they are collected.
    pub(crate) fn submit(
        &mut self,
        gpu: &Gpu,
        kernels: &Kernels,
        (b, bound): (&Buffers, &Bound),
        step: Pending,
    ) {
        let slot = self.pending.len() as u64;
        gpu.write(&b.frame, 0, &[step.frame]);
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        if let Some(photo) = &step.photo
            && let Some(shelf) = &photo.shelf
        {
            encoder.copy_buffer_to_buffer(shelf, photo.offset, &b.goal, 0, photo.bytes);
        }
        let [x, y] = step.frame.tiles;
        let first = STAMPS * slot as u32;
        let stamps = self.stamps.as_ref().map(|s| (&s.0, first));
        bound.encode(kernels, b, &mut encoder, step.stages.clone(), x * y, stamps);
        let counters = 4 * COUNTERS as u64;
        encoder.copy_buffer_to_buffer(&b.counters, 0, &self.reports, REPORT * slot, counters);
        encoder.copy_buffer_to_buffer(
            &b.result,
            0,
            &self.reports,
            REPORT * slot + counters,
            REPORT - counters,
        );
        if let Some((set, buffer)) = &self.stamps {
            let [from, to] =
                [step.stages.start().number(), step.stages.end().number() + 1].map(|k| first + 2 * k);
            encoder.resolve_query_set(set, from..to, buffer, QUERY_RESOLVE_BUFFER_ALIGNMENT * slot);
        }
        gpu.queue.submit([encoder.finish()]);
        self.pending.push(step);
    }

    /// Waits for the steps under way: what they were and what they report.
    pub(crate) fn collect(&mut self, gpu: &Gpu) -> Result<Vec<(Pending, Report)>, SplatError> {
        let pending = std::mem::take(&mut self.pending);
        if pending.is_empty() {
            return Ok(Vec::new());
        }
        let (reports, steps) = (REPORT * WINDOW as u64, pending.len() as u64);
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(&self.reports, 0, &self.staging, 0, REPORT * steps);
        if let Some((_, buffer)) = &self.stamps {
            encoder.copy_buffer_to_buffer(
                buffer,
                0,
                &self.staging,
                reports,
                QUERY_RESOLVE_BUFFER_ALIGNMENT * steps,
            );
        }
        gpu.queue.submit([encoder.finish()]);
        let mut bytes = vec![0u8; (reports + QUERY_RESOLVE_BUFFER_ALIGNMENT * steps) as usize];
        gpu.fetch(&self.staging, &mut bytes)?;
        let (numbers, stamps) = bytes.split_at(reports as usize);
        let mut out = Vec::with_capacity(pending.len());
        for ((step, own), stamps) in pending
            .into_iter()
            .zip(numbers.chunks_exact(REPORT as usize))
            .zip(stamps.chunks(QUERY_RESOLVE_BUFFER_ALIGNMENT as usize))
        {
            let counters = std::array::from_fn(|k| word(own, k));
            let sums = std::array::from_fn(|r| {
                std::array::from_fn(|k| f32::from_bits(word(own, COUNTERS + 4 * r + k)))
            });
            self.note_times(gpu, &step.stages, stamps);
            out.push((step, Report { counters, sums }));
        }
        Ok(out)
    }

    fn note_times(&mut self, gpu: &Gpu, stages: &RangeInclusive<Stage>, stamps: &[u8]) {
        if self.stamps.is_none() {
            return;
        }
        let unit = f64::from(gpu.queue.get_timestamp_period()) * 1e-9;
        for (stage, pair) in Stage::of(stages).zip(stamps.chunks_exact(16)) {
            let t = &mut self.times;
            let slot = match stage {
                Stage::Project => &mut t.project,
                Stage::Sort => &mut t.sort,
                Stage::Forward => &mut t.forward,
                Stage::Loss | Stage::Products => &mut t.loss,
                Stage::Backward => &mut t.backward,
                Stage::Optimise => &mut t.optimise,
            };
            let [begin, end]: [u64; 2] = bytemuck::pod_read_unaligned(pair);
            *slot += end.saturating_sub(begin) as f64 * unit;
        }
    }
}
