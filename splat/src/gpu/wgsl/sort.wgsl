// sort: one pass of a stable radix sort of (key, value) pairs by four bits of the key.
// histogram: keys -> table [16][blocks], how many keys of each digit a block of 2,048 holds; then
// the table is scanned;
// scatter: each pair to table[digit][block] + its rank among the block's keys of that digit.
// Satish, Harris, Garland 2009, "Designing Efficient Sorting Algorithms for Manycore GPUs".

struct Job {
    shift: u32,
    count: u32,    // entry of the counters: how many pairs there are
    blocks: u32,   // columns of the table
    limit: u32,    // never more than this
    number: u32,   // 1: values_in is not read, the value of a pair is its number
    spare0: u32,
    spare1: u32,
    spare2: u32,
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read_write> table: array<u32>;
@group(0) @binding(3) var<storage, read> keys_in: array<u32>;
@group(0) @binding(4) var<storage, read> values_in: array<u32>;
@group(0) @binding(5) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(6) var<storage, read_write> values_out: array<u32>;

const EACH: u32 = 8u;
const BLOCK: u32 = 2048u;

var<workgroup> digits: array<atomic<u32>, 16>;
// Counts of 16 digits, two to a word of 16 bits each, scanned over the threads: [word][thread], or
// [word][subgroup].
var<workgroup> ranks: array<array<u32, 256>, 8>;

fn digit_of(key: u32) -> u32 {
    return (key >> job.shift) & 15u;
}

fn count() -> u32 {
    return min(counters[job.count], job.limit);
}

@compute @workgroup_size(256)
fn histogram(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let block = group_number(group, groups);
    if (local < 16u) {
        atomicStore(&digits[local], 0u);
    }
    workgroupBarrier();
    let n = count();
    for (var k = 0u; k < EACH; k++) {
        let i = block * BLOCK + k * 256u + local;
        if (i < n) {
            atomicAdd(&digits[digit_of(keys_in[i])], 1u);
        }
    }
    workgroupBarrier();
    if (local < 16u && block < job.blocks) {
        table[local * job.blocks + block] = atomicLoad(&digits[local]);
    }
}

@compute @workgroup_size(256)
fn scatter(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32/*lanes*/) {
    let block = group_number(group, groups);
    let n = count();
    let first = block * BLOCK + local * EACH;
    var own: array<u32, 8>;
    var keys: array<u32, 8>;
    for (var k = 0u; k < EACH; k++) {
        if (first + k < n) {
            let key = keys_in[first + k];
            keys[k] = key;
            let digit = digit_of(key);
            own[digit / 2u] += 1u << (16u * (digit & 1u));
        }
    }
    var sums = own;
//#if subgroups
    for (var w = 0u; w < 8u; w++) {
        sums[w] = subgroupInclusiveAdd(own[w]);
        if (subgroup_lane == lanes - 1u) {
            ranks[w][local / lanes] = sums[w];
        }
    }
    workgroupBarrier();
    for (var w = 0u; w < 8u; w++) {
        for (var k = 0u; k < local / lanes; k++) {
            sums[w] += ranks[w][k];
        }
    }
//#else
    for (var w = 0u; w < 8u; w++) {
        ranks[w][local] = own[w];
    }
    workgroupBarrier();
    for (var step = 1u; step < 256u; step *= 2u) {
        var left: array<u32, 8>;
        if (local >= step) {
            for (var w = 0u; w < 8u; w++) {
                left[w] = ranks[w][local - step];
            }
        }
        workgroupBarrier();
        for (var w = 0u; w < 8u; w++) {
            sums[w] += left[w];
            ranks[w][local] = sums[w];
        }
        workgroupBarrier();
    }
//#endif
    for (var w = 0u; w < 8u; w++) {
        sums[w] -= own[w];
    }
    for (var k = 0u; k < EACH; k++) {
        if (first + k < n) {
            let digit = digit_of(keys[k]);
            let shift = 16u * (digit & 1u);
            let rank = (sums[digit / 2u] >> shift) & 0xffffu;
            sums[digit / 2u] += 1u << shift;
            let to = table[digit * job.blocks + block] + rank;
            keys_out[to] = keys[k];
            var value = first + k;
            if (job.number == 0u) {
                value = values_in[first + k];
            }
            values_out[to] = value;
        }
    }
}
