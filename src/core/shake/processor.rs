//! Kernels and responses in the form of the shake for processors.

use fled_cpu::shake::{Kernel, Response as Table, Tap as Moved};

use super::response::KNOTS;
use super::{Response, ShakeKernel};

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
