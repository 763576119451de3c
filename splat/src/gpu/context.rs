//! Adapters and devices.

use crate::SplatError;
use crate::adapter::{Adapter, AdapterKind};
use std::sync::{Arc, Mutex};

/// Bytes of a transfer at a time.
const PIECE: u64 = 64 << 20;

/// The adapters of this machine, hardware first.
pub fn adapters() -> Vec<Adapter> {
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
    let rank = |kind| match kind {
        AdapterKind::Discrete => 0,
        AdapterKind::Virtual => 1,
        AdapterKind::Integrated => 2,
        AdapterKind::Unknown => 3,
        AdapterKind::Software => 4,
    };
    found.sort_by_key(|a| rank(kind(a.get_info().device_type)));
    found
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

/// An open adapter.
pub struct Gpu {
    /// Makes buffers and pipelines.
    pub device: wgpu::Device,
    /// Takes work.
    pub queue: wgpu::Queue,
    /// What it is.
    pub adapter: Adapter,
    failure: Arc<Mutex<Option<String>>>,
}

impl Gpu {
    /// Opens the first adapter whose name contains `name` (any case), or simply the first, with all that it can do.
    pub fn open(name: Option<&str>) -> Result<Self, SplatError> {
        let wanted = name.unwrap_or_default().to_lowercase();
        let all = enumerate();
        let found = all.iter().find(|a| a.get_info().name.to_lowercase().contains(&wanted));
        let Some(found) = found else {
            let present: Vec<String> = all.iter().map(|a| describe(a).to_string()).collect();
            let present = if present.is_empty() { "none".to_owned() } else { present.join(", ") };
            return Err(SplatError::NoAdapter { wanted: name.unwrap_or("any").to_owned(), present });
        };
        let adapter = describe(found);
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("splat"),
            required_features: found.features() & wgpu::Features::TIMESTAMP_QUERY,
            required_limits: found.limits(),
            memory_hints: wgpu::MemoryHints::MemoryUsage,
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(found.request_device(&descriptor))
            .map_err(|e| SplatError::Gpu { adapter: adapter.name.clone(), reason: e.to_string() })?;
        let failure = Arc::new(Mutex::new(None));
        let note = |slot: &Arc<Mutex<Option<String>>>, text: String| {
            if let Ok(mut failure) = slot.lock() {
                failure.get_or_insert(text);
            }
        };
        let slot = failure.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| note(&slot, error.to_string())));
        let slot = failure.clone();
        device.set_device_lost_callback(move |reason, text| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                note(&slot, format!("the device was lost: {text}"));
            }
        });
        Ok(Self { device, queue, adapter, failure })
    }

    /// An error if anything went wrong since the device was opened.
    pub fn check(&self) -> Result<(), SplatError> {
        let failure = self.failure.lock().ok().and_then(|f| f.clone());
        failure.map_or(Ok(()), |reason| Err(self.error(reason)))
    }

    /// An error of this adapter.
    pub fn error(&self, reason: impl Into<String>) -> SplatError {
        SplatError::Gpu { adapter: self.adapter.name.clone(), reason: reason.into() }
    }
}

impl Gpu {
    /// Bytes that a buffer may have so that a kernel can see all of it.
    pub fn largest_buffer(&self) -> u64 {
        let limits = self.device.limits();
        limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
    }

    /// A storage buffer of `bytes` (that can also be copied and be a uniform); `old` where it has that size already.
    pub fn buffer(
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

    /// Writes `data` from byte `at` on.
    pub fn write<T: bytemuck::Pod>(&self, buffer: &wgpu::Buffer, at: u64, data: &[T]) {
        for (k, piece) in bytemuck::cast_slice::<T, u8>(data).chunks(PIECE as usize).enumerate() {
            self.queue.write_buffer(buffer, at + k as u64 * PIECE, piece);
            if piece.len() as u64 == PIECE {
                self.queue.submit([]); // so that the pieces' staging memory can be used again
            }
        }
    }

    /// The first `count` values from byte `at` on.
    pub fn read<T: bytemuck::Pod>(
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
    pub fn fetch(&self, staging: &wgpu::Buffer, into: &mut [u8]) -> Result<(), SplatError> {
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
