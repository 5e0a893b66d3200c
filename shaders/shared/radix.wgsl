// Counting the digits of a block: column `lane` of `digit_counts` belongs to one invocation, which
// owns ITEMS consecutive keys, so that equal digits keep their order.
#import shared/grid.wgsl
#import shared/sort.wgsl

var<workgroup> digit_counts: array<u32, DIGITS * WIDTH>;

fn clear_digits(lane: u32) {
    for (var digit = 0u; digit < DIGITS; digit++) {
        digit_counts[digit * WIDTH + lane] = 0u;
    }
}

fn digit_of(key: u32, shift: u32) -> u32 {
    return (key >> shift) & (DIGITS - 1u);
}
