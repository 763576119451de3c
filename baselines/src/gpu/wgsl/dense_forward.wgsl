@group(0) @binding(1) var<storage, read> parameters: array<f32>;
@group(0) @binding(2) var<storage, read> before: array<f32>;
@group(0) @binding(3) var<storage, read> beside: array<f32>;
@group(0) @binding(4) var<storage, read_write> outputs: array<f32>;

fn input_at(row: u32, column: u32) -> f32 {
    if (row >= job.rows || column >= inputs()) {
        return 0.0;
    }
    if (column < job.taken) {
        return before[row * job.before_width + column];
    }
    return beside[row * job.beside_width + column - job.taken];
}

@compute @workgroup_size(256)
fn forward(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let first = vec2u(group.x, group.y) * 64u;
    let own = vec2u(local / 16u, local % 16u) * 4u;
    var sums = array<vec4f, 4>();
    for (var k = 0u; k < inputs(); k += 16u) {
        for (var j = local; j < 1024u; j += 256u) {
            left[(j % 16u) * 64u + j / 16u] = input_at(first.x + j / 16u, k + j % 16u);
            let output = first.y + j % 64u;
            var weight = 0.0;
            if (output < job.outputs && k + j / 64u < inputs()) {
                weight = parameters[job.weights + place(k + j / 64u, output)];
            }
            right[j] = weight;
        }
        workgroupBarrier();
        multiply(&sums, own.x, own.y);
        workgroupBarrier();
    }
    for (var r = 0u; r < 4u; r++) {
        for (var c = 0u; c < 4u; c++) {
            let row = first.x + own.x + r;
            let output = first.y + own.y + c;
            if (row < job.rows && output < job.outputs) {
                var sum = sums[r][c];
                if ((job.flags & BIAS) != 0u) {
                    sum += parameters[job.bias + output];
                }
                if ((job.flags & RELU) != 0u) {
                    sum = max(sum, 0.0);
                }
                outputs[row * job.outputs + output] = sum;
            }
        }
    }
}
