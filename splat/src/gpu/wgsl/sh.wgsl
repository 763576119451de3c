// sh: real spherical harmonics to degree 3 at a unit vector. Equations and sources:
// reference/sh.rs.

fn sh_basis(d: vec3<f32>) -> array<f32, 16> {
    let x = d.x; let y = d.y; let z = d.z;
    let xx = x * x; let yy = y * y; let zz = z * z;
    return array<f32, 16>(
        0.28209479,
        -0.48860251 * y, 0.48860251 * z, -0.48860251 * x,
        1.0925484 * x * y, -1.0925484 * y * z, 0.31539157 * (2.0 * zz - xx - yy), -1.0925484 * x * z, 0.5462742 * (xx - yy),
        -0.5900436 * y * (3.0 * xx - yy), 2.8906114 * x * y * z, -0.4570458 * y * (4.0 * zz - xx - yy),
        0.37317633 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy), -0.4570458 * x * (4.0 * zz - xx - yy),
        1.4453057 * z * (xx - yy), -0.5900436 * x * (xx - 3.0 * yy),
    );
}

fn sh_basis_gradient(d: vec3<f32>) -> array<vec3<f32>, 16> {
    let x = d.x; let y = d.y; let z = d.z;
    let xx = x * x; let yy = y * y; let zz = z * z;
    return array<vec3<f32>, 16>(
        vec3<f32>(0.0),
        vec3<f32>(0.0, -0.48860251, 0.0), vec3<f32>(0.0, 0.0, 0.48860251), vec3<f32>(-0.48860251, 0.0, 0.0),
        1.0925484 * vec3<f32>(y, x, 0.0), -1.0925484 * vec3<f32>(0.0, z, y),
        0.31539157 * vec3<f32>(-2.0 * x, -2.0 * y, 4.0 * z), -1.0925484 * vec3<f32>(z, 0.0, x),
        0.5462742 * vec3<f32>(2.0 * x, -2.0 * y, 0.0),
        -0.5900436 * vec3<f32>(6.0 * x * y, 3.0 * (xx - yy), 0.0), 2.8906114 * vec3<f32>(y * z, x * z, x * y),
        -0.4570458 * vec3<f32>(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z),
        0.37317633 * vec3<f32>(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.4570458 * vec3<f32>(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z),
        1.4453057 * vec3<f32>(2.0 * x * z, -2.0 * y * z, xx - yy), -0.5900436 * vec3<f32>(3.0 * (xx - yy), -6.0 * x * y, 0.0),
    );
}

// 0.5 + sum of Y_k sh_k, not limited, of the page's Gaussian l; `sh` holds planes (coefficient,
// channel) of the page.
fn sh_colour(l: u32, basis: ptr<function, array<f32, 16>>) -> vec3<f32> {
    var rgb = vec3<f32>(0.5);
    for (var k = 0u; k < frame.sh_used; k++) {
        let at = 3u * k * page.stride + l;
        rgb += (*basis)[k] * vec3<f32>(sh[at], sh[at + page.stride], sh[at + 2u * page.stride]);
    }
    return rgb;
}

// Zero for the zero vector.
fn direction(v: vec3<f32>) -> vec3<f32> {
    let l = length(v);
    return select(vec3<f32>(0.0), v / max(l, 1e-30), l > 0.0);
}
