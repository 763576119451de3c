@group(0) @binding(1) var<storage, read> before: array<f32>;
@group(0) @binding(2) var<storage, read> beside: array<f32>;
@group(0) @binding(3) var<storage, read> of_outputs: array<f32>;
@group(0) @binding(4) var<storage, read> outputs: array<f32>;
// By chunk of rows: weights, then biases.
@group(0) @binding(5) var<storage, read_write> partial: array<f32>;
@group(0) @binding(6) var<storage, read_write> gradient: array<f32>;

fn input_at(row: u32, column: u32) -> f32 {
    if (column >= inputs()) {
        return 0.0;
    }
    if (column < job.taken) {
        return before[row * job.before_width + column];
    }
    return beside[row * job.beside_width + column - job.taken];
}

fn of_output(row: u32, output: u32) -> f32 {
    if (output >= job.outputs) {
        return 0.0;
    }
    let at = row * job.outputs + output;
    if ((job.flags & RELU) != 0u && outputs[at] <= 0.0) {
        return 0.0;
    }
    return of_outputs[at];
}

fn size() -> u32 {
    return inputs() * job.outputs + select(0u, job.outputs, (job.flags & BIAS) != 0u);
}

// A chunk's sums of products.
@compute @workgroup_size(256)
fn weights(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let first = vec2u(group.x, group.y) * 64u;
    let own = vec2u(local / 16u, local % 16u) * 4u;
    let begin = group.z * job.chunk;
    let end = min(begin + job.chunk, job.rows);
    var sums = array<vec4f, 4>();
    for (var k = begin; k < end; k += 16u) {
        for (var j = local; j < 1024u; j += 256u) {
            let row = k + j / 64u;
            var values = vec2f();
            if (row < end) {
                values = vec2f(input_at(row, first.x + j % 64u), of_output(row, first.y + j % 64u));
            }
            left[j] = values.x;
            right[j] = values.y;
        }
        workgroupBarrier();
        multiply(&sums, own.x, own.y);
        workgroupBarrier();
    }
    for (var r = 0u; r < 4u; r++) {
        for (var c = 0u; c < 4u; c++) {
            let input = first.x + own.x + r;
            let output = first.y + own.y + c;
            if (input < inputs() && output < job.outputs) {
                partial[group.z * size() + place(input, output)] = sums[r][c];
            }
        }
    }
}

// A chunk's sums of the outputs' gradients.
@compute @workgroup_size(64)
fn biases(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let output = group.x * 64u + local;
    if (output >= job.outputs) {
        return;
    }
    var sum = 0.0;
    for (var row = group.z * job.chunk; row < min((group.z + 1u) * job.chunk, job.rows); row++) {
        sum += of_output(row, output);
    }
    partial[group.z * size() + inputs() * job.outputs + output] = sum;
}

// Adds the chunks in order.
@compute @workgroup_size(256)
fn total(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let at = (group.y * groups.x + group.x) * 256u + local;
    if (at >= size()) {
        return;
    }
    var sum = gradient[job.weights + at];
    for (var chunk = 0u; chunk < job.chunks; chunk++) {
        sum += partial[chunk * size() + at];
    }
    gradient[job.weights + at] = sum;
}
