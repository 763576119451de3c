// The multiresolution hash encoding (the twin of hash_grid.rs): a thread a point and level.

struct Job {
    points: u32,
    // Vectors of four features in a row.
    width: u32,
}

struct Level {
    scale: f32,
    strides: array<u32, 3>,
    dense: u32,
    entries: u32,
    // First entry among those of all levels.
    first: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> levels: array<Level>;
@group(0) @binding(2) var<storage, read> points: array<f32>;
@group(0) @binding(3) var<storage, read> tables: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> features: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> sums: array<atomic<u32>>;

struct Cell {
    low: vec3u,
    share: vec3f,
}

fn cell(at: u32, level: u32) -> Cell {
    var out: Cell;
    for (var a = 0u; a < 3u; a++) {
        // NaN becomes 0.
        var p = points[3u * at + a];
        p = select(0.0, min(p, 1.0), p > 0.0);
        let x = p * levels[level].scale + 0.5;
        out.low[a] = u32(x);
        out.share[a] = x - f32(u32(x));
    }
    return out;
}

// The entry of a corner among those of all levels.
fn entry(cell: Cell, level: u32, corner: u32) -> u32 {
    var mixed = 0u;
    var added = 0u;
    for (var a = 0u; a < 3u; a++) {
        let part = (cell.low[a] + ((corner >> a) & 1u)) * levels[level].strides[a];
        mixed ^= part;
        added += part;
    }
    let own = select(mixed & (levels[level].entries - 1u), added, levels[level].dense != 0u);
    return levels[level].first + min(own, levels[level].entries - 1u);
}

fn share(cell: Cell, corner: u32) -> f32 {
    var product = 1.0;
    for (var a = 0u; a < 3u; a++) {
        product *= select(1.0 - cell.share[a], cell.share[a], ((corner >> a) & 1u) != 0u);
    }
    return product;
}

@compute @workgroup_size(256)
fn encode(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let at = group.x * 256u + local;
    if (at >= job.points) {
        return;
    }
    let cell = cell(at, group.y);
    var sum = vec4f();
    for (var corner = 0u; corner < 8u; corner++) {
        sum += share(cell, corner) * tables[entry(cell, group.y, corner)];
    }
    features[at * job.width + group.y] = sum;
}

// Adds the gradients of the features, which take their place, to those of the corners.
@compute @workgroup_size(256)
fn scatter(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let at = group.x * 256u + local;
    if (at >= job.points) {
        return;
    }
    let gradient = features[at * job.width + group.y];
    if (all(gradient == vec4f())) {
        return;
    }
    let cell = cell(at, group.y);
    for (var corner = 0u; corner < 8u; corner++) {
        let own = share(cell, corner) * gradient;
        let first = 8u * entry(cell, group.y, corner);
        for (var k = 0u; k < 4u; k++) {
            let words = to_fixed(own[k]);
            if ((words.x | words.y) == 0u) {
                continue;
            }
            let old = atomicAdd(&sums[first + 2u * k], words.x);
            let high = words.y + select(0u, 1u, old + words.x < old);
            if (high != 0u) {
                atomicAdd(&sums[first + 2u * k + 1u], high);
            }
        }
    }
}
