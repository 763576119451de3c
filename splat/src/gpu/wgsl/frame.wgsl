// frame: what every kernel knows of the view and the step; placed before each kernel. Rust twin:
// layout.rs (Frame).

struct Frame {
    row0: vec4<f32>,        // rows of R of x_cam = R x + t, t in w
    row1: vec4<f32>,
    row2: vec4<f32>,
    position: vec4<f32>,    // camera centre, world
    background: vec4<f32>,
    unit: vec4<f32>,        // targets are multiplied by this: the inverse of the view's gain
    focal: vec2<f32>,       // px
    centre: vec2<f32>,      // principal point, px
    low: vec2<f32>,         // limits of x/z and y/z in the Jacobian
    high: vec2<f32>,
    size: vec2<u32>,        // px
    tiles: vec2<u32>,
    n: u32,                 // Gaussians
    pair_capacity: u32,     // Gaussian-tile pairs that the buffers hold
    sh_stride: u32,         // SH values held for a Gaussian, 3 (degree + 1)^2
    sh_used: u32,           // SH coefficients a channel in use
    flags: u32,             // the bits below
    near: f32,
    lambda: f32,            // weight of D-SSIM
    inv_count: f32,         // 1 / (3 * sum of the weights), 0 where there are none
    rate_mean: f32,
    rate_log_scale: f32,
    rate_rotation: f32,
    rate_opacity: f32,
    rate_sh0: f32,
    rate_sh_rest: f32,
    spare0: u32,
    spare1: u32,
}

const ANTIALIAS: u32 = 1u;
const WEIGHTED: u32 = 2u;        // alpha of the target is a weight, 0 = ignored
const COVERAGE: u32 = 4u;        // alpha of the target is coverage, the background shows through
const TRUNCATE: u32 = 8u;        // pairs beyond the buffers are left out, the farthest Gaussians' first

const KEEP: u32 = 16u;           // rasterise keeps each pixel's state where a block of pairs begins

const TILE: u32 = 16u;
const SPAN: u32 = 256u;          // pairs of a block of rasterise_backward
const MIN_ALPHA: f32 = 0.00392156862745098;
const MAX_ALPHA: f32 = 0.99;
const MIN_TRANSMITTANCE: f32 = 1e-4;
const NOWHERE: u32 = 0xffffffffu;

// Entries of the counters.
const VISIBLE: u32 = 0u;
const PAIRS: u32 = 1u;       // pairs that are needed; drawn only as far as the buffers reach
const NON_FINITE: u32 = 2u;  // Gaussians whose gradient was not finite
const HALT: u32 = 4u;        // a step was not taken: those after it are not either, so that the host can repeat them in order

// A dispatch of more than 65,535 groups is folded into two dimensions.
fn group_number(group: vec3<u32>, groups: vec3<u32>) -> u32 {
    return group.x + group.y * groups.x;
}

// Neither NaN nor infinite; by bits, because compilers may assume that neither exists.
fn is_finite(v: f32) -> bool {
    return (bitcast<u32>(v) & 0x7f800000u) != 0x7f800000u;
}
