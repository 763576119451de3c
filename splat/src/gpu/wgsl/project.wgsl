// project: Gaussian i -> screen, and its colour.
// in: geometry [11][stride] · sh [3K][stride], of a page
// out: records [N][2] vec4: (x, y, conic xx, conic xy) · (conic yy, opacity, depth, half
// the height of the ellipse alpha >= 1/255) · colours
// [N]: (r, g, b, 0)
//      boxes [N][2]: half-open box of tiles, (x0 | y0 << 16, x1 | y1 << 16) · flags [N]: 1 where
//      seen
// Sigma' = J W Sigma W^T J^T + 0.3 I  (Zwicker 2002; 0.3 px^2 low-pass: Kerbl 2023). z < near: not
// seen.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> page: Page;
@group(0) @binding(2) var<storage, read> geometry: array<f32>;
@group(0) @binding(3) var<storage, read> sh: array<f32>;
@group(0) @binding(4) var<storage, read_write> records: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> colours: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> boxes: array<vec2<u32>>;
@group(0) @binding(7) var<storage, read_write> flags: array<u32>;

fn tile_of(v: f32, tiles: u32) -> u32 {
    return u32(clamp(floor(v / f32(TILE)), 0.0, f32(tiles)));
}

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let l = group_number(group, groups) * 256u + local;
    if (l >= page.count) {
        return;
    }
    let i = page.first + l;
    flags[i] = 0u;
    boxes[i] = vec2<u32>(0u);
    let p = project_gaussian(l);
    if (!p.seen) {
        return;
    }
    // Exact box of the ellipse alpha >= 1/255, with slack for rounding.
    let reach = 2.0 * log(p.opacity / MIN_ALPHA);
    let half = sqrt(max(reach, 0.0) * vec2<f32>(p.cov.x, p.cov.z)) * 1.0001 + 0.01;
    let low = p.xy - half;
    let high = p.xy + half;
    if (!(high.x > 0.0 && high.y > 0.0 && low.x < f32(frame.size.x) && low.y < f32(frame.size.y))) {
        return;
    }
    let x0 = tile_of(low.x, frame.tiles.x); let x1 = min(tile_of(high.x, frame.tiles.x) + 1u, frame.tiles.x);
    let y0 = tile_of(low.y, frame.tiles.y); let y1 = min(tile_of(high.y, frame.tiles.y) + 1u, frame.tiles.y);
    boxes[i] = vec2<u32>(x0 | (y0 << 16u), x1 | (y1 << 16u));
    flags[i] = 1u;

    let mean = vec3<f32>(plane(0u, l), plane(1u, l), plane(2u, l));
    var basis = sh_basis(direction(mean - frame.position.xyz));
    let rgb = max(sh_colour(l, &basis), vec3<f32>(0.0));
    records[2u * i] = vec4<f32>(p.xy, p.conic.xy);
    records[2u * i + 1u] = vec4<f32>(p.conic.z, p.opacity, p.x.z, half.y);
    colours[i] = vec4<f32>(rgb, 0.0);
}
