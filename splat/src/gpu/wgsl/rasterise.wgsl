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
// A tile's pixels go in eight parts of 8 x 4, each looked after by 32 threads in a row.
const PART: vec2<u32> = vec2<u32>(8u, 4u);

var<workgroup> batch_a: array<vec4<f32>, 256>;
var<workgroup> batch_b: array<vec4<f32>, 256>;
var<workgroup> batch_c: array<vec4<f32>, 256>;
// Which of the batch reach a part: [part][8 words of 32].
var<workgroup> reach: array<atomic<u32>, 64>;
var<workgroup> open: atomic<u32>;        // pixels that are not finished
var<workgroup> open_now: u32;
var<workgroup> last: atomic<u32>;

// A thread's pixel in its tile.
fn place_of(local: u32) -> vec2<u32> {
    let part = vec2<u32>(local / 32u % 2u, local / 64u);
    return part * PART + vec2<u32>(local % 8u, local % 32u / 8u);
}

// The parts of a tile that the box of the ellipse alpha >= 1/255 of pair k of the batch reaches:
// its half height is known, and width to height are as the roots of the conic's yy to xx.
fn note_parts(k: u32, a: vec4<f32>, b: vec4<f32>, corner: vec2<u32>) {
    let half = vec2<f32>(b.w * sqrt(b.x / a.z) * 1.0001 + 0.01, b.w);
    // Centres of pixels from the first to the last within reach, in parts.
    let least = (a.xy - half - vec2<f32>(corner) - 0.5) / vec2<f32>(PART);
    let most = (a.xy + half - vec2<f32>(corner) - 0.5) / vec2<f32>(PART);
    let low = vec2<u32>(clamp(floor(least), vec2<f32>(0.0), vec2<f32>(2.0, 4.0)));
    let high = min(vec2<u32>(clamp(floor(most) + 1.0, vec2<f32>(0.0), vec2<f32>(2.0, 4.0))), vec2<u32>(2u, 4u));
    for (var y = low.y; y < high.y; y++) {
        for (var x = low.x; x < high.x; x++) {
            atomicOr(&reach[(2u * y + x) * 8u + k / 32u], 1u << (k % 32u));
        }
    }
}

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let tile = group_number(group, groups);
    let real = tile < frame.tiles.x * frame.tiles.y;
    let corner = vec2<u32>(tile % frame.tiles.x, tile / frame.tiles.x) * TILE;
    let place = place_of(local);
    let pixel = corner + place;
    let own = place.y * TILE + place.x;   // the pixel's state among the tile's
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
        if (local < 64u) {
            atomicStore(&reach[local], 0u);
        }
        workgroupBarrier();
        if (!finished) {
            atomicAdd(&open, 1u);
        }
        if (first + local < range.y) {
            let i = sorted[first + local].x;
            let a = records[2u * i];
            let b = records[2u * i + 1u];
            batch_a[local] = a;
            batch_b[local] = b;
            batch_c[local] = colours[i];
            note_parts(local, a, b, corner);
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
        for (var word = 0u; word < 8u; word++) {
            let bits = atomicLoad(&reach[local / 32u * 8u + word]);
            let here = kept && begins / 32u == word;
            let before = select(0xffffffffu, (1u << (begins % 32u)) - 1u, here);
            for (var side = 0u; side < 2u; side++) {
                var left = bits & select(~before, before, side == 0u);
                while (left != 0u && !finished) {
                    let k = 32u * word + firstTrailingBit(left);
                    left &= left - 1u;
                    let a = batch_a[k];
                    let b = batch_b[k];
                    let d = a.xy - centre;
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
                if (here && side == 0u) {
                    let state = frame.size.x * frame.size.y + (first + begins) / SPAN * 256u + own;
                    image[state] = vec4<f32>(rgb, select(t, 0.0, finished));
                }
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
