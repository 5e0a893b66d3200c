// The digits of keys. Each invocation of a workgroup handles every WIDTH-th key of a block, so that
// neighbours read neighbours.
#import shared/grid.wgsl
#import shared/sort.wgsl

fn digit_of(key: u32, shift: u32) -> u32 {
    return (key >> shift) & (DIGITS - 1u);
}
