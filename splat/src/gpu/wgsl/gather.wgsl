// gather: planes of a page of the old model -> planes of a page of the new one, by `source`
// (split.wgsl).
// in: source [new N] · old [planes][stride] · out: new [planes][stride]; what comes from other old
// pages is left to them.

struct Job {
    first: u32,         // the new page
    count: u32,
    stride: u32,
    old_first: u32,     // the old page
    old_count: u32,
    old_stride: u32,
    planes: u32,
    clear_fresh: u32,   // from this plane on, what is FRESH begins at zero
    clear_all: u32,     // from this plane on, everything does
    spare0: u32,
    spare1: u32,
    spare2: u32,
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> source: array<u32>;
@group(0) @binding(2) var<storage, read> old: array<f32>;
@group(0) @binding(3) var<storage, read_write> fresh: array<f32>;

const FRESH: u32 = 0x40000000u;
const NUMBER: u32 = 0x3fffffffu;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let l = group_number(group, groups) * 256u + local;
    if (l >= job.count) {
        return;
    }
    let origin = source[job.first + l];
    let i = origin & NUMBER;
    if (i < job.old_first || i >= job.old_first + job.old_count) {
        return;
    }
    let clear = min(job.clear_all, select(job.planes, job.clear_fresh, (origin & FRESH) != 0u));
    for (var k = 0u; k < job.planes; k++) {
        fresh[k * job.stride + l] = select(0.0, old[k * job.old_stride + i - job.old_first], k < clear);
    }
}
