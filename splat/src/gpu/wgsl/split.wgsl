// split: how a Gaussian becomes two, and the numbers it is done by; shared by densify and halve.
// Twin: densify.rs (split).
// Half of the longest axis each: centres 0.4 to 0.6 of its deviation apart from the old one, that
// axis halved, the others shorter by exp(-0.16).

const CHILD: u32 = 0x80000000u;   // in `source`: the half that is new
const FRESH: u32 = 0x40000000u;   // in `source`: either half: moments begin anew
const NUMBER: u32 = 0x3fffffffu;  // in `source`: the Gaussian it comes from

// Jarzynski and Olano 2020, "Hash Functions for GPU Rendering" (pcg).
fn hash(v: u32) -> u32 {
    let state = v * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

struct Half {
    mean: vec3<f32>,
    log_scale: vec3<f32>,
}

// One half of Gaussian `number`: `side` 1 or -1.
fn half_of(number: u32, side: f32, mean: vec3<f32>, log_scale: vec3<f32>, raw: vec4<f32>) -> Half {
    var longest = 0u;
    for (var k = 1u; k < 3u; k++) {
        if (log_scale[k] >= log_scale[longest]) {
            longest = k;
        }
    }
    let random = f32(hash(number ^ hash(job.iteration ^ hash(job.seed))) >> 8u) / 16777216.0;
    let reach = exp(clamp(log_scale[longest], -20.0, 20.0)) * (0.4 + 0.2 * random);
    let norm = dot(raw, raw);
    let q = select(vec4<f32>(1.0, 0.0, 0.0, 0.0), raw * inverseSqrt(max(norm, 1e-30)), norm > 1e-20);
    var axis = vec3<f32>(0.0);
    axis[longest] = reach;
    // q axis q^-1
    let t = 2.0 * cross(q.yzw, axis);
    let offset = axis + q.x * t + cross(q.yzw, t);
    var half: Half;
    half.mean = mean + side * offset;
    half.log_scale = log_scale - 0.16;
    half.log_scale[longest] = log_scale[longest] - 0.69314718;
    return half;
}
