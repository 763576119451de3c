// loss: L = (1 - lambda) mean |C - G| + lambda (1 - SSIM) and dL/dC, in three dispatches:
// statistics (each of the three channels in z), differentiate, total. And for gains: products
// (channels in z), total_products. Equations and sources: reference/loss.rs.
// in: image [H * W] · goal [H * W] 8-bit rgb and mask
// out: by_mean, by_square, by_product [3][H * W] w dS/d(mu_x), w dS/d(E x^2), w dS/d(E xy) of each
// channel
//      image [H * W] becomes (dL/dC, C . dL/dC), which is all that rasterise_backward needs of the
//      picture
//      partial [3][tiles] vec4: sums of w S, w |C - G|, w (C - G)^2 · result[0]: their totals
//      after products: partial and result[channel] sums of w C G, w C^2, w G^2
// A group filters a tile of 16 x 16 with the 26 x 26 pixels around it, across and then down, in
// shared memory.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read_write> image: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> goal: array<u32>;
@group(0) @binding(3) var<storage, read_write> by_mean: array<f32>;
@group(0) @binding(4) var<storage, read_write> by_square: array<f32>;
@group(0) @binding(5) var<storage, read_write> by_product: array<f32>;
@group(0) @binding(6) var<storage, read_write> partial: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> result: array<vec4<f32>>;

const C1: f32 = 0.0001;
const C2: f32 = 0.0009;
const RADIUS: u32 = 5u;
const SIDE: u32 = 26u;
const HALO: u32 = 676u;
// exp(-d^2 / 4.5) for d = 0 .. 5, the window of 11 normalised to 1.
const WINDOW: array<f32, 6> = array<f32, 6>(0.26601171, 0.21300554, 0.10936069, 0.036000773, 0.0075987582, 0.0010283801);

var<workgroup> halo: array<vec2<f32>, 676>;      // statistics: x, y; gradient: two of the maps
var<workgroup> halo_third: array<f32, 676>;      // gradient: the third map
var<workgroup> across: array<vec4<f32>, 416>;    // 26 rows of 16

fn window(k: u32) -> f32 {
    var taps = WINDOW;
    return taps[u32(abs(i32(k) - i32(RADIUS)))];
}

struct Sample {
    x: f32,
    y: f32,
    weight: f32,
}

fn sample(pixel: vec2<i32>, channel: u32) -> Sample {
    if (pixel.x < 0 || pixel.y < 0 || pixel.x >= i32(frame.size.x) || pixel.y >= i32(frame.size.y)) {
        return Sample(0.0, 0.0, 0.0);
    }
    let at = u32(pixel.y) * frame.size.x + u32(pixel.x);
    let x = image[at][channel];
    let goal_rgba = unpack4x8unorm(goal[at]);
    var s = Sample(x, goal_rgba[channel] * frame.unit[channel], 1.0);
    if ((frame.flags & WEIGHTED) != 0u) {
        s.weight = goal_rgba.w;
        // What is ignored is taken to be as rendered, so that its neighbours' windows see no
        // difference.
        s.y = select(x, s.y, goal_rgba.w > 0.0);
    }
    if ((frame.flags & COVERAGE) != 0u) {
        let behind = frame.background[channel];
        s.y = behind + goal_rgba.w * (s.y - behind);
    }
    return s;
}

// Sum over the group, the same order always; the result is valid in thread 0.
fn group_sum(local: u32, value: vec4<f32>) -> vec4<f32> {
    workgroupBarrier();
    across[local] = value;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if (local < half) {
            across[local] += across[local + half];
        }
        workgroupBarrier();
    }
    return across[0];
}

@compute @workgroup_size(256)
fn statistics(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let channel = group.z;
    let tile = group_number(group, groups);
    let corner = vec2<i32>(vec2<u32>(tile % frame.tiles.x, tile / frame.tiles.x) * TILE);
    for (var i = local; i < HALO; i += 256u) {
        let s = sample(corner + vec2<i32>(i32(i % SIDE), i32(i / SIDE)) - i32(RADIUS), channel);
        halo[i] = vec2<f32>(s.x, s.y);
    }
    workgroupBarrier();
    for (var i = local; i < 416u; i += 256u) {
        var sum = vec4<f32>(0.0);
        for (var k = 0u; k < 11u; k++) {
            let v = halo[(i / TILE) * SIDE + i % TILE + k];
            sum += window(k) * vec4<f32>(v, dot(v, v), v.x * v.y);
        }
        across[i] = sum;
    }
    workgroupBarrier();
    var e = vec4<f32>(0.0);
    for (var k = 0u; k < 11u; k++) {
        e += window(k) * across[local + k * TILE];
    }
    let mx = e.x; let my = e.y;
    let a1 = 2.0 * mx * my + C1; let b1 = mx * mx + my * my + C1;
    let a2 = 2.0 * (e.w - mx * my) + C2; let b2 = e.z - mx * mx - my * my + C2;
    let inverse = 1.0 / (b1 * b2);
    let similarity = a1 * a2 * inverse;
    let pixel = corner + vec2<i32>(i32(local % TILE), i32(local / TILE));
    let own = sample(pixel, channel);
    let inside = pixel.x < i32(frame.size.x) && pixel.y < i32(frame.size.y);
    if (inside) {
        let plane = frame.size.x * frame.size.y;
        let at = channel * plane + u32(pixel.y) * frame.size.x + u32(pixel.x);
        by_mean[at] = own.weight * (2.0 * my * (a2 - a1) + 2.0 * mx * similarity * (b1 - b2)) * inverse;
        by_square[at] = -own.weight * similarity * b1 * inverse;
        by_product[at] = own.weight * 2.0 * a1 * inverse;
    }
    let difference = own.x - own.y;
    let sum = group_sum(local, own.weight * vec4<f32>(similarity, abs(difference), difference * difference, 0.0));
    if (local == 0u && tile < frame.tiles.x * frame.tiles.y) {
        partial[tile * 3u + channel] = sum;
    }
}

// dS/dC of a channel at the thread's pixel: the maps, filtered.
fn similarity_gradient(corner: vec2<i32>, local: u32, channel: u32, own: Sample) -> f32 {
    let plane = frame.size.x * frame.size.y;
    for (var i = local; i < HALO; i += 256u) {
        let pixel = corner + vec2<i32>(i32(i % SIDE), i32(i / SIDE)) - i32(RADIUS);
        halo[i] = vec2<f32>(0.0);
        halo_third[i] = 0.0;
        if (pixel.x >= 0 && pixel.y >= 0 && pixel.x < i32(frame.size.x) && pixel.y < i32(frame.size.y)) {
            let at = channel * plane + u32(pixel.y) * frame.size.x + u32(pixel.x);
            halo[i] = vec2<f32>(by_mean[at], by_square[at]);
            halo_third[i] = by_product[at];
        }
    }
    workgroupBarrier();
    for (var i = local; i < 416u; i += 256u) {
        var sum = vec4<f32>(0.0);
        for (var k = 0u; k < 11u; k++) {
            let at = (i / TILE) * SIDE + i % TILE + k;
            sum += window(k) * vec4<f32>(halo[at], halo_third[at], 0.0);
        }
        across[i] = sum;
    }
    workgroupBarrier();
    var by = vec4<f32>(0.0);
    for (var k = 0u; k < 11u; k++) {
        by += window(k) * across[local + k * TILE];
    }
    workgroupBarrier();
    return by.x + 2.0 * own.x * by.y + own.y * by.z;
}

@compute @workgroup_size(256)
fn differentiate(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let tile = group_number(group, groups);
    let corner = vec2<i32>(vec2<u32>(tile % frame.tiles.x, tile / frame.tiles.x) * TILE);
    let pixel = corner + vec2<i32>(i32(local % TILE), i32(local / TILE));
    var out = vec4<f32>(0.0);
    for (var channel = 0u; channel < 3u; channel++) {
        let own = sample(pixel, channel);
        let by_ssim = similarity_gradient(corner, local, channel, own);
        let g = (1.0 - frame.lambda) * own.weight * sign(own.x - own.y) - frame.lambda * by_ssim;
        out[channel] = select(0.0, g * frame.inv_count, own.weight > 0.0);
        out.w += out[channel] * own.x;
    }
    if (tile < frame.tiles.x * frame.tiles.y && pixel.x < i32(frame.size.x) && pixel.y < i32(frame.size.y)) {
        image[u32(pixel.y) * frame.size.x + u32(pixel.x)] = out;
    }
}

@compute @workgroup_size(256)
fn products(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let tile = group_number(group, groups);
    let corner = vec2<i32>(vec2<u32>(tile % frame.tiles.x, tile / frame.tiles.x) * TILE);
    let own = sample(corner + vec2<i32>(i32(local % TILE), i32(local / TILE)), group.z);
    let sum = group_sum(local, own.weight * vec4<f32>(own.x * own.y, own.x * own.x, own.y * own.y, 0.0));
    if (local == 0u && tile < frame.tiles.x * frame.tiles.y) {
        partial[tile * 3u + group.z] = sum;
    }
}

@compute @workgroup_size(256)
fn total_products(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    var sum = vec4<f32>(0.0);
    for (var i = local; i < frame.tiles.x * frame.tiles.y; i += 256u) {
        sum += partial[3u * i + group.z];
    }
    let all = group_sum(local, sum);
    if (local == 0u) {
        result[group.z] = all;
    }
}

@compute @workgroup_size(256)
fn total(@builtin(local_invocation_index) local: u32) {
    let n = 3u * frame.tiles.x * frame.tiles.y;
    var sum = vec4<f32>(0.0);
    for (var i = local; i < n; i += 256u) {
        sum += partial[i];
    }
    let all = group_sum(local, sum);
    if (local == 0u) {
        result[0] = all;
    }
}
