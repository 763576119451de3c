//! What an adapter moves and computes at best, measured: the floors that kernels are held against.

use super::context::Gpu;
use crate::error::SplatError;
use std::time::Instant;

/// Each thread: 16 chains of fused multiply-adds, `ROUNDS` long.
const COMPUTE: &str = "
@group(0) @binding(0) var<storage, read_write> out: array<vec4<f32>>;
@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let x = vec4<f32>(f32(id.x & 7u)) * 1e-3 + 0.5;
    var a = x; var b = x + 0.1; var c = x + 0.2; var d = x + 0.3;
    for (var k = 0u; k < 256u; k++) {
        a = fma(a, x, b); b = fma(b, x, c); c = fma(c, x, d); d = fma(d, x, a);
    }
    out[id.x & 4095u] = a + b + c + d;
}
";
/// Each thread copies vectors of four: buffer copies may run on an engine of their own, slower than
/// what kernels reach.
const COPY: &str = "
@group(0) @binding(0) var<storage, read> a: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read_write> b: array<vec4<f32>>;
@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < arrayLength(&b); i += 256u * groups.x) {
        b[i] = a[i];
    }
}
";
/// Rounds of [`COMPUTE`]. Source: its loop.
const ROUNDS: f64 = 256.0;

/// What an adapter does at best.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct AdapterLimits {
    /// Of a copy: read and written.
    pub bytes_a_second: f64,
    /// Of f32; a fused multiply-add is two.
    pub flop_a_second: f64,
}

impl AdapterLimits {
    /// Measures it, in about a second on a card.
    pub(crate) fn measure(gpu: &Gpu) -> Result<Self, SplatError> {
        let hardware = gpu.adapter.kind.is_hardware();
        let bytes: u64 = (if hardware { 1u64 << 30 } else { 1 << 24 }).min(gpu.largest_buffer() / 4 * 4);
        let [from, to] = [gpu.buffer("from", bytes, None)?, gpu.buffer("to", bytes, None)?];
        let copies = if hardware { 20 } else { 2 };
        let groups: u32 = if hardware { 60_000 } else { 60 };
        let copied = best(gpu, &Probe::new(gpu, COPY, &[&from, &to]), groups, copies)?;
        let out = gpu.buffer("out", 4096 * 16, None)?;
        let computed = best(gpu, &Probe::new(gpu, COMPUTE, &[&out]), groups, 1)?;
        let operations = f64::from(groups) * 256.0 * ROUNDS * 16.0 * 2.0;
        let bytes_a_second = 2.0 * bytes as f64 * f64::from(copies) / copied;
        Ok(Self { bytes_a_second, flop_a_second: operations / computed })
    }
}

/// A kernel that measures.
struct Probe {
    pipeline: wgpu::ComputePipeline,
    bound: wgpu::BindGroup,
}

impl Probe {
    fn new(gpu: &Gpu, source: &str, buffers: &[&wgpu::Buffer]) -> Self {
        let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: None,
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
        let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: None,
            layout: None,
            module: &module,
            entry_point: None,
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        });
        let entries: Vec<_> = (0..)
            .zip(buffers)
            .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        let bound = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        Self { pipeline, bound }
    }
}

/// Seconds of the fastest of five submissions, each of `times` dispatches.
fn best(gpu: &Gpu, probe: &Probe, groups: u32, times: u32) -> Result<f64, SplatError> {
    let mut least = f64::INFINITY;
    for _ in 0..5 {
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&probe.pipeline);
        pass.set_bind_group(0, &probe.bound, &[]);
        (0..times).for_each(|_| pass.dispatch_workgroups(groups, 1, 1));
        drop(pass);
        let clock = Instant::now();
        gpu.queue.submit([encoder.finish()]);
        gpu.wait()?;
        least = least.min(clock.elapsed().as_secs_f64());
    }
    Ok(least)
}
