// pairs: the Gaussian-tile pairs, in order of depth.
// count: for the Gaussian of rank r, how many tiles it touches -> counts [N]; then scanned.
// emit:  its pairs -> keys [pairs] tile · owners [pairs] Gaussian; spans [N] (first, end) of the
// Gaussian's pairs. A tile is touched where the ellipse alpha >= 1/255 reaches it: the least of the
// quadratic form over the tile's rectangle lies at the centre or on an edge that faces it, where it
// is a parabola's lowest point.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> boxes: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> counts: array<u32>;
@group(0) @binding(6) var<storage, read_write> keys: array<u32>;
@group(0) @binding(7) var<storage, read_write> owners: array<u32>;
@group(0) @binding(8) var<storage, read_write> spans: array<vec2<u32>>;

fn touches(a: vec4<f32>, b: vec4<f32>, tile: vec2<u32>) -> bool {
    let low = vec2<f32>(tile * TILE) - a.xy;
    let high = low + vec2<f32>(f32(TILE));
    let nearest = clamp(vec2<f32>(0.0), low, high);
    if (all(nearest == vec2<f32>(0.0))) {
        return true;
    }
    let xx = a.z; let xy = a.w; let yy = b.x;
    // On the facing vertical edge and on the facing horizontal one.
    let y = clamp(-xy * nearest.x / yy, low.y, high.y);
    let x = clamp(-xy * nearest.y / xx, low.x, high.x);
    var least = 3e38;
    if (nearest.x != 0.0) {
        least = 0.5 * (xx * nearest.x * nearest.x + yy * y * y) + xy * nearest.x * y;
    }
    if (nearest.y != 0.0) {
        least = min(least, 0.5 * (xx * x * x + yy * nearest.y * nearest.y) + xy * x * nearest.y);
    }
    let terms = xx * dot(nearest, nearest) + yy * dot(nearest, nearest);
    return least <= log(b.y / MIN_ALPHA) + 1e-3 + 1e-5 * terms;
}

@compute @workgroup_size(256)
fn count(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let rank = group_number(group, groups) * 256u + local;
    if (rank >= frame.n) {
        return;
    }
    var sum = 0u;
    if (rank < counters[VISIBLE]) {
        let i = order[rank];
        let a = records[2u * i];
        let b = records[2u * i + 1u];
        let box = boxes[i];
        for (var y = box.x >> 16u; y < (box.y >> 16u); y++) {
            for (var x = box.x & 0xffffu; x < (box.y & 0xffffu); x++) {
                sum += select(0u, 1u, touches(a, b, vec2<u32>(x, y)));
            }
        }
    }
    counts[rank] = sum;
}

@compute @workgroup_size(256)
fn emit(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let rank = group_number(group, groups) * 256u + local;
    if (rank >= min(counters[VISIBLE], frame.n)) {
        return;
    }
    let i = order[rank];
    let a = records[2u * i];
    let b = records[2u * i + 1u];
    let box = boxes[i];
    var at = counts[rank];
    var end = counters[PAIRS];
    if (rank + 1u < frame.n) {
        end = counts[rank + 1u];
    }
    end = min(end, frame.pair_capacity);
    let first = at;
    for (var y = box.x >> 16u; y < (box.y >> 16u); y++) {
        for (var x = box.x & 0xffffu; x < (box.y & 0xffffu); x++) {
            if (at < end && touches(a, b, vec2<u32>(x, y))) {
                keys[at] = y * frame.tiles.x + x;
                owners[at] = i;
                at++;
            }
        }
    }
    // Should rounding differ from that of `count`, the rest goes to no tile.
    for (; at < end; at++) {
        keys[at] = frame.tiles.x * frame.tiles.y;
        owners[at] = i;
    }
    spans[i] = vec2<u32>(min(first, end), end);
}
