// What the kernels of the shake share: sizes, and the knots between which the response is linear.

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
