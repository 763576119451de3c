//! The backend: uploads, frames, steps, downloads.

use super::bound::{Bound, Stage};
use super::buffers::{Buffers, Limit, REPORT, Sizes, capacity, tiles};
use super::context::Gpu;
use super::kernels::Kernels;
use super::layout::{
    BLOCK, CLOCK, COUNTERS, COVERAGE, Frame, MAGNITUDES, NON_FINITE, PAIRS, PLANES, STATISTICS, VISIBLE,
    WEIGHTED,
};
use crate::adapter::Adapter;
use crate::backend::{Backend, KernelTimes, StepInput, StepOutput, Target};
use crate::cpu::DEFAULT_NEAR;
use crate::cpu::optimise::Statistics;
use crate::cpu::project::CameraConstants;
use crate::model::{GEOMETRY, Model, padded};
use crate::{PinholeView, RenderOptions, RenderOutput, SplatError};
use scene::FloatImage;
use std::ops::RangeInclusive;

/// Time stamps of a step: begin and end of each stage.
const STAMPS: usize = 2 * Stage::ALL.len();

/// The GPU backend. The model lives on the device; a copy stays on the host only until the first step.
pub struct GpuBackend {
    pub(super) gpu: Gpu,
    kernels: Kernels,
    pub(super) sizes: Sizes,
    sh_degree: u32,
    pub(super) buffers: Option<(Buffers, Bound)>,
    /// The model as uploaded, while the device has no moments.
    untrained: Option<(Model, Statistics)>,
    report: wgpu::Buffer,
    stamps: Option<(wgpu::QuerySet, wgpu::Buffer)>,
    times: KernelTimes,
    limit: Option<u64>,
    gain: Option<[f32; 3]>,
    magnitudes: u32,
}

/// What comes back from the device after a step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Report {
    counters: [u32; COUNTERS],
    /// Sums of w S, w |C − G|, w (C − G)².
    sums: [f32; 4],
}

impl Report {
    /// Loss and mean squared error over a sum of weights.
    pub(super) fn loss(&self, weights: f64, lambda: f32) -> (f32, f32) {
        if weights <= 0.0 {
            return (0.0, 0.0);
        }
        let [similarity, l1, mse, _] = self.sums.map(|sum| f64::from(sum) / (3.0 * weights));
        let lambda = f64::from(lambda);
        (((1.0 - lambda) * l1 + lambda * (1.0 - similarity)) as f32, mse as f32)
    }
}

impl GpuBackend {
    /// Opens an adapter (see [`Gpu::open`]) and compiles the kernels. `limit`: bytes of its memory that may be used.
    pub fn open(name: Option<&str>, limit: Option<u64>) -> Result<Self, SplatError> {
        let gpu = Gpu::open(name)?;
        let kernels = Kernels::new(&gpu)?;
        let stamps = gpu.device.features().contains(wgpu::Features::TIMESTAMP_QUERY).then(|| {
            let set = gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: None,
                ty: wgpu::QueryType::Timestamp,
                count: STAMPS as u32,
            });
            let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("stamps"),
                size: 8 * STAMPS as u64,
                usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            });
            (set, buffer)
        });
        let report = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("report"),
            size: REPORT + 8 * STAMPS as u64,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        gpu.check()?;
        Ok(Self {
            gpu,
            kernels,
            sizes: Sizes::default(),
            sh_degree: 0,
            buffers: None,
            untrained: None,
            report,
            stamps,
            times: KernelTimes::default(),
            limit,
            gain: None,
            magnitudes: 0,
        })
    }

    /// What it runs on.
    pub fn adapter(&self) -> &Adapter {
        &self.gpu.adapter
    }

    fn write_parameters(&self, model: &Model) {
        let Some((b, _)) = &self.buffers else { return };
        let plane = 4 * padded(model.len) as u64;
        for (p, values) in (0..).zip(&model.geometry) {
            self.gpu.write(&b.geometry, p * plane, values);
        }
        self.gpu.write(&b.sh, 0, &model.sh);
    }

    fn write_model(&self, model: &Model, s: &Statistics) {
        self.write_parameters(model);
        let Some((b, _)) = &self.buffers else { return };
        let plane = 4 * padded(model.len) as u64;
        let moments = model.geometry_m.iter().chain(&model.geometry_v).chain([&model.steps]);
        for (p, values) in (GEOMETRY as u64..).zip(moments) {
            self.gpu.write(&b.geometry, p * plane, values);
        }
        let stride = model.sh_stride();
        let pairs = model.sh_m.chunks_exact(stride).zip(model.sh_v.chunks_exact(stride));
        let both: Vec<f32> = pairs.flat_map(|(m, v)| m.iter().chain(v).copied()).collect();
        self.gpu.write(&b.sh_moments, 0, &both);
        for (p, values) in (0..).zip([&s.gradient, &s.visible, &s.weight, &s.radius]) {
            let mut values = values.clone();
            values.resize(padded(model.len), 0.0);
            self.gpu.write(&b.statistics, p * plane, &values);
        }
    }

    /// Buffers of at least these sizes. What stays of the same size keeps its contents.
    fn resize(&mut self, needed: Sizes) -> Result<(), SplatError> {
        if self.buffers.is_some() && self.sizes.hold(&needed) {
            return Ok(());
        }
        let sizes = Sizes {
            pairs: needed.pairs.max(self.sizes.pairs).max(BLOCK as usize),
            pixels: needed.pixels.max(self.sizes.pixels).max(1),
            tiles: needed.tiles.max(self.sizes.tiles).max(1),
            training: needed.training || self.sizes.training,
            ..needed
        };
        let total: u64 = Buffers::plan(&sizes).iter().map(|b| b.1).sum();
        if let Some(limit) = self.limit.filter(|&limit| total > limit) {
            let (needed, limit) = (total >> 20, limit >> 20);
            return Err(self.gpu.error(format!("{needed} MiB are needed and --vram-limit allows {limit}")));
        }
        let old = self.buffers.take().map(|(buffers, _)| buffers);
        let buffers = Buffers::new(&self.gpu, &sizes, old)?;
        let bound = Bound::new(&self.gpu, &self.kernels, &buffers, &sizes);
        self.buffers = Some((buffers, bound));
        self.sizes = sizes;
        self.gpu.check()
    }

    /// Makes room for a view, and for moments before the first step.
    pub(super) fn prepare(&mut self, view: &PinholeView, training: bool) -> Result<(), SplatError> {
        let (pixels, tiles) = (view.width * view.height, tiles(view.width, view.height));
        self.resize(Sizes { pixels, tiles, training, ..self.sizes })?;
        if training && let Some((model, statistics)) = self.untrained.take() {
            self.write_model(&model, &statistics);
        }
        Ok(())
    }

    pub(super) fn frame_of(&self, view: &PinholeView, options: &RenderOptions) -> Frame {
        let degree = options.sh_degree.unwrap_or(3).min(self.sh_degree);
        let near = options.near.unwrap_or(DEFAULT_NEAR);
        let camera = CameraConstants::new(view, options, near, degree);
        let [r, g, b] = options.background;
        let [ur, ug, ub] = self.gain.unwrap_or([1.0; 3]).map(f32::recip);
        Frame {
            background: [r, g, b, 0.0],
            unit: [ur, ug, ub, 1.0],
            n: self.sizes.n as u32,
            stride: padded(self.sizes.n.max(1)) as u32,
            sh_stride: self.sizes.sh_stride as u32,
            ..Frame::of_camera(&camera)
        }
    }

    /// Runs the stages; again with more room where the pairs did not fit (nothing has moved then).
    pub(super) fn run(&mut self, frame: Frame, stages: RangeInclusive<Stage>) -> Result<Report, SplatError> {
        loop {
            let frame = Frame { pair_capacity: self.sizes.pairs as u32, ..frame };
            let Some((b, bound)) = &self.buffers else { return Ok(Report::default()) };
            self.gpu.write(&b.frame, 0, &[frame]);
            let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
            let [x, y] = frame.tiles;
            let stamps = self.stamps.as_ref().map(|s| &s.0);
            bound.encode(&self.kernels, b, &mut encoder, stages.clone(), x * y, stamps);
            encoder.copy_buffer_to_buffer(&b.counters, 0, &self.report, 0, 4 * COUNTERS as u64);
            encoder.copy_buffer_to_buffer(&b.result, 0, &self.report, 4 * COUNTERS as u64, 16);
            if let Some((set, buffer)) = &self.stamps {
                let (first, last) = (2 * *stages.start() as u32, 2 * *stages.end() as u32 + 2);
                encoder.resolve_query_set(set, first..last, buffer, 0);
                encoder.copy_buffer_to_buffer(buffer, 0, &self.report, REPORT, 8 * u64::from(last - first));
            }
            self.gpu.queue.submit([encoder.finish()]);
            let mut bytes = [0u8; REPORT as usize + 8 * STAMPS];
            self.gpu.fetch(&self.report, &mut bytes)?;
            let (numbers, stamps) = bytes.split_at(REPORT as usize);
            let words: [u32; REPORT as usize / 4] =
                std::array::from_fn(|k| bytemuck::pod_read_unaligned(&numbers[4 * k..4 * k + 4]));
            let report = Report {
                counters: std::array::from_fn(|k| words[k]),
                sums: std::array::from_fn(|k| f32::from_bits(words[COUNTERS + k])),
            };
            self.note_times(&stages, stamps);
            let needed = report.counters[PAIRS as usize] as usize;
            if needed <= self.sizes.pairs {
                return Ok(report);
            }
            let pairs = (needed + needed / 4).next_multiple_of(BLOCK as usize);
            self.resize(Sizes { pairs, ..self.sizes })?;
        }
    }

    fn note_times(&mut self, stages: &RangeInclusive<Stage>, stamps: &[u8]) {
        if self.stamps.is_none() {
            return;
        }
        let unit = f64::from(self.gpu.queue.get_timestamp_period()) * 1e-9;
        let t = &mut self.times;
        let slots =
            [&mut t.project, &mut t.sort, &mut t.forward, &mut t.loss, &mut t.backward, &mut t.optimise];
        let used = slots.into_iter().skip(*stages.start() as usize);
        for (slot, pair) in
            used.zip(stamps.chunks_exact(16)).take(*stages.end() as usize + 1 - *stages.start() as usize)
        {
            let [begin, end]: [u64; 2] = bytemuck::pod_read_unaligned(pair);
            *slot += end.saturating_sub(begin) as f64 * unit;
        }
    }

    /// Puts the target on the device; returns the flags of its mask and the sum of its weights.
    pub(super) fn set_target(&self, target: &Target) -> (u32, f64) {
        let pixels = target.rgb.chunks_exact(3);
        let count = pixels.len();
        let rgba: Vec<[u8; 4]> = match target.mask {
            Some(mask) => pixels.zip(mask).map(|(c, &m)| [c[0], c[1], c[2], m]).collect(),
            None => pixels.map(|c| [c[0], c[1], c[2], 255]).collect(),
        };
        if let Some((b, _)) = &self.buffers {
            self.gpu.write(&b.goal, 0, &rgba);
        }
        match target.mask {
            Some(_) if target.transparent => (COVERAGE, count as f64),
            Some(mask) => (WEIGHTED, mask.iter().map(|&m| u64::from(m)).sum::<u64>() as f64 / 255.0),
            None => (0, count as f64),
        }
    }
}

impl Backend for GpuBackend {
    fn name(&self) -> String {
        self.gpu.adapter.to_string()
    }

    fn upload(&mut self, model: Model, statistics: Statistics) -> Result<(), SplatError> {
        let sizes = Sizes { n: model.len, sh_stride: model.sh_stride(), ..self.sizes };
        self.sh_degree = model.sh_degree;
        self.resize(sizes)?;
        if self.sizes.training {
            self.write_model(&model, &statistics);
        } else {
            self.write_parameters(&model);
            self.untrained = Some((model, statistics));
        }
        Ok(())
    }

    fn download(&mut self) -> Result<(Model, Statistics), SplatError> {
        let n = self.sizes.n;
        let stride = padded(n);
        if let Some(held) = &self.untrained {
            return Ok(held.clone());
        }
        let Some((b, _)) = &self.buffers else { return Ok(Default::default()) };
        let all: Vec<f32> = self.gpu.read(&b.geometry, 0, PLANES as usize * stride)?;
        let plane = |p: usize| all[p * stride..(p + 1) * stride].to_vec();
        let planes = |first: usize| std::array::from_fn(|p| plane(first + p));
        let sh_stride = self.sizes.sh_stride;
        let both: Vec<f32> = self.gpu.read(&b.sh_moments, 0, n * 2 * sh_stride)?;
        let half = |k: usize| -> Vec<f32> {
            both.chunks_exact(sh_stride).skip(k).step_by(2).flatten().copied().collect()
        };
        let model = Model {
            len: n,
            sh_degree: self.sh_degree,
            geometry: planes(0),
            geometry_m: planes(GEOMETRY),
            geometry_v: planes(2 * GEOMETRY),
            sh: self.gpu.read(&b.sh, 0, n * sh_stride)?,
            sh_m: half(0),
            sh_v: half(1),
            steps: plane(CLOCK),
        };
        let seen: Vec<f32> = self.gpu.read(&b.statistics, 0, STATISTICS as usize * stride)?;
        let plane = |p: usize| seen[p * stride..(p + 1) * stride].to_vec();
        let [gradient, visible, weight, radius] = std::array::from_fn(plane);
        let statistics = Statistics { gradient, visible, weight, radius };
        Ok((model, statistics))
    }

    fn edit(&mut self, change: &mut dyn FnMut(&mut Model, &mut Statistics)) -> Result<(), SplatError> {
        let (mut model, mut statistics) = self.download()?;
        change(&mut model, &mut statistics);
        self.upload(model, statistics)
    }

    fn gaussians(&self) -> usize {
        self.sizes.n
    }

    fn sh_degree(&self) -> u32 {
        self.sh_degree
    }

    fn capacity(&self, sh_degree: u32, pixels: usize) -> Option<(usize, String)> {
        let largest = self.gpu.largest_buffer();
        let (most, limit) = capacity(3 * (sh_degree as usize + 1).pow(2), pixels, largest, self.limit);
        Some((
            most,
            match limit {
                Limit::Binding => format!("a buffer of {} may have {} MiB", self.gpu.adapter, largest >> 20),
                Limit::Memory => format!("--vram-limit {}", self.limit.unwrap_or(0) >> 20),
            },
        ))
    }

    fn render(&mut self, view: &PinholeView, options: &RenderOptions) -> Result<RenderOutput, SplatError> {
        self.render_only(view, options)?;
        let (w, h) = (view.width, view.height);
        let mut out = RenderOutput {
            rgb: FloatImage::zeros(w, h, 3),
            alpha: FloatImage::zeros(w, h, 1),
            depth: FloatImage::zeros(w, h, 1),
        };
        let Some((b, _)) = &self.buffers else { return Ok(out) };
        let image: Vec<[f32; 4]> = self.gpu.read(&b.image, 0, w * h)?;
        for (i, [red, green, blue, clear]) in image.into_iter().enumerate() {
            out.rgb.data[3 * i..3 * i + 3].copy_from_slice(&[red, green, blue]);
            out.alpha.data[i] = 1.0 - clear;
        }
        out.depth.data = self.gpu.read(&b.depth, 0, w * h)?;
        Ok(out)
    }

    fn step(&mut self, input: &StepInput) -> Result<StepOutput, SplatError> {
        self.prepare(input.view, true)?;
        let (flags, weights) = self.set_target(&input.target);
        let inverse = if weights > 0.0 { 1.0 / (3.0 * weights) } else { 0.0 };
        let frame = self.frame_of(input.view, &input.options);
        let frame = Frame {
            flags: frame.flags | flags | self.magnitudes,
            lambda: input.lambda_dssim,
            inv_count: inverse as f32,
            opacity_penalty: input.opacity_penalty,
            scale_penalty: input.scale_penalty,
            rate_mean: input.rates.mean,
            rate_log_scale: input.rates.log_scale,
            rate_rotation: input.rates.rotation,
            rate_opacity: input.rates.opacity,
            rate_sh0: input.rates.sh0,
            rate_sh_rest: input.rates.sh_rest,
            ..frame
        };
        let report = self.run(frame, Stage::Project..=Stage::Optimise)?;
        let (loss, mse) = report.loss(weights, input.lambda_dssim);
        let counter = |k: u32| report.counters[k as usize] as usize;
        Ok(StepOutput {
            loss,
            mse,
            visible: counter(VISIBLE),
            pairs: counter(PAIRS),
            non_finite: counter(NON_FINITE),
        })
    }

    fn render_only(&mut self, view: &PinholeView, options: &RenderOptions) -> Result<(), SplatError> {
        self.prepare(view, false)?;
        self.run(self.frame_of(view, options), Stage::Project..=Stage::Forward).map(|_| ())
    }

    fn memory(&self) -> Vec<(&'static str, u64)> {
        if self.buffers.is_some() { Buffers::plan(&self.sizes) } else { Vec::new() }
    }

    fn mean_square_error(
        &mut self,
        view: &PinholeView,
        target: &Target,
        options: &RenderOptions,
    ) -> Result<f64, SplatError> {
        self.prepare(view, true)?;
        let (flags, weights) = self.set_target(target);
        let frame = self.frame_of(view, options);
        let frame = Frame { flags: frame.flags | flags, ..frame };
        let report = self.run(frame, Stage::Project..=Stage::Loss)?;
        Ok(f64::from(report.loss(weights, 0.0).1))
    }

    fn set_gain(&mut self, gain: Option<[f32; 3]>) {
        self.gain = gain;
    }

    fn set_magnitudes(&mut self, on: bool) -> Result<(), SplatError> {
        self.magnitudes = if on { MAGNITUDES } else { 0 };
        Ok(())
    }

    fn times(&self) -> KernelTimes {
        self.times
    }
}
