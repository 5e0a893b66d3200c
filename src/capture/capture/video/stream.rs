//! Fields, colours, range and projection of a video, as ffmpeg reports them before frames are read.

use super::error::VideoError;
use super::ffmpeg::{Ffmpeg, Output};
use super::range::Hdr;

/// Frames searched for fields if the stream declares none.
const PROBED_FRAMES: usize = 100;

/// Minimum number of frames that must show fields.
const FEWEST_COMBED: usize = 6;

/// Deinterlacing filters, best first.
const DEINTERLACERS: [&str; 2] = ["bwdif", "yadif"];

/// The preprocessing that a video needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Stream {
    /// Filters to prepend, which produce whole pictures in the declared colours; each ends with a
    /// comma.
    pub(super) first: String,
    pub(super) is_interlaced: bool,
    pub(super) hdr: Option<Hdr>,
}

/// Which field of a picture is earlier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fields {
    Top,
    Bottom,
}

impl Stream {
    /// Reads the beginning of the video.
    ///
    /// # Errors
    /// [`VideoError`]; [`VideoError::Sphere`] if it has no flat picture.
    pub(super) fn of(ffmpeg: &Ffmpeg<'_>) -> Result<Self, VideoError> {
        let log = filter_log(ffmpeg, "showinfo", Some(1))?;
        let input = log.split("Stream mapping:").next().unwrap_or_default();
        if let Some(projection) = projection(input) {
            return Err(VideoError::Sphere { projection: projection.to_owned() });
        }
        let line = input.lines().find(|l| l.contains(": Video: ") && !l.contains("attached pic"));
        let line = line.unwrap_or_default();
        let hdr = Hdr::of(&log);
        let mut first = String::new();
        let fields = match declared(line).or_else(|| flagged(&log)) {
            None => {
                shown(&filter_log(ffmpeg, &format!("trim=end_frame={PROBED_FRAMES},idet"), None)?)
            }
            fields => fields,
        };
        if let Some(fields) = fields {
            first += &deinterlacer(ffmpeg, fields, &log, turn(input))?;
        }
        // ffmpeg assumes BT.601 for undeclared colours at every size.
        let is_untagged = log.contains("color_space:unknown") && log.contains(" fmt:yuv");
        if is_untagged && hdr.is_none() && size_in(line.split(", ")).is_some_and(is_hd) {
            first += "setparams=colorspace=bt709,";
        }
        Ok(Self { first, is_interlaced: fields.is_some(), hdr })
    }
}

/// The log of ffmpeg while it runs the video, or its first frames, through a filter.
fn filter_log(
    ffmpeg: &Ffmpeg<'_>,
    filter: &str,
    frames: Option<usize>,
) -> Result<String, VideoError> {
    let mut arguments = vec!["-loglevel".to_owned(), "info".to_owned()];
    arguments.extend(["-nostats", "-vf", filter].map(str::to_owned));
    if let Some(frames) = frames {
        arguments.extend(["-frames:v".to_owned(), frames.to_string()]);
    }
    arguments.extend(["-f", "null", "-"].map(str::to_owned));
    ffmpeg.run(&arguments, Output::Chunks(1, &mut |_: &[u8]| true))
}

/// The 360-degree projection, if there is one.
fn projection(input: &str) -> Option<&str> {
    let text = input.lines().find_map(|line| line.trim_start().strip_prefix("spherical: "));
    let name = text.map(|text| text.split(" (").next().unwrap_or(text).trim());
    // ffmpeg reads the older description only if it is complete.
    let partial = input.contains("Invalid spherical metadata").then_some("of some projection");
    name.or(partial).filter(|&name| name != "rectilinear")
}

/// The field order in the stream's description.
fn declared(line: &str) -> Option<Fields> {
    // The first word is the field shown first or, if the fields are swapped, stored first.
    let orders = [
        ("top first", Fields::Top),
        ("bottom first", Fields::Bottom),
        ("top coded first (swapped)", Fields::Bottom),
        ("bottom coded first (swapped)", Fields::Top),
    ];
    let found = orders.into_iter().find(|(order, _)| line.contains(order));
    found.map(|(_, fields)| fields)
}

/// The field order of the first frame.
fn flagged(log: &str) -> Option<Fields> {
    let orders = [(" i:T ", Fields::Top), (" i:B ", Fields::Bottom)];
    let line = log.lines().find(|line| line.contains("showinfo") && line.contains(" i:"))?;
    orders.into_iter().find(|(order, _)| line.contains(order)).map(|(_, fields)| fields)
}

/// The field order of most frames, from their combing. Progressive frames show both orders equally
/// often.
fn shown(log: &str) -> Option<Fields> {
    let counts = log.lines().rfind(|line| line.contains("Multi frame detection:"))?;
    let count = |name: &str| {
        let after = counts.split(name).nth(1)?.split_whitespace().next()?;
        after.parse::<usize>().ok()
    };
    let (top, bottom) = (count("TFF:")?, count("BFF:")?);
    let all = top + bottom + count("Progressive:")? + count("Undetermined:")?;
    let is_clear =
        |one: usize, other: usize| one >= FEWEST_COMBED && 2 * one > all && 10 * other <= one;
    match (top, bottom) {
        (top, bottom) if is_clear(top, bottom) => Some(Fields::Top),
        (top, bottom) if is_clear(bottom, top) => Some(Fields::Bottom),
        _ => None,
    }
}

/// Filters that undo ffmpeg's rotation to upright, and that redo it. Fields are rows of the picture
/// as stored.
fn turn(input: &str) -> [&'static str; 2] {
    let text = input.lines().find_map(|line| line.split("displaymatrix: rotation of ").nth(1));
    let degrees = text.and_then(|text| text.split(' ').next()?.parse::<f64>().ok());
    match degrees.map_or(0, |degrees| degrees.round() as i32) {
        -90 => ["transpose=cclock,", "transpose=clock,"],
        90 => ["transpose=clock,", "transpose=cclock,"],
        180 | -180 => ["hflip,vflip,", "hflip,vflip,"],
        _ => ["", ""],
    }
}

/// The filters that merge each pair of fields into one picture.
fn deinterlacer(
    ffmpeg: &Ffmpeg<'_>,
    fields: Fields,
    log: &str,
    [undo, redo]: [&str; 2],
) -> Result<String, VideoError> {
    let order = match fields {
        Fields::Top => "tff",
        Fields::Bottom => "bff",
    };
    // These filters require all frames to have the size of the first.
    let frame = log.lines().find(|line| line.contains("showinfo") && line.contains(" s:"));
    let words = frame.unwrap_or_default().split_whitespace();
    let Some((width, height)) = size_in(words.filter_map(|word| word.strip_prefix("s:"))) else {
        return Err(VideoError::Interlaced);
    };
    for name in DEINTERLACERS {
        let filter =
            format!("scale={width}:{height},{undo}{name}=mode=send_frame:parity={order},{redo}");
        match filter_log(ffmpeg, filter.trim_end_matches(','), Some(1)) {
            Ok(_) => return Ok(filter),
            // The first reading succeeded, so the filter is at fault.
            Err(VideoError::Unreadable { .. }) => {}
            Err(error) => return Err(error),
        }
    }
    Err(VideoError::Interlaced)
}

/// The first part that begins with a size such as `1280x720`, px.
fn size_in<'a>(mut parts: impl Iterator<Item = &'a str>) -> Option<(usize, usize)> {
    parts.find_map(|part| {
        let (width, height) = part.split(' ').next()?.split_once('x')?;
        Some((width.parse().ok()?, height.parse().ok()?))
    })
}

/// Whether players assume BT.709 for a video of this size without declared colours.
fn is_hd((width, height): (usize, usize)) -> bool {
    width >= 1280 || height >= 720
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_field_order_is_the_display_order() {
        let line = |order: &str| {
            format!("  Stream #0:0(und): Video: prores (apcn), yuv422p10le({order}), 720x576 [SAR")
        };
        for (order, fields) in [
            ("tv, top first", Some(Fields::Top)),
            ("bottom first", Some(Fields::Bottom)),
            ("bt709, top coded first (swapped)", Some(Fields::Bottom)),
            ("bottom coded first (swapped)", Some(Fields::Top)),
            ("tv, progressive", None),
        ] {
            assert_eq!(declared(&line(order)), fields, "{order}");
        }
    }

    #[test]
    fn combing_counts_only_if_nearly_all_frames_agree() {
        let shown = |top: usize, bottom: usize, progressive: usize| {
            shown(&format!(
                "[Parsed_idet_1 @ 0x1] Single frame detection: TFF: 1 BFF: 1 Progressive: 1\n\
                 [Parsed_idet_1 @ 0x1] Multi frame detection: TFF:{top:6} BFF:{bottom:6} \
                 Progressive:{progressive:6} Undetermined:     0\n"
            ))
        };
        assert_eq!(shown(75, 0, 20), Some(Fields::Top));
        assert_eq!(shown(3, 60, 30), Some(Fields::Bottom));
        assert_eq!(shown(42, 25, 8), None);
        assert_eq!(shown(20, 0, 80), None);
        assert_eq!(shown(4, 0, 0), None);
    }

    #[test]
    fn hd_size_is_determined_by_the_stored_lines() {
        let size = |line: &str| size_in(line.split(", "));
        let line = "  Stream #0:0(und): Video: h264 (High) (avc1 / 0x31637661), yuv420p(tv, \
                    progressive), 1280x720 [SAR 1:1 DAR 16:9], 608 kb/s, 6 fps";
        assert_eq!(size(line), Some((1280, 720)));
        for (size, expected) in
            [((1280, 534), true), ((720, 1280), true), ((960, 720), true), ((720, 576), false)]
        {
            assert_eq!(is_hd(size), expected, "{size:?}");
        }
    }
}
