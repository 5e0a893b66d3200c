//! Colour spaces: from a picture's values to linear light of sRGB primaries.
//!
//! A picture without a profile is sRGB. A profile of curves and primaries (ICC "matrix/TRC", or
//! code points of ITU-T H.273, or PNG's `gAMA` and `cHRM`) is converted without clipping: colours
//! outside of sRGB have light below 0 or above 1. So is CMYK by a profile's table ([`inks`]). RGB
//! with profiles of tables is converted by `moxcms` to 16-bit sRGB. White stays white
//! (media-relative, ICC.1:2022).

mod inks;

use std::panic::{AssertUnwindSafe, catch_unwind};

use moxcms::{
    Chromaticity, CicpColorPrimaries, ColorPrimaries, ColorProfile, DataColorSpace, Layout,
    ProfileText, RenderingIntent, ToneCurveEvaluator, ToneReprCurve, TransformOptions,
};

pub(super) use self::inks::Inks;
use super::transfer::srgb_to_linear;
use super::{Image, Linear};

/// Largest difference in linear light from sRGB, and of the matrix from the identity, of a profile
/// that is taken for sRGB: its tables round to 16 bits.
const SRGB_TOLERANCE: (f32, f32) = (1e-4, 1e-3);

/// Samples at which a curve is compared with sRGB's.
const COMPARED: u16 = 64;

/// Largest matrix element of a plausible profile; primaries in a line give infinity.
const LARGEST_ELEMENT: f32 = 16.0;

/// The `gAMA` that says sRGB: 1/2.2, which programs write beside its own chunk or in place of it,
/// and 1/1.961, which ffmpeg writes for the curves of video.
const USUAL_GAMMAS: [f32; 2] = [0.454_55, 0.509_94];

/// Light of a value in 0..=1 that a plausible curve gives.
const PLAUSIBLE_LIGHT: std::ops::RangeInclusive<f32> = -1.0..=2.0;

/// The colour space of a picture's values.
pub(super) struct Colour {
    /// The profile's own name, unless the values are sRGB.
    name: Option<String>,
    form: Form,
}

enum Form {
    Srgb,
    Matrix(Box<Shaper>),
    Tables(Box<ColorProfile>),
    Inks(Box<Inks>),
    /// Values are light.
    Light,
}

/// The kind of a picture's samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Channels {
    Grey,
    Rgb,
    Cmyk,
}

/// A curve for each channel, then a matrix.
struct Shaper {
    curves: [Curve; 3],
    /// From linear light of the file's primaries to that of sRGB's.
    to_srgb: [[f32; 3]; 3],
}

/// From encoded values to linear light.
enum Curve {
    Srgb,
    Power(f32),
    Profile(Box<dyn ToneCurveEvaluator>),
}

impl Curve {
    fn light(&self, value: f32) -> f32 {
        match self {
            Self::Srgb => srgb_to_linear(value),
            Self::Power(exponent) => value.powf(*exponent),
            Self::Profile(curve) => curve.evaluate_value(value),
        }
    }

    fn is_plausible(&self) -> bool {
        compared().all(|value| PLAUSIBLE_LIGHT.contains(&self.light(value)))
    }

    fn of(curve: Option<&ToneReprCurve>) -> Result<Self, String> {
        let curve = curve.ok_or("it has no curve")?;
        // One entry is an exponent in 256ths, which moxcms 0.8.1 evaluates wrongly at black.
        if let ToneReprCurve::Lut(table) = curve
            && let [exponent] = table[..]
        {
            return Ok(Self::Power(f32::from(exponent) / 256.0));
        }
        let evaluator = curve.make_linear_evaluator().map_err(|error| error.to_string())?;
        Ok(Self::Profile(evaluator))
    }
}

impl Colour {
    /// sRGB.
    pub(super) fn srgb() -> Self {
        Self { name: None, form: Form::Srgb }
    }

    /// Light of sRGB's primaries.
    pub(super) fn light_itself() -> Self {
        Self { name: None, form: Form::Light }
    }

    /// Adobe RGB (1998).
    pub(super) fn adobe_rgb() -> Self {
        Self::of_profile(ColorProfile::new_adobe_rgb(), Channels::Rgb)
            .unwrap_or_else(|_| Self::srgb())
    }

    /// The colours of an ICC profile.
    ///
    /// # Errors
    /// Why it cannot be used.
    pub(super) fn of_icc(bytes: &[u8], channels: Channels) -> Result<Self, String> {
        // A profile that its reader does not survive is as unusable as a broken one.
        let read = || {
            let profile = ColorProfile::new_from_slice(bytes).map_err(|error| error.to_string())?;
            Self::of_profile(profile, channels)
        };
        catch_unwind(AssertUnwindSafe(read))
            .unwrap_or_else(|_| Err("its reader gave up".to_owned()))
    }

    fn of_profile(profile: ColorProfile, channels: Channels) -> Result<Self, String> {
        let name = profile.description.as_ref().map(text).filter(|name| !name.is_empty());
        let name = name.unwrap_or_else(|| "a profile without a name".to_owned());
        match (profile.color_space, channels) {
            (DataColorSpace::Gray, Channels::Grey) => {
                let curve = || Curve::of(profile.gray_trc.as_ref());
                let curves = [curve()?, curve()?, curve()?];
                Self::shaped(name, Shaper { curves, to_srgb: IDENTITY })
            }
            (DataColorSpace::Rgb, Channels::Rgb) if profile.red_trc.is_some() => {
                if profile.pcs != DataColorSpace::Xyz {
                    return Err("its curves lead to Lab, not to XYZ".to_owned());
                }
                let [red, green, blue] =
                    [&profile.red_trc, &profile.green_trc, &profile.blue_trc].map(Option::as_ref);
                let curves = [Curve::of(red)?, Curve::of(green)?, Curve::of(blue)?];
                Self::shaped(name, Shaper { curves, to_srgb: to_srgb(&profile) })
            }
            (DataColorSpace::Rgb, Channels::Rgb) => {
                let form = Form::Tables(Box::new(profile));
                let colour = Self { name: Some(name), form };
                colour.table_converted(&[0; 3]).map(|_| colour)
            }
            (DataColorSpace::Cmyk, Channels::Cmyk) => {
                let form = Form::Inks(Box::new(Inks::new(&profile)?));
                Ok(Self { name: Some(name), form })
            }
            (space, _) => {
                let of = match channels {
                    Channels::Grey => "grey",
                    Channels::Rgb => "RGB",
                    Channels::Cmyk => "CMYK",
                };
                Err(format!("it is for {space:?} values, and the picture is {of}"))
            }
        }
    }

    /// Code points of ITU-T H.273: primaries and transfer function. The curves of video are sRGB's
    /// here, as every player shows them. `None` for primaries that are not supported.
    pub(super) fn of_code_points(primaries: u8, transfer: u8) -> Option<Self> {
        let curve = || match transfer {
            4 => Curve::Power(2.2),
            5 => Curve::Power(2.8),
            8 => Curve::Power(1.0),
            _ => Curve::Srgb,
        };
        let (red_green_blue, white) = match CicpColorPrimaries::try_from(primaries).ok()? {
            CicpColorPrimaries::Unspecified => (ColorPrimaries::BT_709, Chromaticity::D65),
            known @ (CicpColorPrimaries::Bt709
            | CicpColorPrimaries::Bt2020
            | CicpColorPrimaries::Smpte432) => {
                (ColorPrimaries::try_from(known).ok()?, Chromaticity::D65)
            }
            _ => return None,
        };
        let to_srgb = to_srgb(&with_primaries(red_green_blue, white));
        let name = match primaries {
            9 => "BT.2020",
            12 => "Display P3",
            _ => "code points",
        };
        let curves = [curve(), curve(), curve()];
        Self::shaped(name.to_owned(), Shaper { curves, to_srgb }).ok()
    }

    /// PNG's `gAMA` (the exponent of encoding) and `cHRM` (white, red, green, blue; xy).
    pub(super) fn of_gamma(gamma: Option<f32>, chromaticities: Option<[[f32; 2]; 4]>) -> Self {
        let is_usual = |gamma: &f32| USUAL_GAMMAS.iter().any(|usual| (gamma - usual).abs() < 5e-4);
        let gamma = gamma.filter(|gamma| *gamma > 0.05 && *gamma < 5.0 && !is_usual(gamma));
        let curve = || gamma.map_or(Curve::Srgb, |gamma| Curve::Power(gamma.recip()));
        let to_srgb = chromaticities.map_or(IDENTITY, |[white, red, green, blue]| {
            let [white, red, green, blue] =
                [white, red, green, blue].map(|[x, y]| Chromaticity { x, y });
            to_srgb(&with_primaries(ColorPrimaries { red, green, blue }, white))
        });
        let curves = [curve(), curve(), curve()];
        Self::shaped("gAMA and cHRM".to_owned(), Shaper { curves, to_srgb })
            .unwrap_or_else(|_| Self::srgb())
    }

    fn shaped(name: String, shaper: Shaper) -> Result<Self, String> {
        let is_plausible = |element: &f32| element.abs() < LARGEST_ELEMENT;
        if !shaper.to_srgb.iter().flatten().all(is_plausible) {
            return Err("its primaries are not three colours".to_owned());
        }
        if !shaper.curves.iter().all(Curve::is_plausible) {
            return Err("its curves are not of light".to_owned());
        }
        Ok(if shaper.is_srgb() {
            Self::srgb()
        } else {
            Self { name: Some(name), form: Form::Matrix(Box::new(shaper)) }
        })
    }

    /// The name of the profile, unless the values are sRGB.
    pub(super) fn name(&self) -> Option<&str> {
        self.name.as_deref()
    }

    /// Whether values are sRGB.
    pub(super) fn is_srgb(&self) -> bool {
        matches!(self.form, Form::Srgb)
    }

    /// Whether values go through tables, by [`Self::table_converted`].
    pub(super) fn has_tables(&self) -> bool {
        matches!(self.form, Form::Tables(_))
    }

    /// The way from inks to light, if the values are inks.
    pub(super) fn inks(&self) -> Option<&Inks> {
        match &self.form {
            Form::Inks(inks) => Some(inks),
            _ => None,
        }
    }

    /// Interleaved RGB samples of 16 bits as sRGB, if the profile has tables.
    ///
    /// # Errors
    /// Why the profile cannot be used.
    pub(super) fn table_converted(&self, samples: &[u16]) -> Result<Vec<u16>, String> {
        let Form::Tables(profile) = &self.form else { return Ok(samples.to_vec()) };
        let options = TransformOptions {
            rendering_intent: RenderingIntent::RelativeColorimetric,
            prefer_fixed_point: false,
            ..TransformOptions::default()
        };
        let srgb = ColorProfile::new_srgb();
        let transform = profile
            .create_transform_16bit(Layout::Rgb, &srgb, Layout::Rgb, options)
            .map_err(|error| error.to_string())?;
        let mut converted = vec![0; samples.len()];
        transform.transform(samples, &mut converted).map_err(|error| error.to_string())?;
        Ok(converted)
    }

    /// The light of a value in 0..=1 in a channel, of the file's primaries.
    pub(super) fn light(&self, channel: usize, value: f32) -> f32 {
        match &self.form {
            Form::Matrix(shaper) => shaper.curves[channel].light(value),
            Form::Light => value,
            _ => srgb_to_linear(value),
        }
    }

    /// Brings light of the file's primaries to those of sRGB.
    pub(super) fn bring_to_srgb(&self, image: &mut Image<Linear>) {
        if let Form::Matrix(shaper) = &self.form {
            mixed(image, &shaper.to_srgb);
        }
    }
}

impl Shaper {
    fn is_srgb(&self) -> bool {
        let (of_curve, of_matrix) = SRGB_TOLERANCE;
        let is_close = |curve: &Curve| {
            compared().all(|value| (curve.light(value) - srgb_to_linear(value)).abs() < of_curve)
        };
        let mut elements = self.to_srgb.iter().flatten().zip(IDENTITY.iter().flatten());
        elements.all(|(own, other)| (own - other).abs() < of_matrix)
            && self.curves.iter().all(is_close)
    }
}

/// Values over the whole range.
fn compared() -> impl Iterator<Item = f32> {
    (0..=COMPARED).map(|step| f32::from(step) / f32::from(COMPARED))
}

const IDENTITY: [[f32; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Multiplies the channels of each pixel by a matrix.
pub(super) fn mixed(image: &mut Image<Linear>, matrix: &[[f32; 3]; 3]) {
    if *matrix == IDENTITY {
        return;
    }
    for y in 0..image.height() {
        for x in 0..image.width() {
            let [r, g, b] = image.get(x, y);
            image.set(x, y, matrix.map(|[of_r, of_g, of_b]| of_r * r + of_g * g + of_b * b));
        }
    }
}

fn with_primaries(primaries: ColorPrimaries, white: Chromaticity) -> ColorProfile {
    let mut profile = ColorProfile::default();
    profile.update_rgb_colorimetry(white.to_xyyb(), primaries);
    profile
}

/// The matrix from linear light of a profile's primaries to that of sRGB's.
fn to_srgb(profile: &ColorProfile) -> [[f32; 3]; 3] {
    profile.transform_matrix(&ColorProfile::new_srgb()).v.map(|row| row.map(|v| v as f32))
}

/// A profile's description; of several languages the first.
fn text(description: &ProfileText) -> String {
    let text = match description {
        ProfileText::PlainString(text) => text,
        ProfileText::Localizable(texts) => texts.first().map_or("", |text| &text.value),
        ProfileText::Description(text) if text.ascii_string.is_empty() => &text.unicode_string,
        ProfileText::Description(text) => &text.ascii_string,
    };
    text.trim_matches(|c: char| c.is_whitespace() || c.is_control()).chars().take(60).collect()
}

#[cfg(test)]
mod tests;
