// Shared by both kernels of the training loss: sizes, the Gaussian window, the packed target.
// An invocation owns COLUMNS neighbouring columns over `run` rows of one channel; it walks down
// them and keeps ten partial sums a column, so each row is read and blurred horizontally once.

// Columns an invocation; it reads 5 more on either side.
const COLUMNS: u32 = 4u;
const RADIUS: u32 = 5u;

// The Gaussian of 11 taps, sigma 1.5, normalised; symmetric, so 6 numbers.
const G0: f32 = 0.00102838008;
const G1: f32 = 0.00759875813;
const G2: f32 = 0.03600077;
const G3: f32 = 0.10936069;
const G4: f32 = 0.21300554;
const G5: f32 = 0.26601172;

// (0.01)^2 and (0.03)^2 of Wang et al. 2004, data range 1.
const C1: f32 = 1e-4;
const C2: f32 = 9e-4;

struct LossUniform {
    // Image size, px.
    width: u32,
    height: u32,
    // Rows an invocation.
    run: u32,
    // Invocations along x and along y.
    blocks_x: u32,
    blocks_y: u32,
    // 0.8 / (3 H W) and 0.2 / (3 H W).
    l1_weight: f32,
    ssim_weight: f32,
    // 3 H W.
    values: u32,
}

// The part of the image owned by an invocation.
struct Block {
    // First column and row.
    x: u32,
    y: u32,
    // Index of the channel's first value in a planar image.
    plane: u32,
    // Whether the part is not empty.
    valid: bool,
}

fn block_of(invocation: u32, size: LossUniform) -> Block {
    let x = invocation % size.blocks_x;
    let rest = invocation / size.blocks_x;
    let channel = rest / size.blocks_y;
    return Block(x * COLUMNS, (rest % size.blocks_y) * size.run, channel * size.width * size.height,
        channel < 3u);
}

// The value at an index of a packed planar image, from the `word` that holds it: an even index is
// in the lower half.
fn unpacked(word: u32, index: u32) -> f32 {
    let pair = unpack2x16unorm(word);
    return select(pair.x, pair.y, (index & 1u) == 1u);
}
