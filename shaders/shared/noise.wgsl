// What the kernels of the noise field share. A cell is a point of the image at which the network is
// evaluated: 8 x 8 px in mode `grid`, one pixel in mode `paper`. Between the centres of the cells
// the noise is bilinear; outside of the outermost centres it is constant.

struct NoiseUniform {
    // Rows of the rotation from world to camera.
    row_x: vec4<f32>,
    row_y: vec4<f32>,
    row_z: vec4<f32>,
    // Focal lengths and principal point, px.
    focal: vec2<f32>,
    centre: vec2<f32>,
    // Image size, px.
    width: u32,
    height: u32,
    // Cells along x and y.
    columns: u32,
    rows: u32,
    // Side of a cell, px.
    scale: u32,
    // Octaves of the position's encoding, and floats a row of it.
    octaves: u32,
    encoded_stride: u32,
    // 1: n = A tanh, each channel's mean removed. 0: n = A sigmoid.
    centred: u32,
    // A, and the derivative of the penalty by n over n.
    amplitude: f32,
    penalty: f32,
    padding_0: u32,
    padding_1: u32,
}

struct ChunkUniform {
    // First cell and number of cells that pass through the network together.
    first: u32,
    count: u32,
    padding_0: u32,
    padding_1: u32,
}

// A fully connected layer; sizes and offsets in vec4.
struct LayerUniform {
    inputs: u32,
    outputs: u32,
    input_stride: u32,
    output_stride: u32,
    // Where its weights [input][output] and its biases [output] begin.
    weights: u32,
    biases: u32,
    // Whether its output passes a ReLU, and whether its input came out of one.
    relu: u32,
    input_relu: u32,
    // 1: its output has a row for every cell of the image, not only of the chunk.
    whole: u32,
    // Parts of the rows that are summed apart, and vec4s of all parameters.
    segments: u32,
    parameters: u32,
    padding: u32,
}

// Position of a pixel's centre in units of cells, between the first and the last cell's centre.
fn cell_position(pixel: u32, scale: u32, cells: u32) -> f32 {
    return clamp((f32(pixel) + 0.5) / f32(scale) - 0.5, 0.0, f32(cells - 1u));
}

// Weight of a cell at a pixel, along one axis.
fn tent(pixel: u32, cell: u32, scale: u32, cells: u32) -> f32 {
    return max(0.0, 1.0 - abs(cell_position(pixel, scale, cells) - f32(cell)));
}

// First pixel, and the one past the last, on which a cell may have weight along one axis.
fn support(cell: u32, scale: u32, pixels: u32) -> vec2<u32> {
    let begin = cell * scale;
    let before = scale / 2u + 1u;
    return vec2<u32>(begin - min(begin, before), min(begin + scale + before, pixels));
}
