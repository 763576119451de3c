// backward: dL/d(colour) of a tile's pixels -> sums for each of its Gaussians, replayed front to back.
// in: records · owners · values · ranges · used · image · gradient [H * W] dL/d(rgb)
// out: sums [pairs][12], at the pair's number, so that a Gaussian's pairs lie side by side and no atomics are needed:
//      with v = alpha dL/d(alpha), d = xy - pixel: v, v dx, v dy, v dx^2, v dx dy, v dy^2, T alpha dL/d(rgb) (3), T alpha
//
// Eight Gaussians at a time: each thread follows its pixel and leaves T alpha and v of each of the eight in `left`;
// then 32 threads a Gaussian add up eight pixels (half a row) each; then one thread a sum adds up the 32.
// dL/d(alpha) = T rgb . g - behind / (1 - alpha), behind = g . (what lies behind, the background too): Kerbl 2023.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> owners: array<u32>;
@group(0) @binding(3) var<storage, read> values: array<u32>;
@group(0) @binding(4) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read> used: array<u32>;
@group(0) @binding(6) var<storage, read> image: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> gradient: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> sums: array<f32>;

const EIGHT: u32 = 8u;
const SUMS: u32 = 12u;

var<workgroup> batch: array<array<vec4<f32>, 3>, 8>;
var<workgroup> pairs: array<u32, 8>;
// [Gaussian][pixel] (T alpha, v); then reused as [sum][thread] partial sums.
var<workgroup> left: array<vec2<f32>, 1408>;
var<workgroup> bounds: vec3<u32>;

// Rows of 8 pixels are spread by one entry, so that threads of a group meet different banks.
fn slot(k: u32, pixel: u32) -> u32 {
    return k * 176u + pixel;
}

@compute @workgroup_size(128)
fn main() {
}
