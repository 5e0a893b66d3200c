//! Golden light of patches in files with a profile. Computed by the definitions of the colour
//! spaces (chromaticities, Bradford adaptation) in tests/golden/colour.py. Little CMS 2.19 agrees
//! to half a level of 255 in the colours that sRGB has.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use ::image::{ExtendedColorType, ImageEncoder};
use moxcms::ToneReprCurve;

use super::*;
use crate::image::exif::tests::block;
use crate::image::{Srgb, read_header};

const PATCHES: [[u8; 3]; 4] = [[200, 120, 60], [20, 40, 30], [128, 128, 128], [30, 220, 40]];

const P3: [[f32; 3]; 4] = [
    [0.66525, 0.17143, 0.02352],
    [0.0038, 0.02182, 0.01245],
    [0.21586, 0.21586, 0.21586],
    [-0.14508, 0.74525, -0.03323],
];
const ADOBE: [[f32; 3]; 4] = [
    [0.74364, 0.19058, 0.0351],
    [-0.0016, 0.01701, 0.00869],
    [0.21964, 0.21964, 0.21964],
    [-0.27528, 0.72276, -0.01328],
];
const PROPHOTO: [[f32; 3]; 4] = [
    [1.10372, 0.16917, 0.04092],
    [-0.01162, 0.0415, 0.01912],
    [0.2892, 0.2892, 0.2892],
    [-0.52556, 0.93933, -0.07627],
];
const LINEAR: [[f32; 3]; 4] = [
    [0.78431, 0.47059, 0.23529],
    [0.07843, 0.15686, 0.11765],
    [0.50196, 0.50196, 0.50196],
    [0.11765, 0.86275, 0.15686],
];
const SRGB: [[f32; 3]; 4] = [
    [0.57758, 0.18782, 0.04519],
    [0.007, 0.02122, 0.01298],
    [0.21586, 0.21586, 0.21586],
    [0.01298, 0.71569, 0.02122],
];

/// Blocks of 16 px, so that no chroma is shared between them.
const BLOCK: usize = 16;

fn pixels(deep: bool) -> Vec<u8> {
    let pixel = |x: usize| PATCHES[x / BLOCK];
    let row = || (0..4 * BLOCK).flat_map(pixel);
    let all = (0..BLOCK).flat_map(|_| row());
    if deep {
        all.flat_map(|v| (257 * u16::from(v)).to_ne_bytes()).collect()
    } else {
        all.collect()
    }
}

fn linear_srgb() -> ColorProfile {
    let mut profile = ColorProfile::new_srgb();
    let curve = Some(ToneReprCurve::Lut(Vec::new()));
    [profile.red_trc, profile.green_trc, profile.blue_trc] = [curve.clone(), curve.clone(), curve];
    profile.cicp = None;
    profile
}

/// A PNG, JPEG, WebP or TIFF by its extension.
fn written(folder: &Path, name: &str, profile: &ColorProfile, deep: bool) -> PathBuf {
    let icc = profile.encode().expect("a profile");
    let (width, height) = (4 * BLOCK as u32, BLOCK as u32);
    let colour = if deep { ExtendedColorType::Rgb16 } else { ExtendedColorType::Rgb8 };
    let mut bytes = Vec::new();
    let samples = pixels(deep);
    macro_rules! write {
        ($encoder:expr) => {{
            let mut encoder = $encoder;
            encoder.set_icc_profile(icc).expect("takes a profile");
            encoder.write_image(&samples, width, height, colour).expect("encoded");
        }};
    }
    match name.rsplit_once('.').map_or("", |(_, extension)| extension) {
        "png" => write!(::image::codecs::png::PngEncoder::new(&mut bytes)),
        "jpg" => write!(::image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 100)),
        "webp" => write!(::image::codecs::webp::WebPEncoder::new_lossless(&mut bytes)),
        _ => bytes = tiff(&icc, &samples, deep),
    }
    let path = folder.join(name);
    fs::write(&path, bytes).expect("written");
    path
}

fn tiff(icc: &[u8], samples: &[u8], deep: bool) -> Vec<u8> {
    use tiff::encoder::{TiffEncoder, colortype};
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).expect("a TIFF");
    let (width, height) = (4 * BLOCK as u32, BLOCK as u32);
    let tag = tiff::tags::Tag::IccProfile;
    if deep {
        let samples: Vec<u16> =
            samples.chunks_exact(2).map(|v| u16::from_ne_bytes([v[0], v[1]])).collect();
        let mut image = encoder.new_image::<colortype::RGB16>(width, height).expect("an image");
        image.encoder().write_tag(tag, icc).expect("a tag");
        image.write_data(&samples).expect("encoded");
    } else {
        let mut image = encoder.new_image::<colortype::RGB8>(width, height).expect("an image");
        image.encoder().write_tag(tag, icc).expect("a tag");
        image.write_data(samples).expect("encoded");
    }
    bytes.into_inner()
}

/// The largest error, in levels of 255 as sRGB: the middle of each block against its golden light.
fn error(path: &Path, golden: &[[f32; 3]; 4]) -> f32 {
    let light = Image::<Linear>::load_light(path, usize::MAX).expect("read");
    let whole = Image::<Srgb>::load(path).expect("read");
    let mut worst = 0.0_f32;
    for (block, wanted) in golden.iter().enumerate() {
        let at = (block * BLOCK + BLOCK / 2, BLOCK / 2);
        let wanted = wanted.map(crate::image::linear_to_srgb);
        let light = light.get(at.0, at.1).map(crate::image::linear_to_srgb);
        let whole = whole.get(at.0, at.1);
        for channel in 0..3 {
            worst = worst.max((light[channel] - wanted[channel]).abs());
            worst = worst.max((whole[channel] - wanted[channel]).abs());
        }
    }
    255.0 * worst
}

#[test]
fn patches_in_every_colour_space_and_format_have_their_golden_light() {
    let folder = tempfile::tempdir().expect("a folder");
    let spaces = [
        ("p3", ColorProfile::new_display_p3(), P3),
        ("adobe", ColorProfile::new_adobe_rgb(), ADOBE),
        ("prophoto", ColorProfile::new_pro_photo_rgb(), PROPHOTO),
        ("linear", linear_srgb(), LINEAR),
        ("srgb", ColorProfile::new_srgb(), SRGB),
    ];
    for (space, profile, golden) in &spaces {
        for (format, deep, tolerance) in [
            ("png", false, 0.5),
            ("png", true, 0.5),
            ("tif", false, 0.5),
            ("tif", true, 0.5),
            ("webp", false, 0.5),
            // ProPhoto's primaries amplify a JPEG's rounding in the dark.
            ("jpg", false, 6.0),
        ] {
            let name = format!("{space}-{deep}.{format}");
            let path = written(folder.path(), &name, profile, deep);
            let worst = error(&path, golden);
            assert!(worst < tolerance, "{name}: {worst} levels off");
            let header = read_header(&path).expect("a header");
            assert_eq!(header.profile.is_some(), *space != "srgb", "{name}: {:?}", header.profile);
            assert_eq!(header.profile_fault, None, "{name}");
        }
    }
}

#[test]
fn black_is_black_in_every_colour_space() {
    for profile in [
        ColorProfile::new_display_p3(),
        ColorProfile::new_adobe_rgb(),
        ColorProfile::new_pro_photo_rgb(),
        linear_srgb(),
    ] {
        let colour =
            Colour::of_icc(&profile.encode().expect("a profile"), Channels::Rgb).expect("read");
        assert!(colour.light(0, 0.0).abs() < 1e-6, "{:?}", colour.name());
        assert!((colour.light(0, 1.0) - 1.0).abs() < 1e-4, "{:?}", colour.name());
    }
}

#[test]
fn a_broken_profile_is_named_and_the_values_are_srgb() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.png");
    let mut bytes = Vec::new();
    let mut encoder = ::image::codecs::png::PngEncoder::new(&mut bytes);
    encoder.set_icc_profile(vec![7; 200]).expect("takes a profile");
    let size = (4 * BLOCK as u32, BLOCK as u32);
    encoder.write_image(&pixels(false), size.0, size.1, ExtendedColorType::Rgb8).expect("png");
    fs::write(&path, bytes).expect("written");
    let header = read_header(&path).expect("a header");
    assert!(header.profile_fault.is_some_and(|fault| !fault.is_empty()));
    assert_eq!(header.profile, None);
    assert!(error(&path, &SRGB) < 0.5);
}

#[test]
fn a_grey_profile_is_a_curve_and_one_for_rgb_is_refused_there() {
    let grey = ColorProfile::new_gray_with_gamma(2.2).encode().expect("a profile");
    let colour = Colour::of_icc(&grey, Channels::Grey).expect("a grey profile");
    assert!((colour.light(0, 0.5) - 0.5_f32.powf(2.2)).abs() < 1e-3, "{}", colour.light(0, 0.5));
    let fault = Colour::of_icc(&grey, Channels::Rgb).err().expect("not for RGB");
    assert!(fault.contains("the picture is RGB"), "{fault}");
}

#[test]
fn png_chunks_code_points_and_exif_declare_colours_too() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.png");
    let png_with = |declare: &dyn Fn(&mut png::Info<'_>), points: Option<[u8; 4]>| {
        let mut bytes = Vec::new();
        let mut info = png::Info::with_size(4 * BLOCK as u32, BLOCK as u32);
        (info.color_type, info.bit_depth) = (png::ColorType::Rgb, png::BitDepth::Eight);
        declare(&mut info);
        let encoder = png::Encoder::with_info(&mut bytes, info).expect("an encoder");
        let mut writer = encoder.write_header().expect("a header");
        if let Some(points) = points {
            writer.write_chunk(png::chunk::ChunkType(*b"cICP"), &points).expect("written");
        }
        writer.write_image_data(&pixels(false)).expect("encoded");
        writer.finish().expect("ended");
        fs::write(&path, bytes).expect("written");
    };
    let png = |declare: &dyn Fn(&mut png::Info<'_>)| png_with(declare, None);
    png(&|info| info.source_gamma = Some(png::ScaledFloat::new(1.0)));
    assert!(error(&path, &LINEAR) < 0.5, "gAMA of linear light");
    png(&|info| info.source_gamma = Some(png::ScaledFloat::new(0.45455)));
    assert!(error(&path, &SRGB) < 0.5, "the usual gAMA is sRGB");
    png(&|info| {
        info.source_gamma = Some(png::ScaledFloat::new(0.50994));
        let xy = [(0.3127, 0.329), (0.64, 0.33), (0.3, 0.6), (0.15, 0.06)];
        let of = png::SourceChromaticities::new(xy[0], xy[1], xy[2], xy[3]);
        info.source_chromaticities = Some(of);
    });
    assert!(error(&path, &SRGB) < 0.5, "a frame that ffmpeg wrote of a BT.709 video");
    png_with(&|_| {}, Some([12, 13, 0, 1]));
    assert!(error(&path, &P3) < 0.5, "cICP of Display P3");
    png_with(&|_| {}, Some([9, 16, 0, 1]));
    let fault = read_header(&path).expect("a header").profile_fault;
    assert!(fault.expect("a fault").contains("PQ"));
    png(&|info| {
        let xy = [(0.3127, 0.329), (0.68, 0.32), (0.265, 0.69), (0.15, 0.06)];
        let of = png::SourceChromaticities::new(xy[0], xy[1], xy[2], xy[3]);
        info.source_chromaticities = Some(of);
    });
    assert!(error(&path, &P3) < 0.5, "cHRM of Display P3");
    let p3 = Colour::of_code_points(12, 13).expect("Display P3");
    assert_eq!(p3.name(), Some("Display P3"));
    assert!(Colour::of_code_points(1, 13).expect("sRGB").is_srgb());

    let exif = block(&[
        (::exif::Tag::ColorSpace, ::exif::Value::Short(vec![65_535])),
        (::exif::Tag::InteroperabilityIndex, ::exif::Value::Ascii(vec![b"R03".to_vec()])),
    ]);
    let mut bytes = Vec::new();
    let mut encoder = ::image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 100);
    encoder.set_exif_metadata(exif).expect("takes EXIF");
    let size = (4 * BLOCK as u32, BLOCK as u32);
    encoder.write_image(&pixels(false), size.0, size.1, ExtendedColorType::Rgb8).expect("a JPEG");
    let path = folder.path().join("a.jpg");
    fs::write(&path, bytes).expect("written");
    assert!(error(&path, &ADOBE) < 6.0, "a camera's Adobe RGB");
    assert!(read_header(&path).expect("a header").profile.expect("named").contains("Adobe"));
}

const CMYK: &[u8] = include_bytes!("../../../../tests/golden/photographs/cmyk.icc");

/// Inks, and the levels of sRGB that LittleCMS 2.19 gives them by that profile: both of
/// tests/golden/inks.py.
const INKS: [[u8; 4]; 4] =
    [[20, 110, 140, 12], [190, 60, 200, 90], [0, 0, 0, 130], [210, 150, 10, 0]];
const INKS_IN_SRGB: [[u8; 3]; 4] = [[205, 156, 107], [75, 99, 53], [159, 158, 158], [67, 102, 145]];

fn light_of_inks() -> [[f32; 3]; 4] {
    INKS_IN_SRGB.map(|levels| levels.map(|v| srgb_to_linear(f32::from(v) / 255.0)))
}

/// A TIFF of blocks of inks, of 16 bits.
fn tiff_of_inks(icc: Option<&[u8]>) -> Vec<u8> {
    use tiff::encoder::{TiffEncoder, colortype};
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).expect("a TIFF");
    let row = || (0..4 * BLOCK).flat_map(|x| INKS[x / BLOCK].map(|v| 257 * u16::from(v)));
    let samples: Vec<u16> = (0..BLOCK).flat_map(|_| row()).collect();
    let size = (4 * BLOCK as u32, BLOCK as u32);
    let mut image = encoder.new_image::<colortype::CMYK16>(size.0, size.1).expect("an image");
    if let Some(icc) = icc {
        image.encoder().write_tag(tiff::tags::Tag::IccProfile, icc).expect("a tag");
    }
    image.write_data(&samples).expect("encoded");
    bytes.into_inner()
}

#[test]
fn inks_have_the_light_that_their_profile_gives_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let deep = tiff_of_inks(Some(CMYK));
    let files: [(&str, &[u8], f32); 3] = [
        ("deep.tif", &deep, 0.8),
        ("inks.jpg", include_bytes!("../../../../tests/golden/photographs/inks.jpg"), 1.5),
        ("ycck.jpg", include_bytes!("../../../../tests/golden/photographs/inks-ycck.jpg"), 1.5),
    ];
    for (name, bytes, tolerance) in files {
        let path = folder.path().join(name);
        fs::write(&path, bytes).expect("written");
        let worst = error(&path, &light_of_inks());
        assert!(worst < tolerance, "{name}: {worst} levels off");
        let header = read_header(&path).expect("a header");
        assert_eq!(header.profile.as_deref(), Some("fled inks"), "{name}");
        assert_eq!(header.profile_fault, None, "{name}");
    }
}

#[test]
fn inks_without_a_usable_profile_are_converted_plainly_and_say_so() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.tif");
    let rgb = ColorProfile::new_adobe_rgb().encode().expect("a profile");
    for (icc, fault) in [
        (None, "it is CMYK and has none"),
        (Some(&rgb[..]), "the picture is CMYK"),
        (Some(&CMYK[..1000]), ""),
    ] {
        fs::write(&path, tiff_of_inks(icc)).expect("written");
        let header = read_header(&path).expect("a header");
        let found = header.profile_fault.expect("a fault");
        assert!(found.contains(fault), "{found}");
        assert_eq!(header.profile, None);
        // (1 - ink) (1 - black)
        let plain = INKS.map(|[c, m, y, k]| {
            [c, m, y].map(|v| srgb_to_linear(f32::from(255 - v) * f32::from(255 - k) / 65_025.0))
        });
        assert!(error(&path, &plain) < 0.5);
        assert!(error(&path, &light_of_inks()) > 10.0, "the profile matters here");
    }
}

#[test]
fn a_table_of_inks_gives_white_paper_and_colours_outside_of_srgb() {
    let colour = Colour::of_icc(CMYK, Channels::Cmyk).expect("a profile");
    let inks = colour.inks().expect("of inks");
    let light = |values: [u8; 4]| {
        let halves = inks.halves(&values, 255.0);
        [0, 1, 2].map(|c| half::f16::from_bits(halves[c]).to_f32())
    };
    assert!(light([0; 4]).iter().all(|v| (v - 1.0).abs() < 2e-3), "{:?}", light([0; 4]));
    assert!(light([255, 0, 0, 0])[0] < -0.05, "cyan: {:?}", light([255, 0, 0, 0]));
}

#[test]
fn a_table_of_inks_that_is_not_whole_is_refused() {
    let mut profile = ColorProfile::new_from_slice(CMYK).expect("a profile");
    profile.pcs = DataColorSpace::Xyz;
    assert!(Inks::new(&profile).err().expect("of XYZ").contains("Lab"));
    profile.pcs = DataColorSpace::Lab;
    assert!(Inks::new(&profile).is_ok());
    let Some(moxcms::LutWarehouse::Lut(table)) = &mut profile.lut_a_to_b_perceptual else {
        panic!("a table");
    };
    table.num_clut_grid_points = 6;
    assert!(Inks::new(&profile).err().expect("cut").contains("broken"));
    profile.lut_a_to_b_perceptual = None;
    assert!(Inks::new(&profile).err().expect("none").contains("no table"));
}
