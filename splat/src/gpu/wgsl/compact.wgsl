// compact: the Gaussians that are seen, by index.
// in: boxes [N] · positions [N] (scanned flags) · records · counters
// out: keys [visible] depth as bits, ascending as the depth is since it is positive · values
// [visible] index of the Gaussian

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> boxes: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> positions: array<u32>;
@group(0) @binding(3) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> keys: array<u32>;
@group(0) @binding(5) var<storage, read_write> values: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let i = group_number(group, groups) * 256u + local;
    if (i >= frame.n || boxes[i].y == 0u) {
        return;
    }
    let at = positions[i];
    keys[at] = bitcast<u32>(records[2u * i + 1u].z);
    values[at] = i;
}
