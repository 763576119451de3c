// rasterise_backward: dL/d(colour) of a tile's pixels -> sums for each of its Gaussians, replayed
// front to back. A group takes a block of SPAN pairs, whatever tiles they belong to, so that no
// tile's list, however long, keeps the others waiting (as in Taming 3DGS, Mallick 2024, section
// 4.3, where a subgroup takes 32 pairs); `rasterise` has kept the pixels' states where it begins.
// in: records · colours · sorted [pairs] (Gaussian, pair number) by tile · ranges [tiles + 1]
// (begin, end, used, -), then [blocks] (tile of the first pair, end of all pairs, -, -)
//      gradient [H * W] (dL/d(rgb), C . dL/d(rgb) of the pixel's colour C), then [blocks][256]
//      (rgb of what lies before the block, transmittance; 0: finished)
// out: sums [pairs][10] in arrays of four, four and two, at the pair's number, so that a Gaussian's
// pairs lie side by side and no atomics are needed:
//      with v = alpha dL/d(alpha), d = xy - pixel: v, v dx, v dy, v dx^2, v dx
//      dy, v dy^2, T alpha dL/d(rgb) (3), T alpha
//
// Eight Gaussians at a time: each thread follows its pixel and leaves T alpha and v of each of the
// eight in `left`; then 32 threads a Gaussian add up eight pixels of a column each; then the 32 are
// added up, across the subgroup where the adapter has such operations, and by one thread a sum
// where not. v = alpha (T rgb . g - behind / (1 - alpha)), behind = g . (what lies behind, the
// background too): Kerbl 2023.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> colours: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> sorted: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> ranges: array<vec4<u32>>;
@group(0) @binding(5) var<storage, read> gradient: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> sums_a: array<f32>;
@group(0) @binding(7) var<storage, read_write> sums_b: array<f32>;
@group(0) @binding(8) var<storage, read_write> sums_c: array<f32>;

const SUMS: u32 = 10u;

// First T alpha [8][256], then v [8][256]; afterwards partial sums [10][256].
var<workgroup> left: array<f32, 4096>;

fn gradient_at(pixel: vec2<u32>) -> vec4<f32> {
    if (pixel.x >= frame.size.x || pixel.y >= frame.size.y) {
        return vec4<f32>(0.0);
    }
    return gradient[pixel.y * frame.size.x + pixel.x];
}

// Sum number `which` of a pair.
fn put(pair: u32, which: u32, sum: f32) {
    if (which < 4u) {
        sums_a[4u * pair + which] = sum;
    } else if (which < 8u) {
        sums_b[4u * pair + which - 4u] = sum;
    } else {
        sums_c[2u * pair + which - 8u] = sum;
    }
}

// One pixel past up to eight Gaussians from position `first`; `behind` and the transmittance are
// kept between calls. Loads wait for no test, so that all eight are under way at once.
fn follow(first: u32, count: u32, local: u32, centre: vec2<f32>, g: vec3<f32>, state: ptr<function, vec2<f32>>, finished: ptr<function, bool>) {
    for (var k = 0u; k < 8u; k++) {
        let i = sorted[first + min(k, count - 1u)].x;
        let a = records[2u * i];
        let b = records[2u * i + 1u];
        var weight = 0.0;
        var v = 0.0;
        let d = a.xy - centre;
        if (k < count && !*finished && abs(d.y) <= b.w) {
            let power = 0.5 * (a.z * d.x * d.x + b.x * d.y * d.y) + a.w * d.x * d.y;
            let raw = b.y * exp(-power);
            let alpha = min(MAX_ALPHA, raw);
            if (!(power < 0.0 || alpha < MIN_ALPHA)) {
                let t = (*state).x;
                let next = t * (1.0 - alpha);
                if (next < MIN_TRANSMITTANCE) {
                    *finished = true;
                } else {
                    weight = t * alpha;
                    let own = weight * dot(colours[i].xyz, g);
                    let behind = (*state).y - own;
                    v = select(0.0, own - alpha * behind / (1.0 - alpha), raw <= MAX_ALPHA);
                    *state = vec2<f32>(next, behind);
                }
            }
        }
        left[k * 256u + local] = weight;
        left[2048u + k * 256u + local] = v;
    }
}

// The pairs begin .. end of one tile; `continued`: they are not its first, and the pixels' states
// are those at the beginning of `block`.
//#if subgroups
fn replay(tile: u32, begin: u32, end: u32, continued: bool, block: u32, local: u32, subgroup_lane: u32, lanes: u32) {
//#else
fn replay(tile: u32, begin: u32, end: u32, continued: bool, block: u32, local: u32) {
//#endif
    let corner = vec2<u32>(tile % frame.tiles.x, tile / frame.tiles.x) * TILE;
    let pixel = corner + vec2<u32>(local % TILE, local / TILE);
    let inside = pixel.x < frame.size.x && pixel.y < frame.size.y;
    let g = gradient_at(pixel);
    var state = vec2<f32>(1.0, g.w);
    var finished = !inside;
    if (continued) {
        let kept = gradient[frame.size.x * frame.size.y + block * 256u + local];
        state = vec2<f32>(kept.w, g.w - dot(kept.xyz, g.xyz));
        finished = finished || kept.w <= 0.0;
    }

    // In the second part the thread adds up eight pixels of one column, two rows apart, for
    // Gaussian local / 32.
    let lane = local % 32u;
    let column = corner + vec2<u32>(lane % TILE, lane / TILE);
    var column_gradient: array<vec3<f32>, 8>;
    for (var j = 0u; j < 8u; j++) {
        column_gradient[j] = gradient_at(column + vec2<u32>(0u, 2u * j)).xyz;
    }

    for (var first = begin; first < end; first += 8u) {
        let count = min(8u, end - first);
        follow(first, count, local, vec2<f32>(pixel) + 0.5, g.xyz, &state, &finished);
        workgroupBarrier();

        let k = local / 32u;
        var a = vec4<f32>(0.0);
        if (k < count) {
            a = records[2u * sorted[first + k].x];
        }
        let d = a.xy - (vec2<f32>(column) + 0.5);
        var s = vec3<f32>(0.0);   // v, v dy, v dy^2
        var rgb = vec3<f32>(0.0);
        var total = 0.0;
        for (var j = 0u; j < 8u; j++) {
            let at = k * 256u + j * 32u + lane;
            let weight = left[at];
//#if subgroups
            // Most Gaussians reach few of the tile's rows.
            if (!subgroupAny(weight != 0.0)) {
                continue;
            }
//#endif
            let v = left[2048u + at];
            let dy = d.y - f32(2u * j);
            s += v * vec3<f32>(1.0, dy, dy * dy);
            rgb += weight * column_gradient[j];
            total += weight;
        }
        var all = array<f32, 10>(
            s.x, s.x * d.x, s.y, s.x * d.x * d.x, s.y * d.x, s.z,
            rgb.x, rgb.y, rgb.z, total,
        );
//#if subgroups
        // At most 32 lanes (the host sees to it), so that no subgroup spans two Gaussians.
        for (var n = 0u; n < SUMS; n++) {
            all[n] = subgroupAdd(all[n]);
        }
        workgroupBarrier();
        if (subgroup_lane == 0u) {
            for (var n = 0u; n < SUMS; n++) {
                left[(local / lanes) * SUMS + n] = all[n];
            }
        }
        workgroupBarrier();
        let which = local / SUMS;
        if (which < count) {
            let parts = 32u / lanes;
            var sum = 0.0;
            for (var j = 0u; j < parts; j++) {
                sum += left[(which * parts + j) * SUMS + local % SUMS];
            }
            put(sorted[first + which].y, local % SUMS, sum);
        }
//#else
        workgroupBarrier();
        for (var n = 0u; n < SUMS; n++) {
            left[n * 256u + local] = all[n];
        }
        workgroupBarrier();
        let which = local / SUMS;
        if (which < count) {
            var sum = 0.0;
            for (var j = 0u; j < 32u; j++) {
                sum += left[(local % SUMS) * 256u + which * 32u + (j + local) % 32u];
            }
            put(sorted[first + which].y, local % SUMS, sum);
        }
//#endif
        workgroupBarrier();
    }
}

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32/*lanes*/) {
    let block = group_number(group, groups);
    if (block * SPAN >= frame.pair_capacity) {
        return;
    }
    let entry = ranges[frame.tiles.x * frame.tiles.y + 1u + block];
    let end = min((block + 1u) * SPAN, entry.y);
    var tile = entry.x;
    var at = block * SPAN;
    while (at < end) {
        // Tiles that have no pairs have no end either. The last "tile" holds pairs that belong
        // nowhere: none of them is used.
        while (ranges[tile].y <= at) {
            tile++;
        }
        let own = ranges[tile];
        let stop = min(own.y, end);
        let used = clamp(own.x + own.z, at, stop);
        replay(tile, at, used, at > own.x, block, local/*use lanes*/);
        // What no pixel reached.
        for (var i = used + local; i < stop; i += 256u) {
            for (var s = 0u; s < SUMS; s++) {
                put(sorted[i].y, s, 0.0);
            }
        }
        at = stop;
    }
}
