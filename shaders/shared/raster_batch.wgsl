// The splats of a batch in workgroup memory: for adapters whose invocations read one address at the
// price of one.
#import shared/raster.wgsl

var<workgroup> batch: array<Splat, WIDTH>;
