//! Checks whether a JPEG's picture is complete.
//!
//! The decoder silently fills missing data with grey. Here every Huffman code is read first,
//! without decoding pixels: each scan, and each part of one between restart markers, must contain
//! exactly the blocks of its rows, and no value that is impossible in a picture. Bytes after the
//! picture, as written by phones, and a missing end marker are harmless.

use std::iter;

use super::error::{ImageError, MAX_PIXELS};

/// Largest first coefficient of a block, dequantised: eight times a sample of -128, with a margin
/// for inexact encoders. A wrong byte shifts all following blocks, often beyond this.
const LARGEST_MEAN: u32 = 1100;

/// Largest other coefficient: the same, plus what encoders add to white beside edges against
/// ringing.
const LARGEST_DETAIL: u32 = 1280;

/// Checks a file that begins as a JPEG does. Everything else is left to the decoder.
///
/// # Errors
/// [`ImageError::Damaged`], with the intact share, and [`ImageError::Unsupported`].
pub(super) fn check(bytes: &[u8]) -> Result<(), ImageError> {
    let mut file = File { bytes, at: 2, restart: 0 };
    let (mut tables, mut frame) = (Tables::default(), None);
    while let Some(marker) = file.bits().1 {
        match marker {
            0xd9 => break,
            0xd0..=0xd7 => continue,
            // Only the end follows the last scan; anything else is a trailer.
            _ if frame.as_ref().is_some_and(Frame::is_complete) => return Ok(()),
            0x01 | 0xd8 => continue,
            _ => (),
        }
        let Some(segment) = file.segment() else { break };
        match (marker, &mut frame) {
            (0xc4, _) => tables.read_huffman(segment),
            (0xdb, _) => tables.read_quantisation(segment),
            (0xdd, _) => file.restart = segment.get(..2).map_or(0, number),
            (0xda, Some(frame)) => match Scan::read(segment, frame, &tables) {
                Some(scan) => file.scan(scan, frame)?,
                None => return Ok(()),
            },
            (_, None) => {
                if let Some(kind) = unread(marker, segment) {
                    return Err(ImageError::Unsupported { message: kind.to_owned() });
                }
                if let 0xc0..=0xc2 = marker {
                    let Some(read) = Frame::read(segment, marker == 0xc2) else {
                        return Ok(());
                    };
                    frame = Some(read);
                }
            }
            _ => (),
        }
    }
    match frame {
        Some(frame) if frame.is_complete() => Ok(()),
        Some(_) => damaged("it ends before the last of its picture"),
        None => damaged("it ends before its picture begins"),
    }
}

/// A kind that the decoder does not support, from the marker that begins its frame.
fn unread(marker: u8, segment: &[u8]) -> Option<&'static str> {
    match (marker, segment) {
        (0xc9..=0xcb | 0xcd..=0xcf, _) => Some("a JPEG of arithmetic coding"),
        (0xc3, _) => Some("a lossless JPEG"),
        (0xc5..=0xc7, _) => Some("a hierarchical JPEG"),
        (0xc0..=0xc2, [8, 0, 0, ..]) => Some("a JPEG that tells its height behind its picture"),
        (0xc0..=0xc2, [9..=255, ..]) => Some("a JPEG of more than 8 bits"),
        _ => None,
    }
}

fn damaged(message: &str) -> Result<(), ImageError> {
    Err(ImageError::Damaged { message: message.to_owned() })
}

fn number(bytes: &[u8]) -> usize {
    usize::from(bytes[0]) << 8 | usize::from(bytes[1])
}

/// A file and the current position.
struct File<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Units between restart markers; 0 for none.
    restart: usize,
}

impl<'a> File<'a> {
    /// The bytes before the next marker, and that marker.
    fn bits(&mut self) -> (Bits<'a>, Option<u8>) {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let is_marker = |pair: &[u8]| pair[0] == 0xff && !matches!(pair[1], 0 | 0xff);
        let end = rest.windows(2).position(is_marker);
        self.at += end.map_or(rest.len(), |end| end + 2);
        let data = &rest[..end.unwrap_or(rest.len())];
        // 0xff bytes before a marker belong to it.
        let length = data.iter().rposition(|&byte| byte != 0xff).map_or(0, |last| last + 1);
        (Bits { rest: &data[..length], buffer: 0, count: 0 }, end.map(|end| rest[end + 1]))
    }

    /// The segment after a marker, by its length field.
    fn segment(&mut self) -> Option<&'a [u8]> {
        let length = number(self.bytes.get(self.at..self.at + 2)?);
        let segment = self.bytes.get(self.at + 2..self.at + length)?;
        self.at += length;
        Some(segment)
    }

    /// Reads the codes of one scan.
    fn scan(&mut self, mut scan: Scan<'_>, frame: &mut Frame) -> Result<(), ImageError> {
        let (across, down) = scan.units(frame);
        let mut whole = 0;
        let mut start = self.at;
        let (mut bits, mut marker) = self.bits();
        for unit in 0..across * down {
            if self.restart > 0 && unit > 0 && unit % self.restart == 0 {
                let expected = 0xd0 + ((unit / self.restart - 1) % 8) as u8;
                if marker != Some(expected) || scan.empty > 0 || !bits.are_used_up() {
                    return scan.broken(frame, whole);
                }
                start = self.at;
                (bits, marker) = self.bits();
                scan.parts.iter_mut().for_each(|part| part.last = 0);
                whole = unit;
            }
            if scan.unit(frame, &mut bits, (unit % across, unit / across)).is_none() {
                return scan.broken(frame, whole.max(unit.saturating_sub(1)));
            }
        }
        if scan.empty > 0 {
            return scan.broken(frame, whole);
        }
        frame.note(&scan);
        let may_trail = frame.is_complete() && !matches!(marker, Some(0xd0..=0xd7 | 0xd9));
        if !may_trail && !bits.are_used_up() {
            return damaged("some of its rows are wrong or out of place");
        }
        self.at = start;
        Ok(())
    }
}

/// Tables that segments before a scan define.
#[derive(Default)]
struct Tables {
    /// For the first coefficients, and for the others.
    huffman: [[Option<Huffman>; 4]; 2],
    /// Steps in coding order.
    steps: [Vec<u32>; 4],
}

impl Tables {
    fn read_huffman(&mut self, mut segment: &[u8]) {
        while segment.len() >= 17 {
            let (class, counts) = (usize::from(segment[0]), &segment[1..17]);
            let count: usize = counts.iter().map(|&count| usize::from(count)).sum();
            let Some(values) = segment.get(17..17 + count) else {
                return;
            };
            if let Some(table) = self.huffman[usize::from(class >= 16)].get_mut(class & 15) {
                *table = Some(Huffman::new(counts, values));
            }
            segment = &segment[17 + count..];
        }
    }

    fn read_quantisation(&mut self, mut segment: &[u8]) {
        while let Some((&class, rest)) = segment.split_first() {
            let wide = usize::from(class >= 16) + 1;
            let Some(values) = rest.get(..64 * wide) else {
                return;
            };
            let value = |bytes: &[u8]| bytes.iter().fold(0, |v, &b| v << 8 | u32::from(b));
            self.steps[usize::from(class & 3)] = values.chunks(wide).map(value).collect();
            segment = &rest[64 * wide..];
        }
    }
}

/// A table of Huffman codes.
struct Huffman {
    /// For each length: the first code, the first value too large for a code, both left-aligned in
    /// 16 bits, and the first code's index among the values.
    lengths: Vec<(u32, u32, u32)>,
    values: Vec<u8>,
}

impl Huffman {
    fn new(counts: &[u8], values: &[u8]) -> Self {
        let (mut end, mut index) = (0, 0);
        let lengths = (1..).zip(counts).map(|(length, &count)| {
            let first = (end, index);
            end += u32::from(count) << (16 - length);
            index += u32::from(count);
            (first.0, end, first.1)
        });
        Self { lengths: lengths.collect(), values: values.to_vec() }
    }
}

/// One colour component of a picture.
struct Component {
    id: u8,
    /// Blocks across a unit of an interleaved scan.
    across: usize,
    down: usize,
    steps: usize,
    /// Blocks in a row, padded to whole units.
    stride: usize,
    /// Blocks across and down in a scan of this component alone.
    own: (usize, usize),
    /// One bit for each non-zero coefficient of each block; empty unless progressive.
    set: Vec<u64>,
    /// Bits of each coefficient still to come; 255 if none has come.
    to_come: [u8; 64],
}

struct Frame {
    height: usize,
    units: (usize, usize),
    progressive: bool,
    components: Vec<Component>,
}

impl Frame {
    /// `None` if the decoder must decide.
    fn read(segment: &[u8], progressive: bool) -> Option<Self> {
        let (head, rest) = segment.split_at_checked(6)?;
        let (height, width) = (number(&head[1..]), number(&head[3..]));
        let parts: Vec<&[u8]> = rest.chunks_exact(3).take(usize::from(head[5])).collect();
        let factors = |part: &[u8]| (usize::from(part[1] >> 4), usize::from(part[1] & 15));
        let across = parts.iter().map(|part| factors(part).0).max()?;
        let down = parts.iter().map(|part| factors(part).1).max()?;
        let is_factor = |factor| (1..=4).contains(&factor);
        let is_odd = |part: &&[u8]| !is_factor(factors(part).0) || !is_factor(factors(part).1);
        let is_large = (height * width) as u64 > MAX_PIXELS;
        if is_large || head[0] != 8 || height * width == 0 || parts.iter().any(is_odd) {
            return None;
        }
        let units = (width.div_ceil(8 * across), height.div_ceil(8 * down));
        let component = |part: &&[u8]| {
            let (h, v) = factors(part);
            let own = |size: usize, factor: usize, most| (size * factor).div_ceil(most).div_ceil(8);
            Component {
                id: part[0],
                across: h,
                down: v,
                steps: usize::from(part[2] & 3),
                stride: units.0 * h,
                own: (own(width, h, across), own(height, v, down)),
                set: vec![0; if progressive { units.0 * h * units.1 * v } else { 0 }],
                to_come: [255; 64],
            }
        };
        Some(Self { height, units, progressive, components: parts.iter().map(component).collect() })
    }

    /// Records a complete scan.
    fn note(&mut self, scan: &Scan<'_>) {
        for part in &scan.parts {
            let band = scan.band.0 as usize..=scan.band.1 as usize;
            self.components[part.component].to_come[band].fill(scan.low);
        }
    }

    /// Whether every component has all its bits. Some encoders omit colour detail.
    fn is_complete(&self) -> bool {
        self.components.iter().enumerate().all(|(at, component)| {
            let is_done = |&bits: &u8| bits == 0 || at > 0 && bits == 255;
            component.to_come[0] == 0 && component.to_come.iter().all(is_done)
        })
    }
}

/// A component's part in a scan.
struct Part<'a> {
    component: usize,
    dc: Option<&'a Huffman>,
    ac: Option<&'a Huffman>,
    steps: &'a [u32],
    /// The previous DC value.
    last: i32,
}

impl Part<'_> {
    /// Whether an 8-bit picture can have this coefficient, less its low bits, at this position.
    fn is_possible(&self, value: i32, k: u32, low: u8) -> bool {
        let step = self.steps.get(k as usize).map_or(1, |step| step << low);
        let largest = if k == 0 { LARGEST_MEAN } else { LARGEST_DETAIL };
        value.unsigned_abs().saturating_mul(step) <= largest + step
    }
}

struct Scan<'a> {
    parts: Vec<Part<'a>>,
    /// First and last coefficient, in coding order.
    band: (u32, u32),
    /// Bits of each coefficient remaining before this scan, 0 for all, and after it.
    high: u8,
    low: u8,
    progressive: bool,
    /// Number of empty blocks to come.
    empty: u32,
}

impl<'a> Scan<'a> {
    /// `None` if the decoder must decide.
    fn read(header: &[u8], frame: &Frame, tables: &'a Tables) -> Option<Self> {
        let (&count, rest) = header.split_first()?;
        let (names, rest) = rest.split_at_checked(2 * usize::from(count))?;
        let [first, last, bits] = if frame.progressive { *rest.first_chunk()? } else { [0, 63, 0] };
        let (high, low) = (bits >> 4, bits & 15);
        let part = |name: &[u8]| {
            let is_named = |component: &Component| component.id == name[0];
            let component = frame.components.iter().position(is_named)?;
            let table = |class: usize, at| tables.huffman[class].get(usize::from(at))?.as_ref();
            let dc: Option<&Huffman> = table(0, name[1] >> 4);
            let ac: Option<&Huffman> = table(1, name[1] & 15);
            let lacks = first == 0 && high == 0 && dc.is_none() || last > 0 && ac.is_none();
            let steps = &*tables.steps[frame.components[component].steps];
            (!lacks).then_some(Part { component, dc, ac, steps, last: 0 })
        };
        let parts: Vec<_> = names.chunks(2).map(part).collect::<Option<_>>()?;
        let is_odd = parts.is_empty() || first > last || last > 63 || low > 13;
        let mixes = frame.progressive && last > 0 && (first == 0 || parts.len() > 1);
        let band = (u32::from(first), u32::from(last));
        let progressive = frame.progressive;
        (!is_odd && !mixes).then_some(Self { parts, band, high, low, progressive, empty: 0 })
    }

    /// Units across and down.
    fn units(&self, frame: &Frame) -> (usize, usize) {
        match &*self.parts {
            [part] => frame.components[part.component].own,
            _ => frame.units,
        }
    }

    /// The error for a scan of which only the first `units` are intact.
    fn broken(&self, frame: &Frame, units: usize) -> Result<(), ImageError> {
        let (across, down) = self.units(frame);
        let (whole, height) = ((units / across) * frame.height / down, frame.height);
        // Whether its rows are the first visible part of the picture.
        let begins = self.band.0 == 0 && self.high == 0;
        damaged(&if begins && self.parts.iter().any(|part| part.component == 0) {
            format!("only the first {whole} of its {height} rows are whole")
        } else {
            format!("below row {whole} of {height} its colour or its detail is missing")
        })
    }

    /// Reads a unit; `None` if it is invalid or the data end.
    fn unit(&mut self, frame: &mut Frame, bits: &mut Bits<'_>, at: (usize, usize)) -> Option<()> {
        let alone = self.parts.len() == 1;
        for index in 0..self.parts.len() {
            let component = &mut frame.components[self.parts[index].component];
            let (h, v) = if alone { (1, 1) } else { (component.across, component.down) };
            for block in 0..h * v {
                let (x, y) = (at.0 * h + block % h, at.1 * v + block / h);
                let mut none = 0;
                let set = component.set.get_mut(y * component.stride + x).unwrap_or(&mut none);
                if self.band.0 == 0 {
                    self.dc(index, bits)?;
                }
                if self.band.1 > 0 {
                    self.ac(index, bits, set)?;
                }
            }
        }
        Some(())
    }

    /// The first coefficient, or one more bit of it.
    fn dc(&mut self, index: usize, bits: &mut Bits<'_>) -> Option<()> {
        if self.high > 0 {
            return bits.take(1).map(drop);
        }
        let part = &mut self.parts[index];
        let size = bits.code(part.dc?)?;
        part.last = part.last.saturating_add(bits.value(size)?);
        part.is_possible(part.last, 0, self.low).then_some(())
    }

    /// The other coefficients, or one more bit of them. `set` marks those made non-zero by earlier
    /// scans of a progressive picture.
    fn ac(&mut self, index: usize, bits: &mut Bits<'_>, set: &mut u64) -> Option<()> {
        let part = &self.parts[index];
        let is_set = |set: u64, k: u32| set >> k & 1 == 1;
        let (mut k, last, known) = (self.band.0.max(1), self.band.1, *set);
        while self.empty == 0 && k <= last {
            let code = bits.code(part.ac?)?;
            let (mut run, size) = (u32::from(code >> 4), code & 15);
            if size == 0 && run < 15 {
                self.empty = (1 << run) + bits.take(run)?;
                break;
            }
            let value = bits.value(size)?;
            while k <= last && (run > 0 || is_set(known, k)) {
                if is_set(known, k) {
                    bits.take(1)?;
                } else {
                    run -= 1;
                }
                k += 1;
            }
            if size > 0 {
                let is_wrong = self.high > 0 && size > 1 || !part.is_possible(value, k, self.low);
                if k > last || is_wrong {
                    return None;
                }
                *set |= u64::from(self.progressive) << k;
            }
            k += 1;
        }
        if self.empty > 0 {
            for _ in (k..=last).filter(|&k| is_set(known, k)) {
                bits.take(1)?;
            }
            self.empty -= 1;
        }
        // Only in a progressive picture may one code end several blocks.
        (self.progressive || self.empty == 0).then_some(())
    }
}

/// The bits of a scan, without the bytes that distinguish them from markers.
struct Bits<'a> {
    rest: &'a [u8],
    buffer: u64,
    count: u32,
}

impl Bits<'_> {
    /// The next 16 bits; zeros follow the end.
    fn peek(&mut self) -> u32 {
        if self.count < 16 {
            while self.count <= 40
                && let Some((&byte, rest)) = self.rest.split_first()
            {
                self.rest = if byte == 0xff { rest.get(1..).unwrap_or_default() } else { rest };
                self.buffer = self.buffer << 8 | u64::from(byte);
                self.count += 8;
            }
        }
        (self.buffer << 16 >> self.count) as u32 & 0xffff
    }

    /// At most 16 bits; `None` at the end.
    fn take(&mut self, count: u32) -> Option<u32> {
        let bits = self.peek() >> (16 - count);
        self.count = self.count.checked_sub(count)?;
        Some(bits)
    }

    fn code(&mut self, table: &Huffman) -> Option<u8> {
        let next = self.peek();
        let mut lengths = (1..).zip(&table.lengths);
        let (length, &(first, _, index)) = lengths.find(|(_, (_, end, _))| next < *end)?;
        self.count = self.count.checked_sub(length)?;
        table.values.get((index + ((next - first) >> (16 - length))) as usize).copied()
    }

    /// A signed value of this many bits.
    fn value(&mut self, size: u8) -> Option<i32> {
        let bits = (size < 16).then(|| self.take(u32::from(size)))?? as i32;
        let half = 1 << size >> 1;
        Some(if bits < half { bits - (1 << size) + 1 } else { bits })
    }

    /// Whether all whole bytes have been read except padding: some encoders write an extra byte.
    fn are_used_up(&mut self) -> bool {
        self.count -= self.count % 8;
        let first = self.take(8);
        let is_padding = |byte| Some(byte) == first && matches!(byte, 0 | 0xff);
        let mut rest = iter::from_fn(|| self.take(8)).peekable();
        rest.peek().is_none() || rest.all(is_padding)
    }
}

#[cfg(test)]
mod tests;
