// Projects one Gaussian an invocation: mean and inverse covariance on the image, colour from its
// harmonics, depth key, and the exact number of tiles it touches (0 when culled).
// Reads geometry [part, 12], sh [part, sh_row]. Writes projected [count, 3], depth_keys [count],
// and the numbers of tiles in spans [1 + count]. Dispatch: the part's rows.
// Sigma' = J W Sigma W^T J^T + 0.3 I, opacity = sigmoid(logit), colour = max(0.5 + sum sh Y(d), 0).
#import shared/gaussian_rows.wgsl
#import shared/grid.wgsl
#import shared/part.wgsl
#import shared/tiles.wgsl

const WIDTH: u32 = 64;

@group(0) @binding(0) var<uniform> camera: CameraUniform;
@group(0) @binding(1) var<uniform> part: PartUniform;
@group(0) @binding(2) var<storage, read> geometry: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> sh: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> projected: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> spans: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> depth_keys: array<u32>;

fn colour_of(row: u32, mean: vec3<f32>) -> vec3<f32> {
    let offset = mean - camera.position;
    let basis = sh_basis(offset / max(length(offset), 1e-12), camera.sh_degree);
    return max(harmonics_colour(load_harmonics(row), basis), vec3<f32>(0.0));
}

// Tiles touched by a splat that is not culled.
fn count_tiles(mean: vec2<f32>, conic: vec3<f32>, extent: vec2<f32>, limit: f32) -> u32 {
    let box = tile_box(mean, extent, camera.tiles);
    var count = 0u;
    for (var y = box.y; y < box.w; y++) {
        for (var x = box.x; x < box.z; x++) {
            count += u32(tile_touched(mean, conic, limit, vec2<u32>(x, y)));
        }
    }
    return count;
}

@compute @workgroup_size(WIDTH)
fn main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let row = flat_workgroup(workgroup, workgroups) * WIDTH + lane;
    let i = part.first + row;
    if (row >= part.rows || i >= camera.count) {
        return;
    }
    spans[1u + i].y = 0u;
    depth_keys[i] = 0xffffffffu;
    let g = load_geometry(row);
    if (!geometry_usable(g)) {
        return;
    }
    let shape = shape_of(g);
    let opacity = shape.opacity;
    let p = project_shape(g.mean, shape, camera);
    let limit = exponent_limit(opacity);
    if (!p.usable || limit < 0.0) {
        return;
    }
    let mean = camera.focal * p.point.xy / p.point.z + camera.centre;
    let conic = vec3<f32>(p.flat.z, -p.flat.y, p.flat.x) / p.determinant;
    let extent = splat_extent(p.flat.xz, opacity);
    let colour = colour_of(row, g.mean);
    if (!is_finite3(colour) || !is_finite3(conic)
        || !is_finite(mean.x + mean.y + extent.x + extent.y)) {
        return;
    }
    let count = count_tiles(mean, conic, extent, limit);
    if (count == 0u) {
        return;
    }
    projected[3u * i] = vec4<f32>(mean, conic.xy);
    projected[3u * i + 1u] = vec4<f32>(conic.z, opacity, colour.xy);
    projected[3u * i + 2u] = vec4<f32>(colour.z, p.point.z, extent);
    spans[1u + i].y = count;
    depth_keys[i] = bitcast<u32>(p.point.z);
}
