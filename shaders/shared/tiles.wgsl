// Which 16 x 16 tiles a splat touches. Counting and emitting call the same function, so they cannot
// disagree; the test is exact but for a slack that covers f32 rounding, so no pixel with alpha >=
// 1/255 is lost.
#import shared/camera.wgsl

const ALPHA_CUT: f32 = 1.0 / 255.0;

// The exponent at which alpha falls to the cut: opacity * exp(-limit) = 1/255. Negative: invisible.
fn exponent_limit(opacity: f32) -> f32 {
    return log(max(opacity, 1e-12) * 255.0);
}

// Half size in px of the box around the pixels a splat can touch; `variance` is the diagonal
// of its 2-D covariance, px^2.
fn splat_extent(variance: vec2<f32>, opacity: f32) -> vec2<f32> {
    return sqrt(max(2.0 * exponent_limit(opacity) * variance, vec2<f32>(0.0)));
}

// First tile (xy) and one past the last (zw) of the box; empty when it lies outside the image.
fn tile_box(mean: vec2<f32>, extent: vec2<f32>, tiles: vec2<u32>) -> vec4<u32> {
    let limit = vec2<f32>(tiles);
    let width = f32(TILE);
    let low = clamp(floor((mean - extent) / width), vec2<f32>(0.0), limit);
    let high = clamp(ceil((mean + extent) / width), vec2<f32>(0.0), limit);
    return vec4<u32>(vec2<u32>(low), vec2<u32>(high));
}

// Least exponent 0.5 (a dx^2 + c dy^2) + b dx dy along an edge where one offset is fixed.
// `along`: curvature of the free axis, `across`: of the fixed one.
fn edge_exponent(fixed: f32, along: f32, across: f32, cross: f32, low: f32, high: f32) -> f32 {
    let free = clamp(-cross * fixed / max(along, 1e-20), low, high);
    return 0.5 * (across * fixed * fixed + along * free * free) + cross * fixed * free;
}

// Whether the splat reaches alpha 1/255 at some pixel centre's position inside a tile.
// `conic`: (a, b, c); `limit`: exponent_limit(opacity).
fn tile_touched(mean: vec2<f32>, conic: vec3<f32>, limit: f32, tile: vec2<u32>) -> bool {
    // Offsets of the outermost pixel centres from the mean.
    let low = vec2<f32>(tile * TILE) + vec2<f32>(0.5) - mean;
    let high = low + vec2<f32>(f32(TILE - 1u));
    // The nearest offset of the tile to the mean, by axis: 0 where the mean lies inside.
    let near = clamp(vec2<f32>(0.0), low, high);
    if (near.x == 0.0 && near.y == 0.0) {
        return limit >= 0.0;
    }
    // The minimum of a convex quadratic outside its centre lies on an edge that faces it.
    var least = 3.0e38;
    if (near.x != 0.0) {
        least = edge_exponent(near.x, conic.z, conic.x, conic.y, low.y, high.y);
    }
    if (near.y != 0.0) {
        least = min(least, edge_exponent(near.y, conic.x, conic.z, conic.y, low.x, high.x));
    }
    return least <= limit * 1.0001 + 1e-3;
}
