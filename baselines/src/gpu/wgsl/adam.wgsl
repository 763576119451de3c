// Adam (the twin of adam.rs): a thread a parameter. Leaves the gradients at 0.

struct Job {
    count: u32,
    rate: f32,
    decay: f32,
    beta1: f32,
    beta2: f32,
    epsilon: f32,
    // Share of the average that is kept; negative: there is none.
    kept: f32,
    // Whether the average begins.
    begins: u32,
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read_write> values: array<f32>;
@group(0) @binding(2) var<storage, read_write> first: array<f32>;
@group(0) @binding(3) var<storage, read_write> second: array<f32>;
@group(0) @binding(4) var<storage, read_write> average: array<f32>;
@group(0) @binding(5) var<storage, read_write> gradient: array<f32>;
// Sums in fixed point: low and high words, see `fixed.wgsl`.
@group(0) @binding(6) var<storage, read_write> sums: array<u32>;

fn update(at: u32, g: f32) {
    let m = job.beta1 * first[at] + (1.0 - job.beta1) * g;
    let v = job.beta2 * second[at] + (1.0 - job.beta2) * g * g;
    first[at] = m;
    second[at] = v;
    values[at] -= job.rate * m / (sqrt(v) + job.epsilon);
}

fn keep_average(at: u32) {
    if (job.kept >= 0.0) {
        let old = select(average[at], values[at], job.begins != 0u);
        average[at] = job.kept * old + (1.0 - job.kept) * values[at];
    }
}

// All parameters, with weight decay.
@compute @workgroup_size(256)
fn all(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let at = (group.y * groups.x + group.x) * 256u + local;
    if (at < job.count) {
        update(at, gradient[at] + job.decay * values[at]);
        gradient[at] = 0.0;
        keep_average(at);
    }
}

// Those whose sum is not 0.
@compute @workgroup_size(256)
fn touched(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let at = (group.y * groups.x + group.x) * 256u + local;
    if (at < job.count) {
        let low = sums[2u * at];
        let high = sums[2u * at + 1u];
        if ((low | high) != 0u) {
            update(at, from_fixed(low, high));
            sums[2u * at] = 0u;
            sums[2u * at + 1u] = 0u;
        }
        keep_average(at);
    }
}
