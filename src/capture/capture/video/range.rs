//! Videos with a brightness range larger than sRGB.

use std::fmt;

use crate::image::hdr::{HdrTransfer, PEAK, WHITE};

/// A larger range, and how it is handled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hdr {
    transfer: HdrTransfer,
    is_converted: bool,
}

impl Hdr {
    /// The range of the first frame, from the output of `showinfo`.
    pub(super) fn of(log: &str) -> Option<Self> {
        let transfer = if log.contains("color_trc:arib-std-b67") {
            HdrTransfer::Hlg
        } else if log.contains("color_trc:smpte2084") {
            HdrTransfer::Pq
        } else {
            return None;
        };
        Some(Self { transfer, is_converted: true })
    }

    /// The same range, for an ffmpeg that cannot convert it.
    pub(super) fn left(self) -> Self {
        Self { is_converted: false, ..self }
    }

    /// Filters to append that convert it to sRGB: linear up to three tenths of white, as the dark
    /// range matters here, and compressed above, up to the peak.
    pub(super) fn filters(self) -> String {
        if !self.is_converted {
            return String::new();
        }
        let transfer = match self.transfer {
            HdrTransfer::Hlg => "arib-std-b67",
            HdrTransfer::Pq => "smpte2084",
        };
        format!(
            ",zscale=tin={transfer}:pin=bt2020:min=2020_ncl:t=linear:npl={WHITE}\
             ,format=gbrpf32le,zscale=p=bt709,tonemap=mobius:desat=0:peak={}\
             ,zscale=t=iec61966-2-1:m=gbr:r=full,format=gbrp16le",
            PEAK / WHITE
        )
    }
}

impl fmt::Display for Hdr {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.transfer;
        if self.is_converted {
            return write!(f, "it is HDR ({name}) and was tone-mapped to sRGB");
        }
        write!(
            f,
            "it is HDR ({name}), and this ffmpeg has no filters `zscale` and `tonemap` to make \
             sRGB of it: its brightness and colours are wrong; switch HDR off, or convert it"
        )
    }
}
