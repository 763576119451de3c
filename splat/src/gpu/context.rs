//! Adapters and devices.

use super::pipelines::Pipelines;
use crate::adapter::{Adapter, AdapterKind};
use crate::error::SplatError;
use std::sync::{Arc, Mutex};

/// Bytes of a transfer at a time. Source: chosen by hand, never measured.
const PIECE: u64 = 64 << 20;

/// The adapters of this machine, hardware first.
pub(crate) fn adapters() -> Vec<Adapter> {
    enumerate().iter().map(describe).collect()
}

fn enumerate() -> Vec<wgpu::Adapter> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends: wgpu::Backends::PRIMARY,
        // Software adapters such as llvmpipe do not always claim conformance.
        flags: wgpu::InstanceFlags::ALLOW_UNDERLYING_NONCOMPLIANT_ADAPTER,
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    });
    let mut found = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY));
    found.sort_by_key(|a| rank(kind(a.get_info().device_type)));
    found
}

/// Place of a kind in the list of adapters.
fn rank(kind: AdapterKind) -> u8 {
    match kind {
        AdapterKind::Discrete => 0,
        AdapterKind::Virtual => 1,
        AdapterKind::Integrated => 2,
        AdapterKind::Unknown => 3,
        AdapterKind::Software => 4,
    }
}

fn kind(device: wgpu::DeviceType) -> AdapterKind {
    match device {
        wgpu::DeviceType::DiscreteGpu => AdapterKind::Discrete,
        wgpu::DeviceType::IntegratedGpu => AdapterKind::Integrated,
        wgpu::DeviceType::VirtualGpu => AdapterKind::Virtual,
        wgpu::DeviceType::Cpu => AdapterKind::Software,
        wgpu::DeviceType::Other => AdapterKind::Unknown,
    }
}

fn describe(adapter: &wgpu::Adapter) -> Adapter {
    let info = adapter.get_info();
    Adapter {
        interface: format!("{:?}", info.backend),
        kind: kind(info.device_type),
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
        max_binding: adapter.limits().max_storage_buffer_binding_size,
        name: info.name,
    }
}

/// What to open, and what of it to use.
#[derive(Clone, Debug, Default)]
pub(crate) struct Opening {
    /// The first adapter whose name contains this (any case); the first at all without.
    pub(crate) name: Option<String>,
    /// Bytes of its memory that may be used.
    pub(crate) memory: Option<u64>,
    /// Kernels without subgroup operations even where the adapter has them.
    pub(crate) plain: bool,
    /// No more than every adapter has (the defaults of WebGPU: eight storage buffers a stage, 16
    /// KiB shared), and no binding larger than this.
    pub(crate) binding: Option<u64>,
}

/// Subgroups of these sizes neither span two Gaussians of `rasterise_backward` nor are too short to
/// bring anything.
const SUBGROUP_SIZES: std::ops::RangeInclusive<u32> = 4..=32;

/// Counts the threads whose lane or subgroup is not the one that their number in the group says.
pub(crate) const LANES: &str = "
@group(0) @binding(0) var<storage, read_write> wrong: atomic<u32>;
@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32, @builtin(subgroup_invocation_id) lane: u32, @builtin(subgroup_size) lanes: u32) {
    let first = subgroupBroadcastFirst(local);
    if (local % lanes != lane || first != local - lane || lanes < 4u || lanes > 32u) {
        atomicAdd(&wrong, 1u);
    }
}
";

/// What to ask of an adapter: all that it has, or what every adapter has.
fn limits(adapter: &wgpu::Adapter, binding: Option<u64>) -> wgpu::Limits {
    let Some(binding) = binding else { return adapter.limits() };
    wgpu::Limits {
        max_storage_buffer_binding_size: binding,
        max_buffer_size: binding,
        max_uniform_buffer_binding_size: binding.min(wgpu::Limits::default().max_uniform_buffer_binding_size),
        ..wgpu::Limits::default()
    }
    .or_worse_values_from(&adapter.limits())
}

/// Keeps the first failure.
fn note(failure: &Mutex<Option<String>>, text: String) {
    if let Ok(mut failure) = failure.lock() {
        failure.get_or_insert(text);
    }
}

/// An open adapter.
pub(crate) struct Gpu {
    /// Makes buffers and pipelines.
    pub(crate) device: wgpu::Device,
    /// Takes work.
    pub(crate) queue: wgpu::Queue,
    /// What it is.
    pub(crate) adapter: Adapter,
    /// Whether kernels use subgroup operations.
    pub(crate) subgroups: bool,
    /// Pipelines kept between runs.
    pub(crate) pipelines: Option<Pipelines>,
    failure: Arc<Mutex<Option<String>>>,
}

impl Gpu {
    /// Opens an adapter with all that it can do that is of use.
    pub(crate) fn open(opening: &Opening) -> Result<Self, SplatError> {
        let wanted = opening.name.clone().unwrap_or_default().to_lowercase();
        let all = enumerate();
        let found = all.iter().find(|a| a.get_info().name.to_lowercase().contains(&wanted));
        let Some(found) = found else {
            let present: Vec<String> = all.iter().map(|a| describe(a).to_string()).collect();
            let present = if present.is_empty() { "none".to_owned() } else { present.join(", ") };
            let wanted = opening.name.clone().unwrap_or_else(|| "any".to_owned());
            return Err(SplatError::NoAdapter { wanted, present });
        };
        let (adapter, info) = (describe(found), found.get_info());
        let mut useful = wgpu::Features::TIMESTAMP_QUERY | wgpu::Features::PIPELINE_CACHE;
        let sizes = info.subgroup_min_size..=info.subgroup_max_size;
        if !opening.plain && [sizes.start(), sizes.end()].iter().all(|s| SUBGROUP_SIZES.contains(s)) {
            useful |= wgpu::Features::SUBGROUP;
        }
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("splat"),
            required_features: found.features() & useful,
            required_limits: limits(found, opening.binding),
            memory_hints: wgpu::MemoryHints::MemoryUsage,
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(found.request_device(&descriptor))
            .map_err(|e| SplatError::Gpu { adapter: adapter.name.clone(), reason: e.to_string() })?;
        let failure = Arc::new(Mutex::new(None));
        let slot = failure.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| note(&slot, error.to_string())));
        let slot = failure.clone();
        device.set_device_lost_callback(move |reason, text| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                note(&slot, format!("the device was lost: {text}"));
            }
        });
        let pipelines = Pipelines::open(&device, &info);
        let mut gpu = Self { device, queue, adapter, subgroups: false, pipelines, failure };
        gpu.subgroups = gpu.device.features().contains(wgpu::Features::SUBGROUP) && gpu.lanes_in_order()?;
        Ok(gpu)
    }

    /// Whether the lanes of subgroups are the threads of a group in order, as the kernels take them
    /// to be. No specification says so; hence a look.
    fn lanes_in_order(&self) -> Result<bool, SplatError> {
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("lanes"),
            source: wgpu::ShaderSource::Wgsl(LANES.into()),
        });
        let pipeline = self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("lanes"),
            layout: None,
            module: &module,
            entry_point: Some("main"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: self.pipelines.as_ref().map(Pipelines::cache),
        });
        let wrong = self.buffer("lanes", 4, None)?;
        let bound = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("lanes"),
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: wrong.as_entire_binding() }],
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bound, &[]);
        pass.dispatch_workgroups(4, 1, 1);
        drop(pass);
        self.queue.submit([encoder.finish()]);
        Ok(self.read::<u32>(&wrong, 0, 1)?[0] == 0)
    }

    /// An error if anything went wrong since the device was opened.
    pub(crate) fn check(&self) -> Result<(), SplatError> {
        let failure = self.failure.lock().ok().and_then(|f| f.clone());
        failure.map_or(Ok(()), |reason| Err(self.error(reason)))
    }

    /// An error of this adapter.
    pub(crate) fn error(&self, reason: impl Into<String>) -> SplatError {
        SplatError::Gpu { adapter: self.adapter.name.clone(), reason: reason.into() }
    }
}

impl Gpu {
    /// Bytes that a buffer may have so that a kernel can see all of it.
    pub(crate) fn largest_buffer(&self) -> u64 {
        let limits = self.device.limits();
        limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
    }

    /// A storage buffer of `bytes` (that can also be copied and be a uniform); `old` where it has
    /// that size already.
    pub(crate) fn buffer(
        &self,
        name: &str,
        bytes: u64,
        old: Option<wgpu::Buffer>,
    ) -> Result<wgpu::Buffer, SplatError> {
        if let Some(old) = old.filter(|o| o.size() == bytes) {
            return Ok(old);
        }
        let most = self.largest_buffer();
        if bytes > most {
            return Err(self.error(format!(
                "{name} needs {} MiB, but a buffer may have {} MiB",
                bytes >> 20,
                most >> 20
            )));
        }
        let scope = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let mut usage =
            wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        if bytes <= self.device.limits().max_uniform_buffer_binding_size {
            usage |= wgpu::BufferUsages::UNIFORM;
        }
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(name),
            size: bytes,
            usage,
            mapped_at_creation: false,
        });
        match pollster::block_on(scope.pop()) {
            Some(_) => Err(self.error(format!("no memory for {name} ({} MiB)", bytes >> 20))),
            None => Ok(buffer),
        }
    }

    /// A uniform that stays as it is.
    pub(crate) fn uniform<T: bytemuck::Pod>(&self, value: T) -> Result<wgpu::Buffer, SplatError> {
        let buffer = self.buffer("uniform", size_of::<T>() as u64, None)?;
        self.write(&buffer, 0, &[value]);
        Ok(buffer)
    }

    /// Waits until all that was submitted is done, so that what it used can be freed.
    pub(crate) fn wait(&self) -> Result<(), SplatError> {
        let waited = self.device.poll(wgpu::PollType::wait_indefinitely());
        self.check()?;
        waited.map(|_| ()).map_err(|e| self.error(e.to_string()))
    }

    /// Writes `data` from byte `at` on.
    pub(crate) fn write<T: bytemuck::Pod>(&self, buffer: &wgpu::Buffer, at: u64, data: &[T]) {
        for (k, piece) in bytemuck::cast_slice::<T, u8>(data).chunks(PIECE as usize).enumerate() {
            self.queue.write_buffer(buffer, at + k as u64 * PIECE, piece);
            if piece.len() as u64 == PIECE {
                self.queue.submit([]); // so that the pieces' staging memory can be used again
            }
        }
    }

    /// The first `count` values from byte `at` on.
    pub(crate) fn read<T: bytemuck::Pod>(
        &self,
        buffer: &wgpu::Buffer,
        at: u64,
        count: usize,
    ) -> Result<Vec<T>, SplatError> {
        let total = (count * size_of::<T>()) as u64;
        let mut out = vec![T::zeroed(); count];
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut out);
        if total == 0 {
            return Ok(out);
        }
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read"),
            size: total.min(PIECE),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        for (k, piece) in bytes.chunks_mut(PIECE as usize).enumerate() {
            let mut encoder = self.device.create_command_encoder(&Default::default());
            let from = at + k as u64 * PIECE;
            encoder.copy_buffer_to_buffer(buffer, from, &staging, 0, piece.len() as u64);
            self.queue.submit([encoder.finish()]);
            self.fetch(&staging, piece)?;
        }
        Ok(out)
    }

    /// Waits for the device and copies the beginning of a mappable buffer.
    pub(crate) fn fetch(&self, staging: &wgpu::Buffer, into: &mut [u8]) -> Result<(), SplatError> {
        let range = 0..into.len() as u64;
        staging.map_async(wgpu::MapMode::Read, range.clone(), |_| ());
        let waited = self.device.poll(wgpu::PollType::wait_indefinitely());
        self.check()?;
        waited.map_err(|e| self.error(e.to_string()))?;
        let view = staging.get_mapped_range(range).map_err(|e| self.error(e.to_string()))?;
        into.copy_from_slice(&view);
        drop(view);
        staging.unmap();
        Ok(())
    }
}
