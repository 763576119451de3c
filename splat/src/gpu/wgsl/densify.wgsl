// densify: which Gaussians are split and which stay. Twin: densify.rs.
// score: keys [N], ascending from the greatest mean screen gradient, NOWHERE for no candidate ·
// values [N] numbers
// (then `sort`) choose: chosen [N] is 1 for the first `room` candidates
// judge: flags [N + room] is 1 for what stays: the Gaussians, then the new halves in order of their
// scores
// (then `scan`) place: source [kept] where each comes from (CHILD, FRESH: split.wgsl)
// score and judge run once a page; the others once.

struct Job {
    page_first: u32,
    page_count: u32,
    page_stride: u32,
    n: u32,
    room: u32,          // Gaussians that may be added
    views: u32,         // views that must have it in their picture are counted among these
    least: u32,         // and must be so many; 0: none
    iteration: u32,
    seed: u32,
    floor: f32,         // logit below which a Gaussian is removed
    spare0: u32,
    spare1: u32,
}

struct View {
    row0: vec4<f32>,    // R of x_cam = R x + t, t in w
    row1: vec4<f32>,
    row2: vec4<f32>,
    lens: vec4<f32>,    // focal lengths, principal point
    size: vec4<f32>,
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> geometry: array<f32>;
@group(0) @binding(2) var<storage, read_write> keys: array<u32>;
@group(0) @binding(3) var<storage, read_write> values: array<u32>;
@group(0) @binding(4) var<storage, read_write> chosen: array<u32>;
@group(0) @binding(5) var<storage, read_write> flags: array<u32>;
@group(0) @binding(6) var<storage, read> views: array<View>;
@group(0) @binding(7) var<storage, read_write> counters: array<atomic<u32>>;
@group(0) @binding(8) var<storage, read_write> source: array<u32>;

const STATISTICS: u32 = 37u;
const UNSEEN: u32 = 2u;   // counter of those removed because hardly any view has them

fn plane(k: u32, l: u32) -> f32 {
    return geometry[k * job.page_stride + l];
}

@compute @workgroup_size(256)
fn score(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let l = group_number(group, groups) * 256u + local;
    if (l >= job.page_count) {
        return;
    }
    let steps = plane(STATISTICS + 1u, l);
    let gradient = plane(STATISTICS, l) / max(steps, 1.0);
    let i = job.page_first + l;
    keys[i] = select(NOWHERE, NOWHERE - bitcast<u32>(gradient), steps > 0.0 && gradient > 0.0 && is_finite(gradient));
    values[i] = i;
}

@compute @workgroup_size(256)
fn choose(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let rank = group_number(group, groups) * 256u + local;
    if (rank < min(job.room, job.n) && keys[rank] != NOWHERE) {
        chosen[values[rank]] = 1u;
    }
}

// Whether enough views have x in their picture.
fn seen(x: vec3<f32>) -> bool {
    var count = 0u;
    for (var k = 0u; k < job.views && count < job.least; k++) {
        let v = views[k];
        let h = vec4<f32>(x, 1.0);
        let c = vec3<f32>(dot(v.row0, h), dot(v.row1, h), dot(v.row2, h));
        let p = v.lens.xy * c.xy + v.lens.zw * c.z;
        if (c.z > 0.0 && all(p >= vec2<f32>(0.0)) && all(p < v.size.xy * c.z)) {
            count++;
        }
    }
    return count >= job.least;
}

@compute @workgroup_size(256)
fn judge(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    // The page's Gaussians, then all ranks of new halves, of which those of the page's Gaussians
    // are looked at.
    let item = group_number(group, groups) * 256u + local;
    var i = job.page_first + item;
    var at = i;
    let child = item >= job.page_count;
    if (child) {
        let rank = item - job.page_count;
        if (rank >= min(job.room, job.n) || keys[rank] == NOWHERE) {
            return;
        }
        i = values[rank];
        at = job.n + rank;
    }
    if (i < job.page_first || i >= job.page_first + job.page_count) {
        return;
    }
    let l = i - job.page_first;
    var mean = vec3<f32>(plane(0u, l), plane(1u, l), plane(2u, l));
    var log_scale = vec3<f32>(plane(3u, l), plane(4u, l), plane(5u, l));
    let q = vec4<f32>(plane(6u, l), plane(7u, l), plane(8u, l), plane(9u, l));
    if (chosen[i] != 0u) {
        let half = half_of(i, select(1.0, -1.0, child), mean, log_scale, q);
        mean = half.mean;
        log_scale = half.log_scale;
    }
    var good = plane(10u, l) > job.floor && is_finite(plane(10u, l));
    for (var k = 0u; k < 4u; k++) {
        good = good && is_finite(q[k]);
    }
    for (var k = 0u; k < 3u; k++) {
        good = good && is_finite(mean[k]) && is_finite(log_scale[k]);
    }
    if (good && job.least > 0u && !seen(mean)) {
        good = false;
        atomicAdd(&counters[UNSEEN], 1u);
    }
    flags[at] = select(0u, 1u, good);
}

@compute @workgroup_size(256)
fn place(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let item = group_number(group, groups) * 256u + local;
    let all = job.n + job.room;
    if (item >= all) {
        return;
    }
    // `flags` holds positions by now: what stays is where they grow.
    let position = flags[item];
    var next = atomicLoad(&counters[0]);
    if (item + 1u < all) {
        next = flags[item + 1u];
    }
    if (next == position) {
        return;
    }
    if (item < job.n) {
        source[position] = item | select(0u, FRESH, chosen[item] != 0u);
    } else {
        source[position] = values[item - job.n] | CHILD | FRESH;
    }
}
