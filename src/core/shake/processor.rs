//! The shake on processors.

use fled_cpu::shake::{Kernel, Response as Table, Shake, Tap as Moved};

use super::reference::ReferenceShake;
use super::response::KNOTS;
use super::{Response, ShakeKernel};
use crate::image::Image;

/// Applies a view's shake to its render.
pub fn shaken_image(render: &Image, kernel: &ShakeKernel, response: &Response) -> Image {
    let size = [render.width(), render.height()];
    if !fled_cpu::is_supported() {
        // Only beside a GPU: the processor itself trains nothing then.
        let values: Vec<f64> = render.data().iter().map(|&value| f64::from(value)).collect();
        let shaken = ReferenceShake { size, kernel, response }.shaken(&values).into_iter();
        return Image::from_planar(size[0], size[1], shaken.map(|value| value as f32).collect());
    }
    let mut shake = Shake::default();
    shake.forward(render.data(), &kernel.on_processor(size), &response.on_processor());
    Image::from_planar(size[0], size[1], shake.blurred)
}

impl ShakeKernel {
    /// For images of `size` = [width, height] px.
    pub fn on_processor(&self, size: [usize; 2]) -> Kernel {
        let taps = self.taps.iter().map(|tap| Moved { offset: tap.offset, weights: tap.weights });
        Kernel::new(taps.collect(), size)
    }
}

impl Response {
    /// With tables for both directions.
    pub fn on_processor(&self) -> Table {
        let knots: &[f32; KNOTS] = self.knots().try_into().expect("as many as the table has");
        Table::new(knots)
    }
}
