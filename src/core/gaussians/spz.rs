//! Scenes as SPZ, Niantic's layout for phones and the web: 20 bytes per Gaussian and one for each
//! higher harmonic, compressed by gzip in version 3 and by Zstandard in version 4. Both hold the
//! same numbers, quantised as `nianticlabs/spz` does.
//!
//! SPZ's y points up and its z backwards, so the scene is turned by half a turn about x.

use std::io::{self, Read, Write};

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;

use super::Gaussians;
use super::ply::{Scene, in_file};

const MAGIC: &[u8; 4] = b"NGSP";

/// Bits of a coordinate, sign included.
const COORDINATE_BITS: u32 = 24;

/// Most bits of a coordinate after the point.
const MOST_FRACTIONAL_BITS: u32 = 24;

/// Logarithms of scales are stored from this on in steps of 1/16.
const LEAST_LOG_SCALE: f32 = -10.0;
const STEPS_OF_SCALE: f32 = 16.0;

/// Base colours are stored as harmonics times this, plus a half.
const COLOUR_SCALE: f32 = 0.15;

/// Steps of 1/128 between the stored harmonics of degree 1, and of higher degrees: five and four
/// bits.
const BUCKETS: [f32; 2] = [8.0, 16.0];

/// Bytes of a version 4 file before its table of streams.
const HEADER_4: usize = 32;

/// Bytes before the streams of an unpacked version 3 file.
const HEADER_3: usize = 16;

/// Zstandard's level: 2 % smaller than its default, 3, in three times the time.
const LEVEL: i32 = 12;

/// Approximate size of this many Gaussians in bytes.
pub fn bytes_of(count: usize, sh_degree: u32) -> u64 {
    let harmonics = 3 * ((sh_degree + 1) * (sh_degree + 1) - 1);
    // Harmonics have four bits at most, and many are zero.
    count as u64 * (18 + u64::from(harmonics) / 4)
}

/// Writes version 3; Gaussians that are not [usable](Gaussians::is_usable) are left out.
///
/// # Errors
/// Those of the writer, and if the scene is too large for SPZ.
pub fn write_version_3(scene: &Scene, out: &mut dyn Write) -> io::Result<()> {
    let packed = Packed::of(scene)?;
    let mut gzip = GzEncoder::new(out, Compression::default());
    gzip.write_all(&packed.header(3, 0))?;
    for stream in &packed.streams {
        gzip.write_all(stream)?;
    }
    gzip.finish()?.flush()
}

/// Writes version 4; Gaussians that are not [usable](Gaussians::is_usable) are left out.
///
/// # Errors
/// As [`write_version_3`].
pub fn write_version_4(scene: &Scene, out: &mut dyn Write) -> io::Result<()> {
    let packed = Packed::of(scene)?;
    let streams: Vec<_> = packed.streams.iter().filter(|stream| !stream.is_empty()).collect();
    let mut header = packed.header(4, streams.len() as u8);
    header.extend((HEADER_4 as u32).to_le_bytes());
    header.resize(HEADER_4, 0);
    let mut compressed = Vec::with_capacity(streams.len());
    for stream in streams {
        let bytes = zstd::bulk::compress(stream, LEVEL)?;
        header.extend((bytes.len() as u64).to_le_bytes());
        header.extend((stream.len() as u64).to_le_bytes());
        compressed.push(bytes);
    }
    out.write_all(&header)?;
    compressed.iter().try_for_each(|bytes| out.write_all(bytes))?;
    out.flush()
}

/// Reads version 3.
///
/// # Errors
/// Those of gzip; [`io::ErrorKind::InvalidData`] if the file is of another version or its length is
/// not that of its Gaussians.
pub fn read_version_3(bytes: &[u8]) -> io::Result<Gaussians> {
    let mut unpacked = Vec::new();
    GzDecoder::new(bytes).read_to_end(&mut unpacked)?;
    unpack(&unpacked)
        .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidData, "not a whole SPZ of version 3"))
}

/// The Gaussians of an unpacked file of version 3; `None` if it is not one.
fn unpack(bytes: &[u8]) -> Option<Gaussians> {
    let (header, mut rest) = bytes.split_first_chunk::<HEADER_3>()?;
    let [.., sh_degree, fractional_bits, _, _] = *header;
    let count = usize::try_from(u32::from_le_bytes(header[8..12].try_into().ok()?)).ok()?;
    let is_known = header.starts_with(b"NGSP\x03\0\0\0") && sh_degree <= 3;
    if !is_known || u32::from(fractional_bits) > MOST_FRACTIONAL_BITS {
        return None;
    }
    let higher = 3 * ((usize::from(sh_degree) + 1).pow(2) - 1);
    let mut stream = |width: usize| {
        let (stream, others) = rest.split_at_checked(width.checked_mul(count)?)?;
        rest = others;
        Some(stream)
    };
    let (means, alphas, colours, scales) = (stream(9)?, stream(1)?, stream(3)?, stream(3)?);
    let (rotations, harmonics) = (stream(4)?, stream(higher)?);
    if !rest.is_empty() {
        return None;
    }
    let unit = f64::from(1 << fractional_bits);
    let mean = |axis: &[u8]| {
        let fixed = i32::from_le_bytes([0, axis[0], axis[1], axis[2]]) >> 8;
        (f64::from(fixed) / unit) as f32
    };
    let mut gaussians = Gaussians { sh_degree: sh_degree.into(), ..Gaussians::default() };
    for i in 0..count {
        let axes = &means[9 * i..][..9];
        gaussians.means.push([mean(axes), mean(&axes[3..]), mean(&axes[6..])]);
        // Without an infinite logit, and within half a step.
        let alpha = (f32::from(alphas[i]) / 255.0).clamp(1.0 / 510.0, 509.0 / 510.0);
        gaussians.opacity_logits.push((alpha / (1.0 - alpha)).ln());
        let scale = |axis: usize| f32::from(scales[3 * i + axis]) / STEPS_OF_SCALE;
        gaussians.log_scales.push(std::array::from_fn(|axis| scale(axis) + LEAST_LOG_SCALE));
        let packed = rotations[4 * i..].first_chunk()?;
        gaussians.quats.push(unpack_rotation(u32::from_le_bytes(*packed)));
        let base = |byte: &u8| (f32::from(*byte) / 255.0 - 0.5) / COLOUR_SCALE;
        gaussians.sh.extend(colours[3 * i..][..3].iter().map(base));
        let harmonic = |byte: &u8| (f32::from(*byte) - 128.0) / 128.0;
        gaussians.sh.extend(harmonics[higher * i..][..higher].iter().map(harmonic));
    }
    // Half a turn twice is none.
    Some(gaussians.turned_y_up())
}

/// Quantised Gaussians.
struct Packed {
    count: u32,
    sh_degree: u8,
    fractional_bits: u8,
    /// Means, opacities, colours, scales, rotations, higher harmonics.
    streams: [Vec<u8>; 6],
}

impl Packed {
    fn of(scene: &Scene) -> io::Result<Self> {
        let gaussians = in_file(&scene.gaussians, &scene.normalisation).without_unusable();
        let gaussians = gaussians.turned_y_up();
        let fractional_bits = fractional_bits(&gaussians)?;
        require_scales(&gaussians)?;
        let count = u32::try_from(gaussians.len());
        let mut streams: [Vec<u8>; 6] = Default::default();
        let row = 3 * gaussians.coefficients();
        for index in 0..gaussians.len() {
            for value in gaussians.means[index] {
                let fixed = (f64::from(value) * f64::from(1 << fractional_bits)).round() as i32;
                streams[0].extend(&fixed.to_le_bytes()[..3]);
            }
            // The casts clamp values outside the range.
            streams[1].push((gaussians.opacity(index) * 255.0).round() as u8);
            let sh = &gaussians.sh[index * row..][..row];
            let colour = |value: &f32| ((value * COLOUR_SCALE + 0.5) * 255.0).round() as u8;
            streams[2].extend(sh[..3].iter().map(colour));
            let scale = |log: f32| ((log - LEAST_LOG_SCALE) * STEPS_OF_SCALE).round() as u8;
            streams[3].extend(gaussians.log_scales[index].map(scale));
            let [w, x, y, z] = gaussians.rotation(index);
            streams[4].extend(pack_rotation([x, y, z, w]).to_le_bytes());
            let higher = sh[3..].iter().enumerate();
            let bucket = |n: usize| BUCKETS[usize::from(n >= 9)];
            streams[5].extend(higher.map(|(n, value)| harmonic(*value, bucket(n))));
        }
        Ok(Self {
            count: count.map_err(|_| io::Error::other("SPZ cannot number that many Gaussians"))?,
            sh_degree: gaussians.sh_degree as u8,
            fractional_bits: fractional_bits as u8,
            streams,
        })
    }

    /// The 16 bytes that both versions begin with.
    fn header(&self, version: u32, streams: u8) -> Vec<u8> {
        let flags = 0;
        let mut header = MAGIC.to_vec();
        header.extend(version.to_le_bytes());
        header.extend(self.count.to_le_bytes());
        header.extend([self.sh_degree, self.fractional_bits, flags, streams]);
        header
    }
}

/// As many bits after the point as the largest coordinate leaves.
fn fractional_bits(gaussians: &Gaussians) -> io::Result<u32> {
    let largest = gaussians.means.as_flattened().iter().fold(0.0, |most: f32, v| most.max(v.abs()));
    let most = f64::from((1 << (COORDINATE_BITS - 1)) - 1);
    let fits = |bits: &u32| f64::from(largest) * f64::from(1 << bits) <= most;
    let bits = (0..=MOST_FRACTIONAL_BITS).rev().find(fits);
    bits.ok_or_else(|| {
        io::Error::other(format!("SPZ holds coordinates up to {most}, the scene has {largest}"))
    })
}

/// SPZ clamps scales. Gaussians that are too thin are still right where they are seen, but a scene
/// in millimetres would shrink, and one in kilometres grow.
fn require_scales(gaussians: &Gaussians) -> io::Result<()> {
    let longest = gaussians.log_scales.as_flattened().iter().copied().fold(f32::MIN, f32::max);
    let range = LEAST_LOG_SCALE..=LEAST_LOG_SCALE + 255.5 / STEPS_OF_SCALE;
    if gaussians.is_empty() || range.contains(&longest) {
        return Ok(());
    }
    let (least, most) = (range.start().exp(), range.end().exp());
    Err(io::Error::other(format!(
        "SPZ holds Gaussians of {least:.5} to {most:.0} units, the scene's largest has {}: export it \
         in another format",
        longest.exp()
    )))
}

/// The index of the largest of x, y, z, w, then sign and magnitude of the three others, which are
/// below the root of a half.
fn pack_rotation(quat: [f64; 4]) -> u32 {
    let largest = (1..4).fold(0, |best, i| if quat[i].abs() > quat[best].abs() { i } else { best });
    // A rotation equals its negative: make the largest positive, so it need not be stored.
    let sign = quat[largest].signum();
    (0..4).filter(|&i| i != largest).fold(largest as u32, |packed, i| {
        let magnitude = (511.0 * quat[i].abs() * std::f64::consts::SQRT_2).round() as u32;
        packed << 10 | u32::from(quat[i] * sign < 0.0) << 9 | magnitude
    })
}

/// The inverse of [`pack_rotation`], as w, x, y, z.
fn unpack_rotation(mut packed: u32) -> [f32; 4] {
    let largest = (packed >> 30) as usize;
    let mut xyzw = [0.0_f32; 4];
    for i in (0..4).rev().filter(|&i| i != largest) {
        let magnitude = (packed & 511) as f32 / 511.0 * std::f32::consts::FRAC_1_SQRT_2;
        xyzw[i] = if packed >> 9 & 1 == 1 { -magnitude } else { magnitude };
        packed >>= 10;
    }
    xyzw[largest] = (1.0 - xyzw.iter().map(|q| q * q).sum::<f32>()).max(0.0).sqrt();
    let [x, y, z, w] = xyzw;
    [w, x, y, z]
}

/// A harmonic from -1 to 1 as the middle of one of its buckets.
fn harmonic(value: f32, bucket: f32) -> u8 {
    // The cast clamps values outside the range.
    (((value * 128.0 + 128.0) / bucket).round() * bucket) as u8
}

#[cfg(test)]
mod tests;
