// Products with the weights of a dense layer (the twin of dense.rs). Activations are [rows][width];
// weights are packed in panels of 16 outputs, [outputs / 16][inputs][16]. A layer reads `taken`
// columns of the layer before it, which is `before_width` wide, then `beside_width` columns of an
// input of the network. A group of 256 threads makes a tile of 64 × 64, a thread 4 × 4 of it.

struct Job {
    rows: u32,
    taken: u32,
    before_width: u32,
    beside_width: u32,
    outputs: u32,
    // First weight and first bias among the parameters.
    weights: u32,
    bias: u32,
    // 1: negative outputs become 0; 2: there are biases.
    flags: u32,
    // Columns of the inputs whose gradient is wanted.
    columns: u32,
    // Rows of which weight gradients are added up apart.
    chunk: u32,
    chunks: u32,
}

@group(0) @binding(0) var<uniform> job: Job;

const RELU = 1u;
const BIAS = 2u;

// By step: 16 × 64 of either factor.
var<workgroup> left: array<f32, 1024>;
var<workgroup> right: array<f32, 1024>;

fn inputs() -> u32 {
    return job.taken + job.beside_width;
}

// Where weight (input, output) lies in the panels.
fn place(input: u32, output: u32) -> u32 {
    return (output / 16u * inputs() + input) * 16u + output % 16u;
}

// Adds the products of a step to a thread's tile.
fn multiply(sums: ptr<function, array<vec4f, 4>>, row: u32, column: u32) {
    for (var k = 0u; k < 16u; k++) {
        let at = k * 64u + column;
        let b = vec4f(right[at], right[at + 1u], right[at + 2u], right[at + 3u]);
        for (var r = 0u; r < 4u; r++) {
            (*sums)[r] += left[k * 64u + row + r] * b;
        }
    }
}
