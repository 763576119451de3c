// ranges: where each tile's pairs begin and end, and whose they are.
// in: keys [pairs] tiles, ascending · values [pairs] pair numbers in that order · owners [pairs]
// Gaussian of each number
// out: ranges [tiles + 1] (begin, end, 0, 0), half-open (cleared before); the last one: pairs of no
// tile
//      after them: of each block of SPAN pairs (tile of its first, end of all pairs, 0, 0)
//      sorted [pairs] (Gaussian, pair number) in order of tiles, so that the pixels' kernels look
//      up once

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<u32>;
@group(0) @binding(3) var<storage, read> values: array<u32>;
@group(0) @binding(4) var<storage, read> owners: array<u32>;
@group(0) @binding(5) var<storage, read_write> ranges: array<vec4<u32>>;
@group(0) @binding(6) var<storage, read_write> sorted: array<vec2<u32>>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let i = group_number(group, groups) * 256u + local;
    let n = min(counters[PAIRS], frame.pair_capacity);
    if (i >= n) {
        return;
    }
    sorted[i] = vec2<u32>(owners[values[i]], values[i]);
    let tile = keys[i];
    if (i % SPAN == 0u) {
        ranges[frame.tiles.x * frame.tiles.y + 1u + i / SPAN] = vec4<u32>(tile, n, 0u, 0u);
    }
    if (i == 0u || keys[i - 1u] != tile) {
        ranges[tile].x = i;
    }
    if (i + 1u == n || keys[i + 1u] != tile) {
        ranges[tile].y = i + 1u;
    }
}
