@group(0) @binding(1) var<storage, read> parameters: array<f32>;
@group(0) @binding(2) var<storage, read> of_outputs: array<f32>;
@group(0) @binding(3) var<storage, read> outputs: array<f32>;
@group(0) @binding(4) var<storage, read_write> of_before: array<f32>;
@group(0) @binding(5) var<storage, read_write> of_beside: array<f32>;

// Gradient of an output before the rectifier.
fn gradient_at(row: u32, output: u32) -> f32 {
    if (row >= job.rows || output >= job.outputs) {
        return 0.0;
    }
    let at = row * job.outputs + output;
    if ((job.flags & RELU) != 0u && outputs[at] <= 0.0) {
        return 0.0;
    }
    return of_outputs[at];
}

// Adds the gradients of what a layer read.
@compute @workgroup_size(256)
fn backward(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let first = vec2u(group.x, group.y) * 64u;
    let own = vec2u(local / 16u, local % 16u) * 4u;
    var sums = array<vec4f, 4>();
    for (var k = 0u; k < job.outputs; k += 16u) {
        for (var j = local; j < 1024u; j += 256u) {
            left[(j % 16u) * 64u + j / 16u] = gradient_at(first.x + j / 16u, k + j % 16u);
            let input = first.y + j / 16u;
            var weight = 0.0;
            if (input < inputs() && k + j % 16u < job.outputs) {
                weight = parameters[job.weights + place(input, k + j % 16u)];
            }
            right[(j % 16u) * 64u + j / 16u] = weight;
        }
        workgroupBarrier();
        multiply(&sums, own.x, own.y);
        workgroupBarrier();
    }
    for (var r = 0u; r < 4u; r++) {
        for (var c = 0u; c < 4u; c++) {
            let row = first.x + own.x + r;
            let input = first.y + own.y + c;
            if (row < job.rows && input < job.columns) {
                if (input < job.taken) {
                    of_before[row * job.before_width + input] += sums[r][c];
                } else {
                    of_beside[row * job.beside_width + input - job.taken] += sums[r][c];
                }
            }
        }
    }
}
