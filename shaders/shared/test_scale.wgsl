// Used only by the tests of the crate `fled-gpu`: an import within an import.
#import shared/grid.wgsl

struct TestScale {
    factor: f32,
    count: u32,
}
