//! The header fields of tus 1.0.0.

use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use jiff::Timestamp;
use jiff::fmt::rfc2822::DateTimePrinter;

use crate::http::problem::Problem;

/// The only supported version.
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

/// The media type of a piece.
const PIECE: &str = "application/offset+octet-stream";
const HINT: &str = "See the tus protocol, version 1.0.0, and /openapi.yaml.";
/// Maximum length of a file that can be stored.
const MOST: u64 = i64::MAX as u64;

/// A header field as text, if present.
///
/// # Errors
/// 400 if it is repeated or is not text.
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

/// A header field that is a number of bytes.
///
/// # Errors
/// 400 if it is missing or is not a number.
pub(super) fn number(headers: &HeaderMap, name: &HeaderName) -> Result<u64, Problem> {
    let text = text(headers, name)?;
    let digits = text.filter(|text| text.bytes().all(|byte| byte.is_ascii_digit()));
    let number = digits.and_then(|digits| digits.parse().ok());
    number
        .filter(|number| *number <= MOST)
        .ok_or_else(|| bad(format!("`{name}` is missing or is not a number of bytes.")))
}

/// Returns whether the body has the media type of a piece.
pub(super) fn is_piece(headers: &HeaderMap) -> bool {
    let kind = headers.get(header::CONTENT_TYPE);
    kind.is_some_and(|kind| kind.as_bytes().eq_ignore_ascii_case(PIECE.as_bytes()))
}

/// 415: the body is not a piece.
pub(super) fn other_type() -> Problem {
    Problem::new(
        StatusCode::UNSUPPORTED_MEDIA_TYPE,
        "unsupported_media_type",
        "The body is not a piece of an upload.",
    )
    .hint(format!("Send `Content-Type: {PIECE}`."))
}

/// 400 for a header field that cannot be read.
pub(super) fn bad(detail: impl Into<String>) -> Problem {
    Problem::new(StatusCode::BAD_REQUEST, "bad_request", detail).hint(HINT)
}

/// 422 for a readable header field with an unusable value.
pub(super) fn unfit(detail: impl Into<String>) -> Problem {
    Problem::unprocessable("bad_input", detail).hint(HINT)
}

/// An HTTP date.
pub(super) fn expires(at_ms: i64) -> String {
    let at = Timestamp::from_millisecond(at_ms).unwrap_or(Timestamp::MAX);
    let printer = DateTimePrinter::new();
    printer
        .timestamp_to_rfc9110_string(&at)
        // Only years outside any clock's range cannot be formatted.
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_has_only_digits_and_is_sent_once() {
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
    fn times_are_written_as_http_dates() {
        assert_eq!(expires(784_111_777_999), "Sun, 06 Nov 1994 08:49:37 GMT");
    }
}
