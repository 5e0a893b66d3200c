// Shared by the kernels of the shake: sizes, and the knots between which the response is linear.

const KNOTS: u32 = 256u;

struct ShakeUniform {
    // Image size, px.
    width: u32,
    height: u32,
    // Taps in use.
    taps: u32,
    // Weight of the total variation.
    smooth_weight: f32,
}

// The knot below an encoded value, and how far it is beyond.
struct Place {
    knot: u32,
    part: f32,
}

fn place_of(value: f32) -> Place {
    let at = max(value, 0.0) * f32(KNOTS - 1u);
    let knot = min(u32(at), KNOTS - 2u);
    return Place(knot, at - f32(knot));
}

// The place of a pixel among the cells of a kernel.
struct Cells {
    // Its share in each of the three along the longer side.
    along: vec3<f32>,
    // Its share in the second three.
    second: f32,
}

// Linear between the middles of the cells.
fn cells_at(here: vec2<i32>, last: vec2<i32>) -> Cells {
    let place = (vec2<f32>(here) + 0.5) / vec2<f32>(last + 1);
    let turned = select(place.yx, place, last.x >= last.y);
    let along = clamp(3.0 * turned.x - 0.5, 0.0, 2.0);
    let near = 1.0 - abs(along - vec3<f32>(0.0, 1.0, 2.0));
    return Cells(max(near, vec3<f32>(0.0)), clamp(2.0 * turned.y - 0.5, 0.0, 1.0));
}

// A tap's weight there, from its weights in the first three cells and in the second three.
fn weight_in(cells: Cells, first: vec3<f32>, second: vec3<f32>) -> f32 {
    return dot(mix(first, second, cells.second), cells.along);
}
