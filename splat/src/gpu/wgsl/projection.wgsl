// projection: Gaussian -> screen, shared by project and adam. Needs `page` and `geometry`: 11
// planes of `page.stride` (mean x y z, log-scale x y z, quaternion w x y z, logit). Equations and
// sources: reference/project.rs. The model lies in pages, so that no binding is larger than the
// adapter allows: Gaussian i is entry i - page.first of its page, and a kernel runs once a page.

struct Page {
    first: u32,    // number of its first Gaussian
    count: u32,    // Gaussians
    stride: u32,   // entries of a plane, >= count
    spare: u32,
}

const LOW_PASS: f32 = 0.3;
const MAX_LOG_SCALE: f32 = 20.0;

struct Projection {
    x: vec3<f32>,        // camera frame
    uv: vec2<f32>,       // x/z, y/z
    limited: vec2<f32>,  // the same within the Jacobian's limits
    q: vec4<f32>,        // unit quaternion, w x y z
    inv_norm: f32,       // 1 / |q|, 0 where q has no direction
    rotation: mat3x3<f32>,
    log_scale: vec3<f32>,
    scale: vec3<f32>,
    t0: vec3<f32>,       // rows of J W
    t1: vec3<f32>,
    a: vec3<f32>,        // rows of J W R S
    b: vec3<f32>,
    cov: vec3<f32>,      // Sigma' xx, xy, yy, px^2
    conic: vec3<f32>,    // Sigma'^-1
    det_sharp: f32,      // without the low-pass
    det: f32,
    sigmoid: f32,
    opacity: f32,
    xy: vec2<f32>,       // px
    seen: bool,
}

fn plane(k: u32, l: u32) -> f32 {
    return geometry[k * page.stride + l];
}

fn rotation_matrix(q: vec4<f32>) -> mat3x3<f32> {
    let w = q.x; let x = q.y; let y = q.z; let z = q.w;
    return mat3x3<f32>(
        vec3<f32>(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        vec3<f32>(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        vec3<f32>(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    );
}

// Whether the 11 parameters are numbers; an infinite logit or log-scale is one.
fn usable(l: u32) -> bool {
    var good = true;
    for (var k = 0u; k < 11u; k++) {
        let v = plane(k, l);
        let number = (bitcast<u32>(v) & 0x7fffffffu) <= 0x7f800000u;
        good = good && number && (is_finite(v) || k == 10u || (k >= 3u && k < 6u));
    }
    return good;
}

fn project_gaussian(l: u32) -> Projection {
    var p: Projection;
    let mean = vec4<f32>(plane(0u, l), plane(1u, l), plane(2u, l), 1.0);
    p.x = vec3<f32>(dot(frame.row0, mean), dot(frame.row1, mean), dot(frame.row2, mean));
    let in_front = usable(l) && p.x.z >= frame.near && is_finite(p.x.x) && is_finite(p.x.y) && is_finite(p.x.z);
    let inv_z = 1.0 / select(1.0, p.x.z, in_front);
    p.uv = p.x.xy * inv_z;
    p.limited = clamp(p.uv, frame.low, frame.high);

    // Scaled first, so that the norm neither vanishes nor overflows.
    let raw = vec4<f32>(plane(6u, l), plane(7u, l), plane(8u, l), plane(9u, l));
    let largest = max(max(abs(raw.x), abs(raw.y)), max(abs(raw.z), abs(raw.w)));
    let directed = largest >= 1e-30;
    let level = raw / select(1.0, largest, directed);
    let norm = length(select(vec4<f32>(1.0, 0.0, 0.0, 0.0), level, directed));
    p.q = select(vec4<f32>(1.0, 0.0, 0.0, 0.0), level / norm, directed);
    p.inv_norm = select(0.0, 1.0 / (norm * largest), directed);
    p.rotation = rotation_matrix(p.q);
    p.log_scale = vec3<f32>(plane(3u, l), plane(4u, l), plane(5u, l));
    p.scale = exp(clamp(p.log_scale, vec3<f32>(-MAX_LOG_SCALE), vec3<f32>(MAX_LOG_SCALE)));

    let f = frame.focal * inv_z;
    p.t0 = f.x * (frame.row0.xyz - p.limited.x * frame.row2.xyz);
    p.t1 = f.y * (frame.row1.xyz - p.limited.y * frame.row2.xyz);
    p.a = p.scale * (p.t0 * p.rotation);
    p.b = p.scale * (p.t1 * p.rotation);
    let aa = dot(p.a, p.a); let ab = dot(p.a, p.b); let bb = dot(p.b, p.b);
    let c = cross(p.a, p.b);
    p.det_sharp = dot(c, c);
    p.det = p.det_sharp + LOW_PASS * (aa + bb) + LOW_PASS * LOW_PASS;
    p.cov = vec3<f32>(aa + LOW_PASS, ab, bb + LOW_PASS);
    let good = is_finite(p.det) && p.det < 1e30;
    p.conic = vec3<f32>(p.cov.z, -p.cov.y, p.cov.x) / select(1.0, p.det, good);

    p.sigmoid = 1.0 / (1.0 + exp(-clamp(plane(10u, l), -80.0, 80.0)));
    let rho = select(1.0, sqrt(p.det_sharp / select(1.0, p.det, good)), (frame.flags & ANTIALIAS) != 0u);
    p.opacity = p.sigmoid * rho;
    p.xy = p.uv * frame.focal + frame.centre;
    p.seen = in_front && good && p.opacity >= MIN_ALPHA && is_finite(p.xy.x) && is_finite(p.xy.y);
    return p;
}
