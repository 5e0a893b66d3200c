//! Videos with a larger range of brightness than sRGB has.

use std::fmt;

use super::error::VideoError;
use super::ffmpeg::{Ffmpeg, Output};

/// How bright white is in such a video, nits (ITU-R BT.2408): that becomes the white of sRGB.
const WHITE: f64 = 203.0;

/// How bright such a video may be, nits: the display that HLG is meant for.
const PEAK: f64 = 1000.0;

/// A larger range, and what is done about it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hdr {
    transfer: Transfer,
    is_converted: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Transfer {
    Hlg,
    Pq,
}

impl Hdr {
    /// Reads the transfer function of the first frame.
    ///
    /// # Errors
    /// [`VideoError`] where it cannot be read.
    pub(super) fn of(ffmpeg: &Ffmpeg<'_>) -> Result<Option<Self>, VideoError> {
        let arguments = ["-loglevel", "info", "-vf", "showinfo", "-frames:v", "1", "-f", "null"];
        let arguments = arguments.iter().chain(&["-"]).map(|&text| text.to_owned());
        let mut nothing = |_: &[u8]| true;
        let said = ffmpeg.run(&arguments.collect::<Vec<_>>(), Output::Chunks(1, &mut nothing))?;
        let transfer = if said.contains("color_trc:arib-std-b67") {
            Transfer::Hlg
        } else if said.contains("color_trc:smpte2084") {
            Transfer::Pq
        } else {
            return Ok(None);
        };
        Ok(Some(Self { transfer, is_converted: true }))
    }

    /// The same, where this ffmpeg cannot convert it.
    pub(super) fn left(self) -> Self {
        Self { is_converted: false, ..self }
    }

    /// Filters behind others that make sRGB of it: linear up to three tenths of white, as the dark
    /// is what counts here, and bent above, up to the peak.
    pub(super) fn filters(self) -> String {
        if !self.is_converted {
            return String::new();
        }
        let transfer = match self.transfer {
            Transfer::Hlg => "arib-std-b67",
            Transfer::Pq => "smpte2084",
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
        let name = match self.transfer {
            Transfer::Hlg => "HLG",
            Transfer::Pq => "PQ",
        };
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
