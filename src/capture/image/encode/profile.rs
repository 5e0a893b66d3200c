//! The ICC profiles of the files that fled writes.

use moxcms::{CmsError, ColorProfile, LocalizableString, ProfileText, ToneReprCurve};

/// sRGB.
///
/// # Errors
/// That of the library, which no input of the user causes.
pub(super) fn srgb() -> Result<Vec<u8>, CmsError> {
    without_code_points(ColorProfile::new_srgb()).encode()
}

/// Linear light of sRGB's primaries.
///
/// # Errors
/// As [`srgb`].
pub(super) fn linear_srgb() -> Result<Vec<u8>, CmsError> {
    let mut profile = without_code_points(ColorProfile::new_srgb());
    let identity = || Some(ToneReprCurve::Lut(Vec::new()));
    profile.red_trc = identity();
    profile.green_trc = identity();
    profile.blue_trc = identity();
    let name = LocalizableString::new("en".to_owned(), "US".to_owned(), "linear sRGB".to_owned());
    profile.description = Some(ProfileText::Localizable(vec![name]));
    profile.encode()
}

/// The library's code points say that the values are of video's narrow range.
fn without_code_points(mut profile: ColorProfile) -> ColorProfile {
    profile.cicp = None;
    profile
}
