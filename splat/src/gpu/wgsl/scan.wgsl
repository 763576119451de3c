// scan: exclusive prefix sums of u32, in place, in three dispatches: reduce, spine, sweep; or in
// one, whole, by one group where there are few values.
// in, out: data [n] · sums [ceil(n / 2048)] · counters[job.total] becomes the sum of all.
// Blelloch 1990, "Prefix Sums and Their Applications"; blocks of 2,048, 8 values a thread.

struct Job {
    n: u32,
    total: u32,   // entry of the counters
    spare0: u32,
    spare1: u32,
}

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read_write> data: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;
@group(0) @binding(3) var<storage, read_write> counters: array<u32>;

const EACH: u32 = 8u;
const BLOCK: u32 = 2048u;

var<workgroup> partial: array<u32, 256>;
var<workgroup> group_total: u32;

// Inclusive sums of `value` over the group's 256 threads; their total goes to `group_total`.
//#if subgroups
fn group_scan(local: u32, subgroup_lane: u32, lanes: u32, value: u32) -> u32 {
    let own = subgroupInclusiveAdd(value);
    if (subgroup_lane == lanes - 1u) {
        partial[local / lanes] = own;
    }
    workgroupBarrier();
    var sum = own;
    for (var k = 0u; k < local / lanes; k++) {
        sum += partial[k];
    }
    if (local == 255u) {
        group_total = sum;
    }
    workgroupBarrier();
    return sum;
}
//#else
fn group_scan(local: u32, value: u32) -> u32 {
    var sum = value;
    partial[local] = sum;
    workgroupBarrier();
    for (var step = 1u; step < 256u; step *= 2u) {
        var left = 0u;
        if (local >= step) {
            left = partial[local - step];
        }
        workgroupBarrier();
        sum += left;
        partial[local] = sum;
        workgroupBarrier();
    }
    if (local == 255u) {
        group_total = sum;
    }
    workgroupBarrier();
    return sum;
}
//#endif

fn read(i: u32) -> u32 {
    if (i < job.n) {
        return data[i];
    }
    return 0u;
}

@compute @workgroup_size(256)
fn reduce(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32/*lanes*/) {
    let block = group_number(group, groups);
    let first = block * BLOCK + local * EACH;
    var sum = 0u;
    for (var k = 0u; k < EACH; k++) {
        sum += read(first + k);
    }
    let inclusive = group_scan(local/*use lanes*/, sum);
    if (local == 255u && block * BLOCK < job.n) {
        sums[block] = inclusive;
    }
}

@compute @workgroup_size(256)
fn spine(@builtin(local_invocation_index) local: u32/*lanes*/) {
    let blocks = (job.n + BLOCK - 1u) / BLOCK;
    var carry = 0u;
    for (var first = 0u; first < blocks; first += 256u) {
        let i = first + local;
        var value = 0u;
        if (i < blocks) {
            value = sums[i];
        }
        let inclusive = group_scan(local/*use lanes*/, value);
        if (i < blocks) {
            sums[i] = carry + inclusive - value;
        }
        carry += group_total;
        workgroupBarrier();
    }
    if (local == 0u) {
        counters[job.total] = carry;
    }
}

@compute @workgroup_size(256)
fn sweep(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32/*lanes*/) {
    let block = group_number(group, groups);
    let first = block * BLOCK + local * EACH;
    var sum = 0u;
    for (var k = 0u; k < EACH; k++) {
        sum += read(first + k);
    }
    var running = group_scan(local/*use lanes*/, sum) - sum;
    if (block * BLOCK < job.n) {
        running += sums[block];
    }
    for (var k = 0u; k < EACH; k++) {
        let i = first + k;
        if (i < job.n) {
            let value = data[i];
            data[i] = running;
            running += value;
        }
    }
}

@compute @workgroup_size(256)
fn whole(@builtin(local_invocation_index) local: u32/*lanes*/) {
    var carry = 0u;
    for (var first = 0u; first < job.n; first += BLOCK) {
        var values: array<u32, 8>;
        var sum = 0u;
        for (var k = 0u; k < EACH; k++) {
            values[k] = read(first + local * EACH + k);
            sum += values[k];
        }
        var running = carry + group_scan(local/*use lanes*/, sum) - sum;
        carry += group_total;
        for (var k = 0u; k < EACH; k++) {
            let i = first + local * EACH + k;
            if (i < job.n) {
                data[i] = running;
                running += values[k];
            }
        }
        workgroupBarrier();
    }
    if (local == 0u) {
        counters[job.total] = carry;
    }
}
