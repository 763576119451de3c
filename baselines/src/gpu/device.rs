//! Buffers, modules in WGSL and batches of dispatches on a graphics adapter: the only file of this
//! crate that knows wgpu.

use crate::error::FieldError;
use bytemuck::Pod;
use splat::{BackendChoice, DeviceConfig};
use std::sync::{Arc, Mutex};

/// Bytes between the uniforms of a batch.
/// Source: the largest alignment of uniforms that WebGPU lets an adapter ask for.
const JOB: usize = 256;
/// Most groups along a side of a dispatch. Source: WebGPU's default limits.
const MOST_GROUPS: u32 = 65_535;

/// An open adapter.
pub(crate) struct FieldDevice {
    device: wgpu::Device,
    queue: wgpu::Queue,
    name: String,
    failure: Arc<Mutex<Option<String>>>,
}

/// Memory of an adapter.
#[derive(Clone, Debug)]
pub(crate) struct DeviceArray(wgpu::Buffer);

/// A compiled module: its uniform, then storage buffers.
pub(crate) struct FieldKernel {
    layout: wgpu::BindGroupLayout,
    pipelines: Vec<wgpu::ComputePipeline>,
}

/// What a module is made of.
pub(crate) struct FieldSource {
    pub(crate) name: &'static str,
    /// The files that make it up, in order.
    pub(crate) parts: &'static [&'static str],
    /// Bindings 1, 2, … of group 0: `w` is written, `r` only read.
    pub(crate) bindings: &'static str,
    pub(crate) entries: &'static [&'static str],
}

/// Dispatches that are submitted together and run in order.
pub(crate) struct FieldBatch<'a> {
    device: &'a FieldDevice,
    jobs: Vec<u8>,
    commands: Vec<FieldCommand<'a>>,
}

enum FieldCommand<'a> {
    Run { kernel: &'a FieldKernel, entry: usize, buffers: Vec<wgpu::Buffer>, groups: [u32; 3], job: usize },
    Clear(wgpu::Buffer),
}

/// Groups of a one-dimensional dispatch of `threads`, folded into y where they are too many for x.
pub(crate) fn folded(threads: usize, group: usize) -> [u32; 3] {
    let groups = u32::try_from(threads.div_ceil(group)).unwrap_or(u32::MAX);
    let width = groups.min(MOST_GROUPS);
    [width, if width == 0 { 0 } else { groups.div_ceil(width) }, 1]
}

fn error(adapter: &str, reason: impl ToString) -> FieldError {
    splat::SplatError::Gpu { adapter: adapter.to_owned(), reason: reason.to_string() }.into()
}

impl FieldDevice {
    /// What the configuration asks for: an adapter, or the processor (`None`). Without a wish it is
    /// the first graphics card, if there is one that works.
    pub(crate) fn open(config: &DeviceConfig) -> Result<Option<Self>, FieldError> {
        let wanted = config.backend == BackendChoice::Gpu || config.gpu.is_some();
        if config.backend == BackendChoice::Cpu {
            return Ok(None);
        }
        let name = config.gpu.clone().unwrap_or_default().to_lowercase();
        let all = splat::adapters();
        let mut usable = all.iter().filter(|a| wanted || a.kind.is_hardware());
        let Some(found) = usable.find(|a| a.name.to_lowercase().contains(&name)) else {
            if !wanted {
                return Ok(None);
            }
            let present: Vec<String> = all.iter().map(ToString::to_string).collect();
            let present = if present.is_empty() { "none".to_owned() } else { present.join(", ") };
            let wanted = config.gpu.clone().unwrap_or_else(|| "any".to_owned());
            return Err(splat::SplatError::NoAdapter { wanted, present }.into());
        };
        match Self::of(&found.name, &found.to_string()) {
            Err(_) if !wanted => Ok(None),
            opened => opened.map(Some),
        }
    }

    /// Opens the adapter of a name, which is `words` to the user.
    fn of(name: &str, words: &str) -> Result<Self, FieldError> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
            backends: wgpu::Backends::PRIMARY,
            // Software adapters such as llvmpipe do not always claim conformance.
            flags: wgpu::InstanceFlags::ALLOW_UNDERLYING_NONCOMPLIANT_ADAPTER,
            ..wgpu::InstanceDescriptor::new_without_display_handle()
        });
        let all = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY));
        let found = all.into_iter().find(|a| a.get_info().name == name);
        let found = found.ok_or_else(|| error(name, "it is gone"))?;
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("fields"),
            required_limits: wgpu::Limits {
                max_storage_buffer_binding_size: found.limits().max_storage_buffer_binding_size,
                max_buffer_size: found.limits().max_buffer_size,
                ..wgpu::Limits::default()
            },
            ..Default::default()
        };
        let opened = pollster::block_on(found.request_device(&descriptor));
        let (device, queue) = opened.map_err(|e| error(name, e))?;
        let failure = Arc::new(Mutex::new(None));
        let slot = failure.clone();
        device.on_uncaptured_error(Arc::new(move |e: wgpu::Error| note(&slot, e.to_string())));
        let slot = failure.clone();
        device.set_device_lost_callback(move |reason, text| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                note(&slot, format!("the device was lost: {text}"));
            }
        });
        Ok(Self { device, queue, name: words.to_owned(), failure })
    }

    /// The adapter, in words.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// An error of this adapter.
    pub(crate) fn error(&self, reason: &str) -> FieldError {
        error(&self.name, reason)
    }

    /// An error if anything went wrong since the device was opened.
    fn check(&self) -> Result<(), FieldError> {
        let failure = self.failure.lock().ok().and_then(|f| f.clone());
        failure.map_or(Ok(()), |reason| Err(error(&self.name, reason)))
    }

    /// Compiles a module.
    pub(crate) fn kernel(&self, source: &FieldSource) -> Result<FieldKernel, FieldError> {
        let kinds = std::iter::once(wgpu::BufferBindingType::Uniform)
            .chain(source.bindings.chars().map(|c| wgpu::BufferBindingType::Storage { read_only: c == 'r' }));
        let entries: Vec<wgpu::BindGroupLayoutEntry> = (0..)
            .zip(kinds)
            .map(|(binding, ty)| wgpu::BindGroupLayoutEntry {
                binding,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
                count: None,
            })
            .collect();
        let label = Some(source.name);
        let layout = self
            .device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label, entries: &entries });
        let pipeline_layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label,
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let text = source.parts.concat();
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label,
            source: wgpu::ShaderSource::Wgsl(text.into()),
        });
        let pipelines = source.entries.iter().map(|entry| {
            self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label,
                layout: Some(&pipeline_layout),
                module: &module,
                entry_point: Some(entry),
                // Every kernel writes its shared memory before it reads it.
                compilation_options: wgpu::PipelineCompilationOptions {
                    zero_initialize_workgroup_memory: false,
                    ..Default::default()
                },
                cache: None,
            })
        });
        let kernel = FieldKernel { layout, pipelines: pipelines.collect() };
        self.check()?;
        Ok(kernel)
    }

    /// Memory of so many values of four bytes, of zeros.
    pub(crate) fn array(&self, name: &str, count: usize) -> Result<DeviceArray, FieldError> {
        let bytes = (4 * count).next_multiple_of(16).max(16) as u64;
        let limits = self.device.limits();
        let most = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        if bytes > most {
            let (needs, most) = (bytes >> 20, most >> 20);
            return Err(error(&self.name, format!("{name} needs {needs} MiB of at most {most} MiB")));
        }
        let scope = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(name),
            size: bytes,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        match pollster::block_on(scope.pop()) {
            Some(_) => Err(error(&self.name, format!("no memory for {name} ({} MiB)", bytes >> 20))),
            None => Ok(DeviceArray(buffer)),
        }
    }

    /// Memory that holds `data`.
    pub(crate) fn filled<T: Pod>(&self, name: &str, data: &[T]) -> Result<DeviceArray, FieldError> {
        let array = self.array(name, size_of_val(data) / 4)?;
        self.write(&array, data);
        Ok(array)
    }

    /// Memory for `count` values at least: what there is, if it is large enough.
    pub(crate) fn grown(&self, array: &mut DeviceArray, count: usize) -> Result<(), FieldError> {
        if array.0.size() < 4 * count as u64 {
            *array = self.array("samples", count)?;
        }
        Ok(())
    }

    /// Writes the beginning of an array, before all batches that are submitted later.
    pub(crate) fn write<T: Pod>(&self, array: &DeviceArray, data: &[T]) {
        self.queue.write_buffer(&array.0, 0, bytemuck::cast_slice(data));
    }

    /// The first `count` values of an array, after all that was submitted.
    pub(crate) fn read<T: Pod>(&self, array: &DeviceArray, count: usize) -> Result<Vec<T>, FieldError> {
        let bytes = (count * size_of::<T>()) as u64;
        if bytes == 0 {
            return Ok(Vec::new());
        }
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read"),
            size: bytes,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(&array.0, 0, &staging, 0, bytes);
        self.queue.submit([encoder.finish()]);
        staging.map_async(wgpu::MapMode::Read, 0..bytes, |_| ());
        let waited = self.device.poll(wgpu::PollType::wait_indefinitely());
        self.check()?;
        waited.map_err(|e| error(&self.name, e))?;
        let view = staging.get_mapped_range(0..bytes).map_err(|e| error(&self.name, e))?;
        let mut out = vec![T::zeroed(); count];
        bytemuck::cast_slice_mut::<T, u8>(&mut out).copy_from_slice(&view);
        Ok(out)
    }

    /// An empty batch.
    pub(crate) fn batch(&self) -> FieldBatch<'_> {
        FieldBatch { device: self, jobs: Vec::new(), commands: Vec::new() }
    }
}

/// Keeps the first failure.
fn note(failure: &Mutex<Option<String>>, text: String) {
    if let Ok(mut failure) = failure.lock() {
        failure.get_or_insert(text);
    }
}

impl<'a> FieldBatch<'a> {
    /// Runs an entry point; binding 0 is `job`, the others are `arrays`.
    pub(crate) fn run<T: Pod>(
        &mut self,
        (kernel, entry): (&'a FieldKernel, usize),
        job: &T,
        arrays: &[&DeviceArray],
        groups: [u32; 3],
    ) {
        if groups.contains(&0) {
            return;
        }
        let at = self.jobs.len();
        self.jobs.extend_from_slice(bytemuck::bytes_of(job));
        self.jobs.resize(at + JOB, 0);
        let buffers = arrays.iter().map(|a| a.0.clone()).collect();
        self.commands.push(FieldCommand::Run { kernel, entry, buffers, groups, job: at });
    }

    /// Fills an array with zeros.
    pub(crate) fn clear(&mut self, array: &DeviceArray) {
        self.commands.push(FieldCommand::Clear(array.0.clone()));
    }

    /// Hands the work over; says what went wrong so far.
    pub(crate) fn submit(self) -> Result<(), FieldError> {
        let device = &self.device.device;
        let jobs = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("jobs"),
            size: self.jobs.len().max(JOB) as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        self.device.queue.write_buffer(&jobs, 0, &self.jobs);
        let mut encoder = device.create_command_encoder(&Default::default());
        for command in &self.commands {
            match command {
                FieldCommand::Clear(buffer) => encoder.clear_buffer(buffer, 0, None),
                FieldCommand::Run { kernel, entry, buffers, groups: [x, y, z], job } => {
                    let bound = bind(device, kernel, (&jobs, *job), buffers);
                    let mut pass = encoder.begin_compute_pass(&Default::default());
                    pass.set_pipeline(&kernel.pipelines[*entry]);
                    pass.set_bind_group(0, &bound, &[]);
                    pass.dispatch_workgroups(*x, *y, *z);
                }
            }
        }
        self.device.queue.submit([encoder.finish()]);
        self.device.check()
    }
}

/// Binds a job and buffers.
fn bind(
    device: &wgpu::Device,
    kernel: &FieldKernel,
    (jobs, at): (&wgpu::Buffer, usize),
    buffers: &[wgpu::Buffer],
) -> wgpu::BindGroup {
    let size = wgpu::BufferSize::new(JOB as u64);
    let uniform = wgpu::BufferBinding { buffer: jobs, offset: at as u64, size };
    let resources = std::iter::once(wgpu::BindingResource::Buffer(uniform))
        .chain(buffers.iter().map(wgpu::Buffer::as_entire_binding));
    let entries: Vec<wgpu::BindGroupEntry> =
        (0..).zip(resources).map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
    let descriptor = wgpu::BindGroupDescriptor { label: None, layout: &kernel.layout, entries: &entries };
    device.create_bind_group(&descriptor)
}
