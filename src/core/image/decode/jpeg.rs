//! Whether a JPEG's picture is whole.
//!
//! The decoder fills what it does not find with grey and says nothing, and so do other decoders in
//! Rust. Here every Huffman code is read beforehand, without pixels: each scan must hold as many
//! blocks as its rows take, no more, and no value that a picture cannot have. Bytes behind the
//! picture, as phones put them there, and a missing end marker do no harm.

use image::DynamicImage;

use super::error::ImageError;

/// Bytes that may lie between a scan and the next marker: some encoders write one too many.
const SPARE: usize = 1;

/// Magnitude of a dequantised value over which no picture of 8 bits has any: an eighth of the sum
/// of 64 samples of -128, the steps of quantisation, and some room for encoders that round badly.
const LARGEST: u32 = 1280;

/// Checks a file that begins as a JPEG does. What only the decoder can judge, such as a variant
/// that it does not read, is left to it.
///
/// # Errors
/// [`ImageError::Damaged`], with how much is whole.
pub(super) fn check(bytes: &[u8]) -> Result<Option<Grid>, ImageError> {
    let damaged = |message: &str| ImageError::Damaged { message: message.to_owned() };
    let mut file = File::new(bytes);
    loop {
        let Some((marker, skipped)) = file.marker() else {
            return file.finish(&damaged);
        };
        let after_scan = file.behind_scan && !is_padding(skipped);
        file.behind_scan = false;
        match marker {
            // Only its end follows the last scan; all else is a trailer.
            0xd9 | 0xd0..=0xd7 => (),
            _ if file.is_complete() => return Ok(file.grid()),
            _ => (),
        }
        if after_scan {
            return Err(damaged("some of its rows are wrong or out of place"));
        }
        match marker {
            0xd9 => return file.finish(&damaged),
            0x01 | 0xd0..=0xd8 => continue,
            _ => (),
        }
        let Some(segment) = file.segment() else {
            return file.finish(&damaged);
        };
        match marker {
            0xc0..=0xc2 if file.frame.is_none() => match Frame::read(segment, marker == 0xc2) {
                Some(frame) => file.frame = Some(frame),
                None => return Ok(file.grid()),
            },
            0xc3 | 0xc5..=0xc7 | 0xc9..=0xcb | 0xcd..=0xcf => return Ok(file.grid()),
            0xc4 => file.tables.read_huffman(segment),
            0xdb => file.tables.read_quantisation(segment),
            0xdd => file.restart = segment.get(..2).map_or(0, number),
            0xda if !file.scan(segment)? => return Ok(file.grid()),
            _ => (),
        }
    }
}

/// The error of a file whose decoder does not read its kind, by the name of that.
pub(super) fn named(bytes: &[u8], error: ImageError) -> ImageError {
    match unread(bytes) {
        Some(kind) => ImageError::Unsupported { message: kind.to_owned() },
        None => error,
    }
}

fn unread(bytes: &[u8]) -> Option<&'static str> {
    let mut file = File::new(bytes);
    loop {
        let (marker, _) = file.marker()?;
        match marker {
            0x01 | 0xd0..=0xd8 => continue,
            0xc9..=0xcb | 0xcd..=0xcf => return Some("a JPEG of arithmetic coding"),
            0xc3 => return Some("a lossless JPEG"),
            0xc5..=0xc7 => return Some("a hierarchical JPEG"),
            _ => (),
        }
        let segment = file.segment()?;
        if let 0xc0..=0xc2 = marker {
            return match segment {
                [8, 0, 0, ..] => Some("a JPEG that tells its height behind its picture"),
                [8, ..] => None,
                _ => Some("a JPEG of more than 8 bits"),
            };
        }
    }
}

/// The units in which a picture is coded, one after the other.
#[derive(Debug)]
pub(super) struct Grid {
    /// Width and height of one, px.
    unit: (usize, usize),
    /// After how many the coding begins anew; 0 for never.
    restart: usize,
}

impl Grid {
    /// Levels by which a part must be off in order to be found.
    const STEP: i32 = 6;

    /// Units across in which a seam is told from what a scene has: of fewer, some look like one by
    /// chance.
    const FEWEST: usize = 7;

    /// # Errors
    /// [`ImageError::Damaged`] for a picture with such a seam.
    pub(super) fn check(&self, picture: &DynamicImage) -> Result<(), ImageError> {
        let channels = usize::from(picture.color().channel_count());
        let (width, height) = (picture.width() as usize, picture.height());
        match self.seam(picture.as_bytes(), channels, width) {
            None => Ok(()),
            Some(row) => Err(ImageError::Damaged {
                message: format!(
                    "from row {row} of {height} on its brightness or colour is off, as where a \
                     byte of the file is wrong; if it looks right, save it as PNG"
                ),
            }),
        }
    }

    /// The row of pixels from which on a part of the picture is off by one brightness or colour.
    /// Each unit is coded as a difference to the one before, so one wrong value shifts all behind
    /// it; codes alone do not tell that. It shows as a step between units above and below, for
    /// exactly one row of units, that begins somewhere inside a row. Edges in a scene do not.
    fn seam(&self, samples: &[u8], channels: usize, width: usize) -> Option<usize> {
        let (across, down) = self.unit;
        let height = samples.len() / (width * channels);
        let columns = width / across;
        // The last unit may be cut, and a step is looked for two pixels beside it.
        let rows = (height.saturating_sub(2)).div_ceil(down);
        if columns < Self::FEWEST || rows < 3 {
            return None;
        }
        (0..channels).find_map(|channel| {
            let mut steps = vec![0; columns];
            for row in 1..rows {
                let value =
                    |x: usize, y: usize| i32::from(samples[(y * width + x) * channels + channel]);
                steps.extend((0..columns).map(|column| {
                    let mut steps: Vec<i32> = (column * across..(column + 1) * across)
                        .map(|x| value(x, row * down + 1) - value(x, row * down - 2))
                        .collect();
                    middle(&mut steps)
                }));
            }
            let unit = self.shifted_from(&steps, columns)?;
            Some(unit / columns * down)
        })
    }

    /// The unit from which on all are shifted, by the steps from the units above.
    fn shifted_from(&self, steps: &[i32], columns: usize) -> Option<usize> {
        let mut sums = vec![0; steps.len() + 1];
        for (at, step) in steps.iter().enumerate() {
            sums[at + 1] = sums[at] + step;
        }
        (columns..steps.len()).find(|&first| {
            let end = match self.restart {
                0 => usize::MAX,
                restart => (first / restart + 1) * restart,
            };
            let last = (first + columns).min(end);
            let Some(inside) = steps.get(first..last) else {
                return false;
            };
            // Few have such a mean, and only of those is the middle looked for.
            let is_small = (sums[last] - sums[first]).abs() * 2 < Self::STEP * inside.len() as i32;
            // An edge along a whole row of units is the scene's, or a frame's.
            let is_whole = [0, 1, columns - 1].contains(&(first % columns));
            if is_small || is_whole || inside.len() < Self::FEWEST {
                return false;
            }
            let shift = middle(&mut inside.to_vec());
            // So many of four are within a third of the shift of a value.
            let are = |most: usize, range: &[i32], value: i32| {
                let is_near = |step: &&i32| (**step - value).abs() * 3 <= shift.abs();
                range.iter().filter(is_near).count() * 4 >= range.len() * most
            };
            let before = &steps[first - columns..first];
            let behind = &steps[last..(last + columns).min(steps.len())];
            shift.abs() >= Self::STEP
                && are(3, inside, shift)
                && are(2, &inside[..3], shift)
                && are(2, &inside[inside.len() - 3..], shift)
                && are(3, before, 0)
                && are(2, &before[before.len() - 3..], 0)
                && (self.restart > 0 || are(3, behind, 0))
        })
    }
}

/// The middle value, 0 of none.
fn middle(values: &mut [i32]) -> i32 {
    let at = values.len() / 2;
    if values.is_empty() {
        return 0;
    }
    *values.select_nth_unstable(at).1
}

fn number(bytes: &[u8]) -> usize {
    usize::from(bytes[0]) << 8 | usize::from(bytes[1])
}

/// Whether bytes between a scan and a marker are none of the picture's.
fn is_padding(bytes: &[u8]) -> bool {
    let stuffed = |pair: &[u8]| pair == [0xff, 0];
    bytes.len() <= SPARE || bytes.iter().all(|&byte| byte == 0) || bytes.chunks(2).all(stuffed)
}

/// A file and how far it has been read.
struct File<'a> {
    bytes: &'a [u8],
    at: usize,
    behind_scan: bool,
    restart: usize,
    tables: Tables,
    frame: Option<Frame>,
}

impl<'a> File<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self {
            bytes,
            at: 2,
            behind_scan: false,
            restart: 0,
            tables: Tables::default(),
            frame: None,
        }
    }

    /// The next marker, and what lies before it.
    fn marker(&mut self) -> Option<(u8, &'a [u8])> {
        let rest = self.bytes.get(self.at..)?;
        let is_marker = |pair: &[u8]| pair[0] == 0xff && !matches!(pair[1], 0 | 0xff);
        let skipped = rest.windows(2).position(is_marker)?;
        self.at += skipped + 2;
        // Bytes of 0xff before a marker belong to it.
        let before = rest[..skipped].iter().rposition(|&byte| byte != 0xff);
        Some((rest[skipped + 1], &rest[..before.map_or(0, |at| at + 1)]))
    }

    /// What follows a marker, by its length.
    fn segment(&mut self) -> Option<&'a [u8]> {
        let length = number(self.bytes.get(self.at..self.at + 2)?);
        let segment = self.bytes.get(self.at + 2..self.at + length)?;
        self.at += length;
        Some(segment)
    }

    fn is_complete(&self) -> bool {
        self.frame.as_ref().is_some_and(Frame::is_complete)
    }

    /// The units of a picture whose every unit follows from the one before.
    fn grid(&self) -> Option<Grid> {
        let frame = self.frame.as_ref()?;
        let across = frame.components.iter().map(|one| one.across).max()?;
        let down = frame.components.iter().map(|one| one.down).max()?;
        let alone = frame.components.len() == 1;
        let side = |factor: usize| if alone { 8 } else { 8 * factor };
        Some(Grid { unit: (side(across), side(down)), restart: self.restart })
    }

    fn finish(&self, damaged: &dyn Fn(&str) -> ImageError) -> Result<Option<Grid>, ImageError> {
        match &self.frame {
            None => Err(damaged("it ends before its picture begins")),
            Some(frame) if frame.is_complete() => Ok(self.grid()),
            Some(_) => Err(damaged("it ends before the last of its picture")),
        }
    }

    /// Reads the codes of one scan; `false` where the decoder must judge its header.
    fn scan(&mut self, header: &[u8]) -> Result<bool, ImageError> {
        let (Some(frame), tables) = (&mut self.frame, &self.tables) else {
            return Ok(false);
        };
        let Some(mut scan) = Scan::read(header, frame, tables, self.restart) else {
            return Ok(false);
        };
        let mut bits = Bits::new(self.bytes, self.at);
        let (done, all) = (scan.walk(frame, &mut bits), scan.units(frame));
        let count = all.0 * all.1;
        self.at = bits.unread();
        self.behind_scan = true;
        if done == count {
            frame.note(&scan);
            return Ok(true);
        }
        let whole = (done / all.0) * frame.height / all.1;
        let height = frame.height;
        let message = if scan.is_first() {
            format!("only the first {whole} of its {height} rows are whole")
        } else {
            format!("below row {whole} of {height} its colour or its detail is missing")
        };
        Err(ImageError::Damaged { message })
    }
}

/// Codes of a Huffman table.
#[derive(Clone)]
struct Huffman {
    /// By the first 8 bits: the code's length, 0 where it is longer, and its value.
    short: [(u8, u8); 256],
    /// By length: the first code that is too large for it, left-aligned in 16 bits, and what
    /// leads from a code to its value.
    long: [(u32, i32); 17],
    values: Vec<u8>,
}

impl Huffman {
    fn new(counts: &[u8], values: &[u8]) -> Self {
        let mut table = Self { short: [(0, 0); 256], long: [(0, 0); 17], values: values.to_vec() };
        let (mut code, mut index) = (0_u32, 0_usize);
        for length in 1..=16_usize {
            table.long[length].1 = index as i32 - code as i32;
            for _ in 0..counts[length - 1] {
                if length <= 8 {
                    let first = (code << (8 - length)) as usize;
                    let span = first..(first + (1 << (8 - length))).min(256);
                    if let Some(entries) = table.short.get_mut(span) {
                        entries.fill((length as u8, values[index]));
                    }
                }
                (code, index) = (code + 1, index + 1);
            }
            table.long[length].0 = code << (16 - length);
            code <<= 1;
        }
        table
    }
}

/// What segments before a scan define.
#[derive(Default)]
struct Tables {
    dc: [Option<Huffman>; 4],
    ac: [Option<Huffman>; 4],
    /// Steps in the order of coding; 1 where unknown.
    steps: [Option<[u16; 64]>; 4],
}

impl Tables {
    fn read_huffman(&mut self, mut segment: &[u8]) {
        while segment.len() >= 17 {
            let (class, counts) = (segment[0], &segment[1..17]);
            let count: usize = counts.iter().map(|&count| usize::from(count)).sum();
            let Some(values) = segment.get(17..17 + count) else {
                return;
            };
            let tables = if class < 16 { &mut self.dc } else { &mut self.ac };
            if let Some(table) = tables.get_mut(usize::from(class & 15)) {
                *table = Some(Huffman::new(counts, values));
            }
            segment = &segment[17 + count..];
        }
    }

    fn read_quantisation(&mut self, mut segment: &[u8]) {
        while let Some((&class, rest)) = segment.split_first() {
            let wide = usize::from(class >> 4 != 0) + 1;
            let Some(values) = rest.get(..64 * wide) else {
                return;
            };
            let value = |bytes: &[u8]| bytes.iter().fold(0, |v, &b| v << 8 | u16::from(b));
            let mut steps = [1; 64];
            let found = steps.iter_mut().zip(values.chunks(wide));
            found.for_each(|(step, bytes)| *step = value(bytes));
            if let Some(table) = self.steps.get_mut(usize::from(class & 15)) {
                *table = Some(steps);
            }
            segment = &rest[64 * wide..];
        }
    }
}

/// One colour of a picture.
struct Component {
    id: u8,
    /// Blocks of a unit of an interleaved scan.
    across: usize,
    down: usize,
    steps: usize,
    /// Blocks in a row, filled up to whole units.
    stride: usize,
    /// Blocks across and down that a scan of this component alone has.
    own: (usize, usize),
    /// A bit of each coefficient of each block that is not zero; empty unless progressive.
    set: Vec<u64>,
    /// How many bits of each coefficient are still to come; 255 where none has come.
    to_come: [u8; 64],
}

struct Frame {
    height: usize,
    units: (usize, usize),
    progressive: bool,
    components: Vec<Component>,
}

impl Frame {
    /// `None` for what the decoder must judge.
    fn read(segment: &[u8], progressive: bool) -> Option<Self> {
        let (head, rest) = segment.split_at_checked(6)?;
        let (height, width) = (number(&head[1..]), number(&head[3..]));
        let parts: Vec<&[u8]> = rest.chunks_exact(3).take(usize::from(head[5])).collect();
        let factors = |part: &&[u8]| (usize::from(part[1] >> 4), usize::from(part[1] & 15));
        let across = parts.iter().map(|part| factors(part).0).max()?;
        let down = parts.iter().map(|part| factors(part).1).max()?;
        let odd = |part: &&[u8]| {
            !(1..=4).contains(&factors(part).0) || !(1..=4).contains(&factors(part).1)
        };
        if head[0] != 8 || height * width == 0 || parts.iter().any(odd) {
            return None;
        }
        let units = (width.div_ceil(8 * across), height.div_ceil(8 * down));
        let component = |part: &&[u8]| {
            let (h, v) = factors(part);
            let blocks = units.0 * h * units.1 * v;
            Component {
                id: part[0],
                across: h,
                down: v,
                steps: usize::from(part[2] & 3),
                stride: units.0 * h,
                own: (
                    (width * h).div_ceil(across).div_ceil(8),
                    (height * v).div_ceil(down).div_ceil(8),
                ),
                set: vec![0; if progressive { blocks } else { 0 }],
                to_come: [255; 64],
            }
        };
        Some(Self { height, units, progressive, components: parts.iter().map(component).collect() })
    }

    /// Remembers a scan that is whole.
    fn note(&mut self, scan: &Scan<'_>) {
        for part in &scan.parts {
            let band = usize::from(scan.band.0)..=usize::from(scan.band.1);
            self.components[part.component].to_come[band].fill(scan.low);
        }
    }

    /// Whether every component is there to its last bit. Some encoders leave out detail of colour.
    fn is_complete(&self) -> bool {
        let is_done = |&bits: &u8| bits == 0;
        let begun = |&bits: &u8| bits == 0 || bits == 255;
        self.components.iter().enumerate().all(|(at, component)| {
            let to_come = &component.to_come;
            let rest =
                if at == 0 { to_come.iter().all(is_done) } else { to_come.iter().all(begun) };
            to_come[0] == 0 && rest
        })
    }
}

/// A component's part in a scan.
struct Part<'a> {
    component: usize,
    dc: Option<&'a Huffman>,
    ac: Option<&'a Huffman>,
    steps: [u16; 64],
    /// The last DC value.
    last: i32,
}

struct Scan<'a> {
    parts: Vec<Part<'a>>,
    /// First and last coefficient, in the order of coding.
    band: (u8, u8),
    high: u8,
    low: u8,
    restart: usize,
    /// Blocks to come that are empty.
    empty: usize,
}

impl<'a> Scan<'a> {
    fn read(header: &[u8], frame: &Frame, tables: &'a Tables, restart: usize) -> Option<Self> {
        let (&count, rest) = header.split_first()?;
        let (names, rest) = rest.split_at_checked(2 * usize::from(count))?;
        let [first, last, bits] = *rest.first_chunk()?;
        let band = if frame.progressive { (first, last) } else { (0, 63) };
        let (high, low) = if frame.progressive { (bits >> 4, bits & 15) } else { (0, 0) };
        let part = |name: &[u8]| {
            let is_named = |component: &Component| component.id == name[0];
            let component = frame.components.iter().position(is_named)?;
            let table =
                |tables: &'a [Option<Huffman>; 4], at: u8| tables.get(usize::from(at))?.as_ref();
            Some(Part {
                component,
                dc: table(&tables.dc, name[1] >> 4),
                ac: table(&tables.ac, name[1] & 15),
                steps: tables.steps[frame.components[component].steps].unwrap_or([1; 64]),
                last: 0,
            })
        };
        let parts: Vec<_> = names.chunks(2).map(part).collect::<Option<_>>()?;
        let needs_dc = band.0 == 0 && high == 0;
        let lacks =
            |part: &Part<'_>| needs_dc && part.dc.is_none() || band.1 > 0 && part.ac.is_none();
        let is_odd = parts.is_empty() || band.0 > band.1 || band.1 > 63 || low > 13;
        let mixes = frame.progressive && band.1 > 0 && (band.0 == 0 || parts.len() > 1);
        (!is_odd && !mixes && !parts.iter().any(lacks)).then_some(Self {
            parts,
            band,
            high,
            low,
            restart,
            empty: 0,
        })
    }

    /// Whether its rows are the first that are seen of the picture.
    fn is_first(&self) -> bool {
        self.band.0 == 0 && self.high == 0 && self.parts.iter().any(|part| part.component == 0)
    }

    /// Units across and down.
    fn units(&self, frame: &Frame) -> (usize, usize) {
        match &*self.parts {
            [part] => frame.components[part.component].own,
            _ => frame.units,
        }
    }

    /// Reads all units, and says how many are whole.
    fn walk(&mut self, frame: &mut Frame, bits: &mut Bits<'_>) -> usize {
        let (across, down) = self.units(frame);
        let mut whole = 0;
        for unit in 0..across * down {
            if self.restart > 0 && unit > 0 && unit % self.restart == 0 {
                let number = (unit / self.restart - 1) % 8;
                if self.empty > 0 || !bits.restart(number as u8) {
                    return whole;
                }
                self.parts.iter_mut().for_each(|part| part.last = 0);
                whole = unit;
            }
            if self.unit(frame, bits, (unit % across, unit / across)).is_none() {
                return whole.max(unit.saturating_sub(1));
            }
        }
        if self.empty > 0 { whole } else { across * down }
    }

    fn unit(&mut self, frame: &mut Frame, bits: &mut Bits<'_>, at: (usize, usize)) -> Option<()> {
        let (band, alone) = (self.band, self.parts.len() == 1);
        for index in 0..self.parts.len() {
            let component = &mut frame.components[self.parts[index].component];
            let (h, v) = if alone { (1, 1) } else { (component.across, component.down) };
            for block in 0..h * v {
                let (x, y) = (at.0 * h + block % h, at.1 * v + block / h);
                let mut none = 0;
                let set = component.set.get_mut(y * component.stride + x).unwrap_or(&mut none);
                if band.0 == 0 {
                    self.dc(index, bits)?;
                }
                match (band.1, self.high) {
                    (0, _) => (),
                    (_, 0) => self.ac(index, bits, set)?,
                    _ => self.refine(index, bits, set)?,
                }
            }
        }
        Some(())
    }

    fn dc(&mut self, index: usize, bits: &mut Bits<'_>) -> Option<()> {
        if self.high > 0 {
            return bits.take(1).map(drop);
        }
        let part = &mut self.parts[index];
        let size = bits.code(part.dc?)?;
        if size > 11 {
            return None;
        }
        part.last += bits.value(size)?;
        let value = (part.last.unsigned_abs() << self.low) * u32::from(part.steps[0]);
        (value <= LARGEST + (u32::from(part.steps[0]) << self.low)).then_some(())
    }

    /// The coefficients behind the first, coded for the first time.
    fn ac(&mut self, index: usize, bits: &mut Bits<'_>, set: &mut u64) -> Option<()> {
        if self.empty > 0 {
            self.empty -= 1;
            return Some(());
        }
        let part = &self.parts[index];
        let mut k = u32::from(self.band.0.max(1));
        while k <= u32::from(self.band.1) {
            let code = bits.code(part.ac?)?;
            let (run, size) = (u32::from(code >> 4), code & 15);
            match (run, size) {
                (15, 0) => k += 16,
                (_, 0) => {
                    self.empty = (1 << run) - 1 + bits.take(run)? as usize;
                    return Some(());
                }
                _ => {
                    k += run;
                    let step = u32::from(*part.steps.get(k as usize)?);
                    let value = bits.value(size)?.unsigned_abs() << self.low;
                    let most = 2 * LARGEST + (step << self.low);
                    if k > u32::from(self.band.1) || value.saturating_mul(step) > most {
                        return None;
                    }
                    *set |= 1 << k;
                    k += 1;
                }
            }
        }
        Some(())
    }

    /// One more bit of the coefficients behind the first.
    fn refine(&mut self, index: usize, bits: &mut Bits<'_>, set: &mut u64) -> Option<()> {
        let last = self.band.1;
        let mut k = self.band.0;
        while self.empty == 0 && k <= last {
            let code = bits.code(self.parts[index].ac?)?;
            let (mut run, size) = (code >> 4, code & 15);
            match (run, size) {
                (15, 0) => (),
                (_, 0) => {
                    self.empty = (1 << run) + bits.take(u32::from(run))? as usize;
                    break;
                }
                (_, 1) => drop(bits.take(1)?),
                _ => return None,
            }
            while k <= last {
                if *set >> k & 1 == 1 {
                    bits.take(1)?;
                } else if run == 0 {
                    break;
                } else {
                    run -= 1;
                }
                k += 1;
            }
            if size == 1 {
                if k > last {
                    return None;
                }
                *set |= 1 << k;
            }
            k += 1;
        }
        if self.empty > 0 {
            let known = (k..=last).filter(|&k| *set >> k & 1 == 1).count();
            for _ in 0..known {
                bits.take(1)?;
            }
            self.empty -= 1;
        }
        Some(())
    }
}

/// The bits of a scan, without what keeps them apart from markers.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    buffer: u64,
    count: u32,
}

impl<'a> Bits<'a> {
    fn new(bytes: &'a [u8], at: usize) -> Self {
        Self { bytes, at, buffer: 0, count: 0 }
    }

    fn fill(&mut self) {
        while self.count <= 48 {
            let Some(&byte) = self.bytes.get(self.at) else {
                return;
            };
            if byte == 0xff && self.bytes.get(self.at + 1) != Some(&0) {
                return;
            }
            self.at += if byte == 0xff { 2 } else { 1 };
            self.buffer = self.buffer << 8 | u64::from(byte);
            self.count += 8;
        }
    }

    /// `None` where the scan's data end.
    fn take(&mut self, count: u32) -> Option<u32> {
        if self.count < count {
            self.fill();
        }
        self.count = self.count.checked_sub(count)?;
        Some((self.buffer >> self.count) as u32 & ((1 << count) - 1))
    }

    fn code(&mut self, table: &Huffman) -> Option<u8> {
        if self.count < 16 {
            self.fill();
        }
        let next = if self.count < 16 {
            (self.buffer << (16 - self.count)) as u32 & 0xffff
        } else {
            (self.buffer >> (self.count - 16)) as u32 & 0xffff
        };
        let (length, value) = table.short[next as usize >> 8];
        if length > 0 {
            self.count = self.count.checked_sub(u32::from(length))?;
            return Some(value);
        }
        let length = (9..=16).find(|&length| next < table.long[length].0)?;
        self.count = self.count.checked_sub(length as u32)?;
        let index = (next >> (16 - length)) as i32 + table.long[length].1;
        table.values.get(usize::try_from(index).ok()?).copied()
    }

    /// A signed value of so many bits.
    fn value(&mut self, size: u8) -> Option<i32> {
        let bits = self.take(u32::from(size))? as i32;
        let half = 1 << size >> 1;
        Some(if bits < half { bits - (1 << size) + 1 } else { bits })
    }

    /// Gives back the whole bytes that were not used, and says where they begin.
    fn unread(&mut self) -> usize {
        for _ in 0..self.count / 8 {
            self.at -=
                if self.bytes[self.at - 1] == 0 && self.bytes[self.at - 2] == 0xff { 2 } else { 1 };
        }
        self.count = 0;
        self.at
    }

    /// Goes on behind a restart marker, which must come next and have this number.
    fn restart(&mut self, number: u8) -> bool {
        let rest = &self.bytes[self.unread()..];
        let is_marker = |pair: &[u8]| pair[0] == 0xff && !matches!(pair[1], 0 | 0xff);
        let Some(skipped) = rest.windows(2).position(is_marker) else {
            return false;
        };
        self.at += skipped + 2;
        rest[skipped + 1] == 0xd0 + number && is_padding(&rest[..skipped])
    }
}

#[cfg(test)]
mod tests;
