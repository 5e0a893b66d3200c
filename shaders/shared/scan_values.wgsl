// An exclusive prefix sum of consecutive `values` by one workgroup, in place.
#import shared/workgroup_scan.wgsl

// Scans `n` values from `start` on, and returns their sum. Must be reached by the whole workgroup.
fn scan_values(start: u32, n: u32, lane: u32) -> u32 {
    let chunk = (n + WIDTH - 1u) / WIDTH;
    let first = start + min(lane * chunk, n);
    let last = start + min(lane * chunk + chunk, n);
    var sum = 0u;
    for (var i = first; i < last; i++) {
        sum += values[i];
    }
    let scanned = workgroup_scan(sum, lane);
    var before = scanned.before;
    for (var i = first; i < last; i++) {
        let value = values[i];
        values[i] = before;
        before += value;
    }
    return scanned.total;
}
