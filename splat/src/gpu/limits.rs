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
        let copied = best(gpu, &mut |encoder| {
            for _ in 0..copies {
                encoder.copy_buffer_to_buffer(&from, 0, &to, 0, bytes);
            }
        })?;
        let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: None,
            source: wgpu::ShaderSource::Wgsl(COMPUTE.into()),
        });
        let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: None,
            layout: None,
            module: &module,
            entry_point: None,
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        });
        let out = gpu.buffer("out", 4096 * 16, None)?;
        let bound = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: out.as_entire_binding() }],
        });
        let groups: u32 = if hardware { 60_000 } else { 60 };
        let computed = best(gpu, &mut |encoder| {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &bound, &[]);
            pass.dispatch_workgroups(groups, 1, 1);
        })?;
        let operations = f64::from(groups) * 256.0 * ROUNDS * 16.0 * 2.0;
        let bytes_a_second = 2.0 * bytes as f64 * f64::from(copies) / copied;
        Ok(Self { bytes_a_second, flop_a_second: operations / computed })
    }
}

/// Seconds of the fastest of five submissions.
fn best(gpu: &Gpu, encode: &mut dyn FnMut(&mut wgpu::CommandEncoder)) -> Result<f64, SplatError> {
    let mut least = f64::INFINITY;
    for _ in 0..5 {
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        encode(&mut encoder);
        let clock = Instant::now();
        gpu.queue.submit([encoder.finish()]);
        gpu.wait()?;
        least = least.min(clock.elapsed().as_secs_f64());
    }
    Ok(least)
}
