// The positional encoding (the twin of encoding.rs): a thread a sample. A row has the coordinates,
// then by octave and coordinate the sine and the cosine; then the same of the time, where `timed`.

struct Job {
    rows: u32,
    // Columns of a row; of a row of moves, 0 where nothing moves.
    width: u32,
    moves_width: u32,
    octaves: u32,
    time_octaves: u32,
}

@group(0) @binding(0) var<uniform> job: Job;
// Position and time.
@group(0) @binding(1) var<storage, read> points: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> encoded: array<f32>;
@group(0) @binding(3) var<storage, read_write> of_encoded: array<f32>;
@group(0) @binding(4) var<storage, read_write> moves: array<f32>;
@group(0) @binding(5) var<storage, read_write> of_moves: array<f32>;

const PI = 3.14159265358979;

// Sine of so many whole turns, from its series: WGSL promises no digits of `sin`.
fn sine(turns: f32) -> f32 {
    var x = turns - round(turns);
    x = select(x, 0.5 - x, x > 0.25);
    x = select(x, -0.5 - x, x < -0.25);
    let a = 2.0 * PI * x;
    let b = a * a;
    return a * (1.0 + b * (-1.0 / 6.0 + b * (1.0 / 120.0 + b * (-1.0 / 5040.0
        + b * (1.0 / 362880.0 + b * (-1.0 / 39916800.0))))));
}

fn wave(at: u32, x: f32, octave: u32) {
    let whole = x * f32(1u << octave) * 0.5;
    let turns = whole - round(whole);
    encoded[at] = sine(turns);
    encoded[at + 1u] = sine(turns + 0.25);
}

fn encode_row(row: u32, p: vec3f) {
    let first = row * job.width;
    for (var a = 0u; a < 3u; a++) {
        encoded[first + a] = p[a];
        for (var k = 0u; k < job.octaves; k++) {
            wave(first + 3u + 2u * (3u * k + a), p[a], k);
        }
    }
}

// Places and times.
@compute @workgroup_size(64)
fn with_times(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let row = group.x * 64u + local;
    if (row >= job.rows) {
        return;
    }
    encode_row(row, points[row].xyz);
    let first = row * job.width + 3u * (1u + 2u * job.octaves);
    encoded[first] = points[row].w;
    for (var k = 0u; k < job.time_octaves; k++) {
        wave(first + 1u + 2u * k, points[row].w, k);
    }
}

// Places as they are at time 0.
@compute @workgroup_size(64)
fn moved(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let row = group.x * 64u + local;
    if (row >= job.rows) {
        return;
    }
    var p = points[row].xyz;
    if (job.moves_width > 0u && points[row].w != 0.0) {
        let at = row * job.moves_width;
        p += vec3f(moves[at], moves[at + 1u], moves[at + 2u]);
    }
    encode_row(row, p);
}

// From the gradient of an encoded row to that of the move.
@compute @workgroup_size(64)
fn backward(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let row = group.x * 64u + local;
    if (row >= job.rows || points[row].w == 0.0) {
        return;
    }
    let first = row * job.width;
    for (var a = 0u; a < 3u; a++) {
        var sum = of_encoded[first + a];
        for (var k = 0u; k < job.octaves; k++) {
            let at = first + 3u + 2u * (3u * k + a);
            let scale = f32(1u << k) * PI;
            sum += scale * (of_encoded[at] * encoded[at + 1u] - of_encoded[at + 1u] * encoded[at]);
        }
        of_moves[row * job.moves_width + a] = sum;
    }
}
