// adam: project backward and Adam, fused: sums of `rasterise_backward` -> parameters moved one
// step.
// in: sums [pairs][10] in arrays of four, four and two · spans [N] (first, end) of the Gaussian's
// pairs · counters
// in, out, of a page: geometry [39][stride]: 11 planes of parameters, 11 of first and 11 of second
// moments, 3 of the second moments of the colour's channels, the clock, and
//          two of statistics: sum of |dL/dxy| in half images, steps seen
//          sh [3K][stride]
// Equations and sources: reference/project.rs, reference/adam.rs. The clock counts the steps in
// which a Gaussian was seen.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> page: Page;
@group(0) @binding(2) var<storage, read_write> geometry: array<f32>;
@group(0) @binding(3) var<storage, read_write> sh: array<f32>;
@group(0) @binding(4) var<storage, read> sums_a: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> sums_b: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> sums_c: array<vec2<f32>>;
@group(0) @binding(7) var<storage, read> spans: array<vec2<u32>>;
@group(0) @binding(8) var<storage, read_write> counters: array<atomic<u32>>;

const BETA1: f32 = 0.9;
const BETA2: f32 = 0.999;
const LOG_BETA1: f32 = -0.10536052;
const LOG_BETA2: f32 = -0.0010005003;
const EPSILON: f32 = 1e-15;
const TINY_MOMENT: f32 = 1e-18;
const TINY_SQUARE: f32 = 1e-30;
const COLOUR_MOMENTS: u32 = 33u;
const CLOCK: u32 = 36u;
const STATISTICS: u32 = 37u;

// 1 / (1 - beta^t), from the logarithm: exact enough where beta^t is close to 1.
fn unbias(t: f32, log_beta: f32) -> f32 {
    return 1.0 / (1.0 - exp(t * log_beta));
}

fn quaternion_gradient(p: ptr<function, Projection>, d: mat3x3<f32>) -> vec4<f32> {
    let w = (*p).q.x; let x = (*p).q.y; let y = (*p).q.z; let z = (*p).q.w;
    let s01 = d[1][0] + d[0][1]; let s02 = d[2][0] + d[0][2]; let s12 = d[2][1] + d[1][2];
    let a21 = d[1][2] - d[2][1]; let a02 = d[2][0] - d[0][2]; let a10 = d[0][1] - d[1][0];
    let g = 2.0 * vec4<f32>(
        x * a21 + y * a02 + z * a10,
        y * s01 + z * s02 + w * a21 - 2.0 * x * (d[1][1] + d[2][2]),
        x * s01 + z * s12 + w * a02 - 2.0 * y * (d[0][0] + d[2][2]),
        x * s02 + y * s12 + w * a10 - 2.0 * z * (d[0][0] + d[1][1]),
    );
    return (g - (*p).q * dot((*p).q, g)) * (*p).inv_norm;
}

// dL/d(Sigma' xx, xy, yy); xy counts once.
fn covariance_gradient(p: ptr<function, Projection>, v: f32, second: vec3<f32>) -> vec3<f32> {
    let q = (*p).conic;
    let m00 = q.x * second.x + q.y * second.y; let m01 = q.x * second.y + q.y * second.z;
    let m10 = q.y * second.x + q.z * second.y; let m11 = q.y * second.y + q.z * second.z;
    var d = 0.5 * vec3<f32>(m00 * q.x + m01 * q.y, 2.0 * (m00 * q.y + m01 * q.z), m10 * q.y + m11 * q.z);
    if ((frame.flags & ANTIALIAS) != 0u) {
        let cov = (*p).cov;
        let sharp = vec3<f32>(cov.z - LOW_PASS, -2.0 * cov.y, cov.x - LOW_PASS);
        let soft = vec3<f32>(cov.z, -2.0 * cov.y, cov.x);
        d += 0.5 * v * (sharp / max((*p).det_sharp, 1e-20) - soft / (*p).det);
    }
    return d;
}

// dL/d(camera frame position), from the centre on the screen and the rows of J W.
fn position_gradient(p: ptr<function, Projection>, d_xy: vec2<f32>, dt0: vec3<f32>, dt1: vec3<f32>) -> vec3<f32> {
    let inv_z = 1.0 / (*p).x.z;
    let f = frame.focal * inv_z;
    let own = vec2<f32>(dot(dt0, frame.row0.xyz), dot(dt1, frame.row1.xyz));
    let last = vec2<f32>(dot(dt0, frame.row2.xyz), dot(dt1, frame.row2.xyz));
    let free = vec2<f32>((*p).limited == (*p).uv);
    let by_z = ((*p).limited * last - own + free * (*p).uv * last) * f * inv_z - d_xy * f * (*p).uv;
    return vec3<f32>(d_xy * f - free * last * f * inv_z, by_z.x + by_z.y);
}

fn adam(value: f32, g: f32, m: f32, v: f32, rate: f32, c1: f32, c2: f32) -> vec3<f32> {
    var m1 = BETA1 * m + (1.0 - BETA1) * g;
    var v1 = BETA2 * v + (1.0 - BETA2) * g * g;
    m1 = select(0.0, m1, abs(m1) >= TINY_MOMENT);
    v1 = select(0.0, v1, v1 >= TINY_SQUARE);
    return vec3<f32>(value - rate * m1 * c1 / (sqrt(v1 * c2) + EPSILON), m1, v1);
}

// A channel's second moment after a gradient of its constant harmonic, and what all its steps are
// divided by.
fn colour_size(channel: u32, l: u32, g: f32, c2: f32) -> f32 {
    let at = (COLOUR_MOMENTS + channel) * page.stride + l;
    let v = BETA2 * geometry[at] + (1.0 - BETA2) * g * g;
    let kept = select(0.0, v, v >= TINY_SQUARE);
    geometry[at] = kept;
    return sqrt(kept * c2) + EPSILON;
}

fn rate_of(k: u32) -> f32 {
    if (k < 3u) {
        return frame.rate_mean;
    }
    if (k < 6u) {
        return frame.rate_log_scale;
    }
    return select(frame.rate_opacity, frame.rate_rotation, k < 10u);
}

// Moves the SH; returns dL/dmean through the direction.
fn colour_step(l: u32, mean: vec3<f32>, d_rgb: vec3<f32>, c2: f32) -> vec3<f32> {
    let offset = mean - frame.position.xyz;
    let d = direction(offset);
    var basis = sh_basis(d);
    var basis_gradient = sh_basis_gradient(d);
    let rgb = sh_colour(l, &basis);
    let open = select(vec3<f32>(0.0), d_rgb, rgb > vec3<f32>(0.0));
    var by_direction = vec3<f32>(0.0);
    var step = vec3<f32>(0.0);
    for (var c = 0u; c < 3u; c++) {
        step[c] = open[c] / colour_size(c, l, basis[0] * open[c], c2);
    }
    for (var k = 0u; k < frame.sh_used; k++) {
        for (var c = 0u; c < 3u; c++) {
            let at = (3u * k + c) * page.stride + l;
            by_direction += basis_gradient[k] * (sh[at] * open[c]);
            sh[at] -= select(frame.rate_sh_rest, frame.rate_sh0, k == 0u) * basis[k] * step[c];
        }
    }
    let far = length(offset);
    return select(vec3<f32>(0.0), (by_direction - d * dot(d, by_direction)) / max(far, 1e-30), far > 0.0);
}

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let l = group_number(group, groups) * 256u + local;
    // Where the buffers were too small the step is not taken, nor those after it; the host enlarges
    // them and repeats it, or says that they cannot be larger.
    let overfull = atomicLoad(&counters[PAIRS]) > frame.pair_capacity && (frame.flags & TRUNCATE) == 0u;
    if (overfull) {
        atomicStore(&counters[HALT], 1u);
    }
    if (l >= page.count || overfull || atomicLoad(&counters[HALT]) != 0u) {
        return;
    }
    let span = spans[page.first + l];
    var sa = vec4<f32>(0.0);
    var sb = vec4<f32>(0.0);
    var sc = vec2<f32>(0.0);
    for (var pair = span.x; pair < span.y; pair++) {
        sa += sums_a[pair];
        sb += sums_b[pair];
        sc += sums_c[pair];
    }
    let s = array<f32, 10>(sa.x, sa.y, sa.z, sa.w, sb.x, sb.y, sb.z, sb.w, sc.x, sc.y);
    let still = all(sa == vec4<f32>(0.0)) && all(sb == vec4<f32>(0.0)) && s[8] == 0.0;
    if (s[9] <= 0.0 || still) {
        return; // touches no pixel, or none that counts
    }
    var p = project_gaussian(l);
    let d_xy = -vec2<f32>(p.conic.x * s[1] + p.conic.y * s[2], p.conic.y * s[1] + p.conic.z * s[2]);
    let d_cov = covariance_gradient(&p, s[0], vec3<f32>(s[3], s[4], s[5]));
    let da = 2.0 * d_cov.x * p.a + d_cov.y * p.b;
    let db = 2.0 * d_cov.z * p.b + d_cov.y * p.a;
    let dx = position_gradient(&p, d_xy, p.rotation * (p.scale * da), p.rotation * (p.scale * db));
    var g: array<f32, 11>;
    var d_rotation: mat3x3<f32>;
    for (var k = 0u; k < 3u; k++) {
        let column = p.t0 * da[k] + p.t1 * db[k];
        d_rotation[k] = column * p.scale[k];
        g[3u + k] = select(0.0, dot(column, p.rotation[k]) * p.scale[k], abs(p.log_scale[k]) < MAX_LOG_SCALE);
        g[k] = frame.row0[k] * dx.x + frame.row1[k] * dx.y + frame.row2[k] * dx.z;
    }
    let dq = quaternion_gradient(&p, d_rotation);
    g[6] = dq.x; g[7] = dq.y; g[8] = dq.z; g[9] = dq.w;
    g[10] = (1.0 - p.sigmoid) * s[0];
    var good = true;
    for (var k = 0u; k < 11u; k++) {
        good = good && is_finite(g[k]) && abs(g[k]) < 1e18;
    }
    good = good && is_finite(s[6]) && is_finite(s[7]) && is_finite(s[8]);
    if (!good) {
        atomicAdd(&counters[NON_FINITE], 1u);
        return;
    }
    let t = plane(CLOCK, l) + 1.0;
    let c1 = unbias(t, LOG_BETA1);
    let c2 = unbias(t, LOG_BETA2);
    let by_direction = colour_step(l, vec3<f32>(plane(0u, l), plane(1u, l), plane(2u, l)), vec3<f32>(s[6], s[7], s[8]), c2);
    for (var k = 0u; k < 3u; k++) {
        g[k] += by_direction[k];
    }
    geometry[CLOCK * page.stride + l] = t;
    for (var k = 0u; k < 11u; k++) {
        let at = k * page.stride + l;
        let m = at + 11u * page.stride;
        let v = m + 11u * page.stride;
        let moved = adam(geometry[at], g[k], geometry[m], geometry[v], rate_of(k), c1, c2);
        geometry[at] = moved.x;
        geometry[m] = moved.y;
        geometry[v] = moved.z;
    }
    let half = 0.5 * vec2<f32>(frame.size);
    let at = STATISTICS * page.stride + l;
    geometry[at] += length(d_xy * half);
    geometry[at + page.stride] += 1.0;
}
