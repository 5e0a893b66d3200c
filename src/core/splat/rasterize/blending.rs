//! The blending kernels, and the choice among them for an adapter.

use fled_gpu::{AdapterInfo, Binding, DeviceType, Kernel, read, read_write, uniform};

use crate::splat::uniform::TILE;

const FORWARD_BINDINGS: &[Binding] = &[
    uniform("camera"),
    read("tile_ranges"),
    read("slots"),
    read("slot_gaussian"),
    read("projected"),
    read_write("image"),
    read_write("transmittance"),
    read_write("last"),
];
// All blending kernels are unchecked: they index private and workgroup arrays by loop counters and
// lanes, and storage below its `arrayLength`; their loops run over ranges clipped to it.
const RASTERIZE: Kernel = Kernel::new("splat/rasterize", FORWARD_BINDINGS).unchecked();
const RASTERIZE_WALK: Kernel = Kernel::new("splat/rasterize_walk", FORWARD_BINDINGS).unchecked();
const BACKWARD_BINDINGS: &[Binding] = &[
    uniform("camera"),
    read("tile_ranges"),
    read("slots"),
    read("slot_gaussian"),
    read("projected"),
    read("image"),
    read("image_gradient"),
    read("last"),
    read_write("slot_colours"),
    read_write("slot_moments"),
    read_write("slot_tails"),
];
const RASTERIZE_BACKWARD: Kernel =
    Kernel::new("splat/rasterize_backward", BACKWARD_BINDINGS).unchecked();
const RASTERIZE_BACKWARD_WALK: Kernel =
    Kernel::new("splat/rasterize_backward_walk", BACKWARD_BINDINGS).unchecked();
const RASTERIZE_BACKWARD_GENERIC: Kernel =
    Kernel::new("splat/rasterize_backward_generic", BACKWARD_BINDINGS).unchecked();

/// Pixels that a subgroup blends if it walks.
pub(super) const HALF_TILE: u32 = TILE * TILE / 2;

/// The specialisation of the blending kernels. All give the same image to 1e-5.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Specialisation {
    /// Consecutive pixels per invocation: 4, 8 or 16.
    pub pixels: u32,
    /// Lanes of a subgroup if the backward pass reduces over it: 8, 16, 32 or 64; `None` reduces in
    /// workgroup memory.
    pub subgroup: Option<u32>,
    /// Whether each subgroup blends half a tile, with the splats in its registers, instead of each
    /// workgroup a tile with the splats in its memory. Needs a subgroup of 128 / `pixels`.
    pub walks: bool,
}

impl Specialisation {
    /// The specialisation for an adapter. Software Vulkan needs few invocations with much work each
    /// (measured by the module's benchmark), a GPU many.
    pub fn for_adapter(info: &AdapterInfo) -> Self {
        let on_cpu = info.device_type == DeviceType::Cpu;
        // The shader is compiled for a known size of subgroups.
        let known = info
            .subgroup
            .filter(|(least, most)| least == most && *least >= 8)
            .map(|(size, _)| size);
        // Each subgroup takes half a tile, in vectors of four pixels.
        let walks = on_cpu && known.is_some_and(|size| matches!(size, 8 | 16 | 32));
        let pixels = match known {
            Some(size) if walks => HALF_TILE / size,
            _ if on_cpu => 16,
            _ => 4,
        };
        // It must divide the workgroup.
        let subgroup = known.filter(|size| *size <= TILE * TILE / pixels);
        Self { pixels, subgroup, walks }
    }

    /// Number of splats between two reductions: as many as fit into 32 KiB of workgroup memory, and
    /// at most one per invocation.
    fn group(self) -> u32 {
        let width = TILE * TILE / self.pixels;
        if self.subgroup.is_none() && width >= 64 { 8 } else { 16 }
    }

    pub(super) fn forward(self) -> Kernel {
        let pixels = ("PIXELS", self.pixels);
        match self.subgroup.filter(|_| self.walks) {
            Some(size) => RASTERIZE_WALK.with(&[pixels, ("SUBGROUP", size)]),
            None => RASTERIZE.with(&[pixels]),
        }
    }

    pub(super) fn backward(self) -> Kernel {
        let constants = [("PIXELS", self.pixels), ("GROUP", self.group())];
        match self.subgroup {
            Some(size) if self.walks => {
                RASTERIZE_BACKWARD_WALK.with(&[("PIXELS", self.pixels), ("SUBGROUP", size)])
            }
            Some(size) => RASTERIZE_BACKWARD.with(&constants).with(&[("SUBGROUP", size)]),
            None => RASTERIZE_BACKWARD_GENERIC.with(&constants),
        }
    }
}
