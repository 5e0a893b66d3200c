// Walking a tile's list with the splats in registers. A subgroup blends half a tile: it loads as
// many splats as it has lanes, keeps those that touch its half, and hands them round by shuffles.
// There is no workgroup memory, and nobody waits. Needs `camera`, `slot_gaussian` and `projected`.
#import shared/raster.wgsl

// Lanes of a subgroup; times PIXELS it is half a tile.
const SUBGROUP: u32 = 8;
const HALVES: u32 = 2;
const HALF_ROWS: u32 = TILE / HALVES;

// A lane's own splat, and which halves of the tile it touches.
struct Own {
    splat: Splat,
    touches: array<bool, HALVES>,
}

fn own_splat(slot: u32, tile: u32) -> Own {
    let gaussian = slot_gaussian[min(slot, arrayLength(&slot_gaussian) - 1u)];
    let place = splat_row(gaussian, arrayLength(&projected));
    let first = projected[place];
    let second = projected[place + 1u];
    let splat = splat_of(first, second, projected[place + 2u]);
    let conic = vec3<f32>(first.zw, second.x);
    let limit = exponent_limit(second.y);
    let upper = vec2<u32>(tile % camera.tiles.x, tile / camera.tiles.x) * TILE;
    let lower = upper + vec2<u32>(0u, HALF_ROWS);
    let size = vec2<u32>(TILE, HALF_ROWS);
    let touches = array<bool, HALVES>(
        box_touched(first.xy, conic, limit, upper, size),
        box_touched(first.xy, conic, limit, lower, size),
    );
    return Own(splat, touches);
}

// The splat of lane `j`.
fn handed(own: Splat, j: u32) -> Splat {
    return Splat(
        vec4<f32>(
            subgroupShuffle(own.place.x, j),
            subgroupShuffle(own.place.y, j),
            subgroupShuffle(own.place.z, j),
            subgroupShuffle(own.place.w, j),
        ),
        vec3<f32>(subgroupShuffle(own.curve.x, j), subgroupShuffle(own.curve.y, j),
            subgroupShuffle(own.curve.z, j)),
        vec3<f32>(subgroupShuffle(own.colour.x, j), subgroupShuffle(own.colour.y, j),
            subgroupShuffle(own.colour.z, j)),
    );
}
