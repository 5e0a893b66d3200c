// An exclusive prefix sum over the workgroup, one value an invocation. The same order on every
// device.
#import shared/sort.wgsl

var<workgroup> scan_sums: array<u32, WIDTH>;

struct Scanned {
    // Sum of the values of the invocations before this one.
    before: u32,
    // Sum over the workgroup.
    total: u32,
}

// Must be reached by the whole workgroup.
fn workgroup_scan(value: u32, lane: u32) -> Scanned {
    // All reads of an earlier call's sums are done.
    workgroupBarrier();
    scan_sums[lane] = value;
    var sum = value;
    for (var step = 1u; step < WIDTH; step *= 2u) {
        // The sums of the last round are complete before they are read ...
        workgroupBarrier();
        let other = select(0u, scan_sums[max(lane, step) - step], lane >= step);
        // ... and have been read before they are replaced.
        workgroupBarrier();
        sum += other;
        scan_sums[lane] = sum;
    }
    workgroupBarrier();
    return Scanned(sum - value, scan_sums[WIDTH - 1u]);
}
