//! The blending kernels, and the choice among them for an adapter.

use fled_gpu::{AdapterInfo, Binding, Kernel, read, read_write, uniform};

const FORWARD_BINDINGS: &[Binding] = &[
    uniform("camera"),
    read_write("tile_ranges"),
    read("slots"),
    read("slot_words"),
    read("projected"),
    read_write("image"),
    read_write("transmittance"),
];
// All blending kernels are unchecked: they index vectors and workgroup arrays by loop counters and
// lanes, and storage below its `arrayLength`; their loops run over ranges clipped to it.
const RASTERIZE: Kernel = Kernel::new("splat/rasterize", FORWARD_BINDINGS).unchecked();
const BACKWARD_BINDINGS: &[Binding] = &[
    uniform("camera"),
    read("tile_ranges"),
    read("slots"),
    read_write("slot_words"),
    read("projected"),
    read("image"),
    read("image_gradient"),
    read_write("slot_colours"),
    read_write("slot_moments"),
];
const RASTERIZE_BACKWARD: Kernel =
    Kernel::new("splat/rasterize_backward", BACKWARD_BINDINGS).unchecked();
const RASTERIZE_BACKWARD_GENERIC: Kernel =
    Kernel::new("splat/rasterize_backward_generic", BACKWARD_BINDINGS).unchecked();

/// Invocations of a tile's workgroup: WIDTH of shaders/shared/raster.wgsl.
pub(super) const WIDTH: u32 = 64;
/// Lanes of the smallest subgroup that can hold eight of the nine sums.
const LEAST_SUBGROUP: u32 = 8;

/// The specialisation of the blending kernels. All give the same image to 1e-5.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Specialisation {
    /// Lanes of a subgroup if the backward pass reduces over it: 8, 16, 32 or 64; `None` reduces in
    /// workgroup memory.
    pub subgroup: Option<u32>,
}

impl Specialisation {
    /// The specialisation for an adapter: the shader is compiled for a known size of subgroups,
    /// which must divide the workgroup.
    pub fn for_adapter(info: &AdapterInfo) -> Self {
        let usable =
            |(least, most): &(u32, u32)| least == most && (LEAST_SUBGROUP..=WIDTH).contains(least);
        Self { subgroup: info.subgroup.filter(usable).map(|(size, _)| size) }
    }

    pub(super) fn forward(self) -> Kernel {
        RASTERIZE
    }

    pub(super) fn backward(self) -> Kernel {
        match self.subgroup {
            Some(size) => RASTERIZE_BACKWARD.with(&[("SUBGROUP", size)]),
            None => RASTERIZE_BACKWARD_GENERIC,
        }
    }
}
