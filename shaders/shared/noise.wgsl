// Shared by the kernels of the noise field.

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
    // A: the noise lies between 0 and this.
    amplitude: f32,
    // Octaves of the position's encoding. A constant would let a compiler fold the sines of the
    // position's third coordinate by another library than the device's.
    octaves: u32,
}

struct ChunkUniform {
    // First pixel and number of pixels that pass through the network together.
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
    // 1: its output has a row for every pixel of the image, not only of the chunk.
    whole: u32,
    // Parts of the rows that are summed apart, and vec4s of all parameters.
    segments: u32,
    parameters: u32,
    padding: u32,
}

// The noise for an output of the network.
fn noise_of(raw: vec4<f32>, amplitude: f32) -> vec3<f32> {
    return amplitude / (1.0 + exp(-raw.xyz));
}
