// Moves the pairs of a block to their places by one 8-bit digit; stable.
// Reads parameters, counters, histogram [DIGITS, blocks] scanned by row, totals [DIGITS] of its
// rows, keys [n], payloads [n]. Writes keys_out [n], payloads_out [n]. Dispatch: a workgroup a
// block.
#import shared/radix.wgsl
#import shared/workgroup_scan.wgsl

@group(0) @binding(0) var<uniform> parameters: SortParameters;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> histogram: array<u32>;
@group(0) @binding(3) var<storage, read> totals: array<u32>;
@group(0) @binding(4) var<storage, read> keys: array<u32>;
@group(0) @binding(5) var<storage, read> payloads: array<u32>;
@group(0) @binding(6) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(7) var<storage, read_write> payloads_out: array<u32>;

const WORDS: u32 = WIDTH / 32;
const DIGITS_A_LANE: u32 = DIGITS / WIDTH;

// Where the next key of each digit goes.
var<workgroup> places: array<u32, DIGITS>;
// Which invocations have a key of a digit in this round, a bit each. Two sets, because one is
// cleared while the next round fills the other.
var<workgroup> holders: array<atomic<u32>, 2 * DIGITS * WORDS>;

fn begin(block: u32, blocks: u32, lane: u32) {
    for (var i = lane; i < 2u * DIGITS * WORDS; i += WIDTH) {
        atomicStore(&holders[i], 0u);
    }
    let first = lane * DIGITS_A_LANE;
    var sum = 0u;
    for (var digit = first; digit < first + DIGITS_A_LANE; digit++) {
        sum += totals[digit];
    }
    var before = workgroup_scan(sum, lane).before;
    for (var digit = first; digit < first + DIGITS_A_LANE; digit++) {
        places[digit] = before + histogram[digit * blocks + block];
        before += totals[digit];
    }
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let block = flat_workgroup(workgroup, workgroups);
    let n = min(counters[parameters.source], parameters.capacity);
    begin(block, (n + BLOCK - 1u) / BLOCK, lane);
    let own_word = lane / 32u;
    let own_bit = 1u << (lane % 32u);
    for (var round = 0u; round < ITEMS; round++) {
        let i = block * BLOCK + round * WIDTH + lane;
        let valid = i < n;
        let key = keys[min(i, n - 1u)];
        let payload = payloads[min(i, n - 1u)];
        let digit = digit_of(key, parameters.shift);
        let at = (round % 2u * DIGITS + digit) * WORDS;
        if (valid) {
            atomicOr(&holders[at + own_word], own_bit);
        }
        // All invocations have set their bits, and the places are those of this round.
        workgroupBarrier();
        // Holders of the same digit before this invocation, and all of them.
        var before = 0u;
        var all = 0u;
        for (var word = 0u; word < WORDS; word++) {
            let bits = atomicLoad(&holders[at + word]);
            let below = select(0u, own_bit - 1u, word == own_word);
            before += countOneBits(bits & select(below, 0xffffffffu, word < own_word));
            all += countOneBits(bits);
        }
        let place = places[digit] + before;
        // All have read the places.
        workgroupBarrier();
        if (valid) {
            keys_out[place] = key;
            payloads_out[place] = payload;
            atomicStore(&holders[at + own_word], 0u);
            if (before + 1u == all) {
                places[digit] = place + 1u;
            }
        }
    }
}
