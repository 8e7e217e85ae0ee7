// A stable sort of numbers and their values by one digit of 4 bits, and prefix sums. For each
// digit, the runs of neighbouring blocks follow one another, so equal numbers keep their order.

struct Job { count: u32, shift: u32, blocks: u32, to_scan: u32 }

@group(0) @binding(0) var<storage, read> job: Job;
@group(0) @binding(1) var<storage, read> keys_in: array<u32>;
@group(0) @binding(2) var<storage, read> values_in: array<u32>;
@group(0) @binding(3) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(4) var<storage, read_write> values_out: array<u32>;
@group(0) @binding(5) var<storage, read_write> numbers: array<u32>;  // (16, blocks) counts, then sums

const THREADS = 256u;
const PER_THREAD = SORT_BLOCK / THREADS;

fn group_index(group: vec3<u32>) -> u32 { return group.x + group.y * GROUPS_IN_ROW; }
fn digit(key: u32) -> u32 { return (key >> job.shift) & 15u; }

var<workgroup> found: array<atomic<u32>, 16>;

@compute @workgroup_size(THREADS)
fn count_digits(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let block = group_index(group);
    if (lane < 16u) { atomicStore(&found[lane], 0u); }  // not every driver clears it
    workgroupBarrier();
    for (var i = 0u; i < PER_THREAD; i++) {
        let at = block * SORT_BLOCK + i * THREADS + lane;
        if (at < job.count) { atomicAdd(&found[digit(keys_in[at])], 1u); }
    }
    workgroupBarrier();
    if (lane < 16u && block < job.blocks) {
        numbers[lane * job.blocks + block] = atomicLoad(&found[lane]);
    }
}

// Counters of two digits in one word: thread by thread, word by word.
var<workgroup> table: array<u32, 8u * THREADS>;

@compute @workgroup_size(THREADS)
fn scatter(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let block = group_index(group);
    let first = block * SORT_BLOCK + lane * PER_THREAD;
    var own = array<u32, 8>();
    for (var i = 0u; i < PER_THREAD; i++) {
        if (first + i < job.count) {
            let d = digit(keys_in[first + i]);
            own[d / 2u] += 1u << (16u * (d % 2u));
        }
    }
    for (var w = 0u; w < 8u; w++) { table[w * THREADS + lane] = own[w]; }
    for (var step = 1u; step < THREADS; step *= 2u) {
        var earlier = array<u32, 8>();
        workgroupBarrier();
        if (lane >= step) {
            for (var w = 0u; w < 8u; w++) { earlier[w] = table[w * THREADS + lane - step]; }
        }
        workgroupBarrier();
        for (var w = 0u; w < 8u; w++) { table[w * THREADS + lane] += earlier[w]; }
    }
    for (var w = 0u; w < 8u; w++) { own[w] = table[w * THREADS + lane] - own[w]; }
    for (var i = 0u; i < PER_THREAD; i++) {
        if (first + i < job.count) {
            let key = keys_in[first + i];
            let d = digit(key);
            let half = 16u * (d % 2u);
            let to = numbers[d * job.blocks + block] + ((own[d / 2u] >> half) & 0xffffu);
            own[d / 2u] += 1u << half;
            keys_out[to] = key;
            values_out[to] = values_in[first + i];
        }
    }
}

const CHUNK = 4u * THREADS;
var<workgroup> sums: array<u32, THREADS>;

// See project.wgsl.
fn saturated(a: u32, b: u32) -> u32 { return select(a + b, 0xffffffffu, a + b < a); }

// Replaces each of `to_scan` numbers by the sum of those before it. The sum of all follows the
// last. One group, a chunk at a time.
@compute @workgroup_size(THREADS)
fn scan(@builtin(local_invocation_index) lane: u32) {
    var before = 0u;
    for (var chunk = 0u; chunk < job.to_scan; chunk += CHUNK) {
        var own = array<u32, 4>();
        var sum = 0u;
        for (var i = 0u; i < 4u; i++) {
            let at = chunk + 4u * lane + i;
            if (at < job.to_scan) {
                own[i] = numbers[at];
                sum = saturated(sum, own[i]);
            }
        }
        sums[lane] = sum;
        for (var step = 1u; step < THREADS; step *= 2u) {
            var earlier = 0u;
            workgroupBarrier();
            if (lane >= step) { earlier = sums[lane - step]; }
            workgroupBarrier();
            sums[lane] = saturated(sums[lane], earlier);
        }
        workgroupBarrier();
        var so_far = before;
        if (lane > 0u) { so_far = saturated(before, sums[lane - 1u]); }
        for (var i = 0u; i < 4u; i++) {
            let at = chunk + 4u * lane + i;
            if (at < job.to_scan) { numbers[at] = so_far; }
            so_far = saturated(so_far, own[i]);
        }
        before = saturated(before, sums[THREADS - 1u]);
        workgroupBarrier();
    }
    if (lane == 0u) { numbers[job.to_scan] = before; }
}
