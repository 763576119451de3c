// rasterise: the Gaussians of a tile -> its pixels, front to back.
// in: records · colours · sorted [pairs] (Gaussian, pair number) by tile · ranges [tiles] (begin,
// end, -, -)
// out: image [H * W] (rgb over the background, transmittance) · depth [H * W] expected z ·
// ranges.z: pairs looked at
//      where asked for, after the image: [blocks of SPAN pairs][256] (rgb so far, transmittance; 0:
//      finished) of the tile's pixels where a block begins within the tile
// C = sum of T alpha rgb + T background (Kerbl 2023, eq. 3); skip alpha < 1/255, stop before T <
// 1e-4.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> colours: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> sorted: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read_write> ranges: array<vec4<u32>>;
@group(0) @binding(5) var<storage, read_write> image: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> depth: array<f32>;

const BATCH: u32 = 256u;

var<workgroup> batch_a: array<vec4<f32>, 256>;
var<workgroup> batch_b: array<vec4<f32>, 256>;
var<workgroup> batch_c: array<vec4<f32>, 256>;
var<workgroup> open: atomic<u32>;        // pixels that are not finished
var<workgroup> open_now: u32;
var<workgroup> last: atomic<u32>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let tile = group_number(group, groups);
    let real = tile < frame.tiles.x * frame.tiles.y;
    let pixel = vec2<u32>(tile % frame.tiles.x, tile / frame.tiles.x) * TILE + vec2<u32>(local % TILE, local / TILE);
    let inside = real && pixel.x < frame.size.x && pixel.y < frame.size.y;
    let centre = vec2<f32>(pixel) + 0.5;
    var range = vec2<u32>(0u);
    if (real) {
        range = ranges[tile].xy;
    }
    var t = 1.0;
    var rgb = vec3<f32>(0.0);
    var far = 0.0;
    var seen_to = 0u;
    var finished = !inside;
    if (local == 0u) {
        atomicStore(&last, 0u);
    }
    for (var first = range.x; first < range.y; first += BATCH) {
        if (local == 0u) {
            atomicStore(&open, 0u);
        }
        workgroupBarrier();
        if (!finished) {
            atomicAdd(&open, 1u);
        }
        if (first + local < range.y) {
            let i = sorted[first + local].x;
            batch_a[local] = records[2u * i];
            batch_b[local] = records[2u * i + 1u];
            batch_c[local] = colours[i];
        }
        workgroupBarrier();
        if (local == 0u) {
            open_now = atomicLoad(&open);
        }
        if (workgroupUniformLoad(&open_now) == 0u) {
            break;
        }
        let count = min(BATCH, range.y - first);
        // A batch is as long as a block: one block at most begins in it.
        let begins = (SPAN - first % SPAN) % SPAN;
        let kept = begins < count && first + begins > range.x && (frame.flags & KEEP) != 0u;
        var k = 0u;
        for (var part = 0u; part < 2u; part++) {
            let to = select(count, min(begins, count), part == 0u);
            for (; k < to && !finished; k++) {
                let a = batch_a[k];
                let b = batch_b[k];
                let d = a.xy - centre;
                if (abs(d.y) > b.w) {
                    continue;
                }
                let power = 0.5 * (a.z * d.x * d.x + b.x * d.y * d.y) + a.w * d.x * d.y;
                let alpha = min(MAX_ALPHA, b.y * exp(-power));
                if (power < 0.0 || alpha < MIN_ALPHA) {
                    continue;
                }
                let next = t * (1.0 - alpha);
                if (next < MIN_TRANSMITTANCE) {
                    finished = true;
                    break;
                }
                let weight = t * alpha;
                rgb += weight * batch_c[k].xyz;
                far += weight * b.z;
                t = next;
                seen_to = first + k + 1u - range.x;
            }
            if (part == 0u && kept) {
                let state = frame.size.x * frame.size.y + (first + begins) / SPAN * 256u + local;
                image[state] = vec4<f32>(rgb, select(t, 0.0, finished));
            }
        }
        workgroupBarrier();
    }
    workgroupBarrier();
    atomicMax(&last, seen_to);
    workgroupBarrier();
    if (inside) {
        let at = pixel.y * frame.size.x + pixel.x;
        image[at] = vec4<f32>(rgb + t * frame.background.xyz, t);
        depth[at] = select(0.0, far / max(1.0 - t, 1e-30), t < 1.0);
    }
    if (local == 0u && real) {
        ranges[tile].z = atomicLoad(&last);
    }
}
