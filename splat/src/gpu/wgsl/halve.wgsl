// halve: the Gaussians of a page that come from a split take their places and scales; `source` and
// how: split.wgsl.

struct Job {
    first: u32,
    count: u32,
    stride: u32,
    iteration: u32,
    seed: u32,
    spare0: u32,
    spare1: u32,
    spare2: u32,
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> source: array<u32>;
@group(0) @binding(2) var<storage, read_write> geometry: array<f32>;

fn plane(k: u32, l: u32) -> f32 {
    return geometry[k * job.stride + l];
}

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let l = group_number(group, groups) * 256u + local;
    if (l >= job.count || (source[job.first + l] & FRESH) == 0u) {
        return;
    }
    let origin = source[job.first + l];
    let mean = vec3<f32>(plane(0u, l), plane(1u, l), plane(2u, l));
    let log_scale = vec3<f32>(plane(3u, l), plane(4u, l), plane(5u, l));
    let q = vec4<f32>(plane(6u, l), plane(7u, l), plane(8u, l), plane(9u, l));
    let half = half_of(origin & NUMBER, select(1.0, -1.0, (origin & CHILD) != 0u), mean, log_scale, q);
    for (var k = 0u; k < 3u; k++) {
        geometry[k * job.stride + l] = half.mean[k];
        geometry[(3u + k) * job.stride + l] = half.log_scale[k];
    }
}
