//! The header fields of tus 1.0.0.

use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use jiff::Timestamp;
use jiff::fmt::rfc2822::DateTimePrinter;

use crate::http::problem::Problem;

/// The one version that is spoken.
pub(super) const VERSION: &str = "1.0.0";
pub(super) const RESUMABLE: HeaderName = HeaderName::from_static("tus-resumable");
pub(super) const VERSIONS: HeaderName = HeaderName::from_static("tus-version");
pub(super) const EXTENSION: HeaderName = HeaderName::from_static("tus-extension");
pub(super) const MAX_SIZE: HeaderName = HeaderName::from_static("tus-max-size");
pub(super) const LENGTH: HeaderName = HeaderName::from_static("upload-length");
pub(super) const DEFER_LENGTH: HeaderName = HeaderName::from_static("upload-defer-length");
pub(super) const CONCAT: HeaderName = HeaderName::from_static("upload-concat");
pub(super) const OFFSET: HeaderName = HeaderName::from_static("upload-offset");
pub(super) const METADATA: HeaderName = HeaderName::from_static("upload-metadata");
pub(super) const EXPIRES: HeaderName = HeaderName::from_static("upload-expires");
pub(super) const METHOD_OVERRIDE: HeaderName = HeaderName::from_static("x-http-method-override");

/// The type of a body that is a piece.
const PIECE: &str = "application/offset+octet-stream";
const HINT: &str = "See the tus protocol, version 1.0.0, and /openapi.yaml.";
/// Longer files are counted by nobody.
const MOST: u64 = i64::MAX as u64;

/// A field as text, if it is there.
///
/// # Errors
/// 400 where it is sent twice or is no text.
pub(super) fn text<'a>(
    headers: &'a HeaderMap,
    name: &HeaderName,
) -> Result<Option<&'a str>, Problem> {
    let mut values = headers.get_all(name).iter();
    let Some(value) = values.next() else {
        return Ok(None);
    };
    match value.to_str() {
        Ok(text) if values.next().is_none() => Ok(Some(text)),
        _ => Err(bad(format!("`{name}` is sent twice or is not ASCII."))),
    }
}

/// A field that counts bytes.
///
/// # Errors
/// 400 where it is not there or is no number.
pub(super) fn number(headers: &HeaderMap, name: &HeaderName) -> Result<u64, Problem> {
    let text = text(headers, name)?;
    let digits = text.filter(|text| text.bytes().all(|byte| byte.is_ascii_digit()));
    let number = digits.and_then(|digits| digits.parse().ok());
    number
        .filter(|number| *number <= MOST)
        .ok_or_else(|| bad(format!("`{name}` is missing or is not a number of bytes.")))
}

/// Whether the body says that it is a piece.
pub(super) fn is_piece(headers: &HeaderMap) -> bool {
    let kind = headers.get(header::CONTENT_TYPE);
    kind.is_some_and(|kind| kind.as_bytes().eq_ignore_ascii_case(PIECE.as_bytes()))
}

/// 415: the body is no piece.
pub(super) fn other_type() -> Problem {
    Problem::new(
        StatusCode::UNSUPPORTED_MEDIA_TYPE,
        "unsupported_media_type",
        "The body is not a piece of an upload.",
    )
    .hint(format!("Send `Content-Type: {PIECE}`."))
}

/// 400 for a field that cannot be read.
pub(super) fn bad(detail: impl Into<String>) -> Problem {
    Problem::new(StatusCode::BAD_REQUEST, "bad_request", detail).hint(HINT)
}

/// 422 for a field that can be read, but not used.
pub(super) fn unfit(detail: impl Into<String>) -> Problem {
    Problem::unprocessable("bad_input", detail).hint(HINT)
}

/// A time as HTTP writes it.
pub(super) fn expires(at_ms: i64) -> String {
    let at = Timestamp::from_millisecond(at_ms).unwrap_or(Timestamp::MAX);
    let printer = DateTimePrinter::new();
    printer
        .timestamp_to_rfc9110_string(&at)
        // Only years that no clock tells cannot be written.
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_has_digits_only_and_stands_once() {
        let of = |values: &[&str]| {
            let mut headers = HeaderMap::new();
            for value in values {
                headers.append(OFFSET, value.parse().expect("header"));
            }
            number(&headers, &OFFSET).ok()
        };
        assert_eq!(of(&["0"]), Some(0));
        assert_eq!(of(&["9223372036854775807"]), Some(MOST));
        for wrong in
            [&["-1"][..], &["+1"], &[""], &["1.0"], &["9223372036854775808"], &["1", "1"], &[]]
        {
            assert_eq!(of(wrong), None, "{wrong:?}");
        }
    }

    #[test]
    fn times_are_told_as_http_tells_them() {
        assert_eq!(expires(784_111_777_999), "Sun, 06 Nov 1994 08:49:37 GMT");
    }
}
