//! The one form of `Range` that clients use: a single range of bytes (RFC 9110, 14).

use axum::http::{HeaderMap, header};

/// The requested part of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// Everything.
    All,
    /// `length` bytes from `start` on, at least one.
    Part {
        /// First byte.
        start: u64,
        /// Number of bytes.
        length: u64,
    },
    /// A range beyond the end.
    Impossible,
}

/// Parses `Range` and `If-Range` for a file of `size` bytes. Anything unsupported, including
/// several ranges, yields the whole file, as the standard allows.
pub fn wanted(headers: &HeaderMap, size: u64, etag: &str) -> Wanted {
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
    // The client has part of another version: send the whole new one.
    if text(header::IF_RANGE).is_some_and(|tag| tag != etag) {
        return Wanted::All;
    }
    let Some((first, last)) = text(header::RANGE)
        .and_then(|range| range.strip_prefix("bytes="))
        .and_then(|range| range.split_once('-'))
    else {
        return Wanted::All;
    };
    let number = |text: &str| text.trim().parse::<u64>().ok();
    let (start, end) = match (first.trim().is_empty(), last.trim().is_empty()) {
        (true, false) => match number(last) {
            Some(tail) => (size.saturating_sub(tail), size),
            None => return Wanted::All,
        },
        (false, is_open) => match (number(first), number(last)) {
            (Some(start), _) if is_open => (start, size),
            (Some(start), Some(last)) if last >= start => (start, last.saturating_add(1).min(size)),
            _ => return Wanted::All,
        },
        (true, true) => return Wanted::All,
    };
    if start >= end { Wanted::Impossible } else { Wanted::Part { start, length: end - start } }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(range: &str) -> Wanted {
        let mut headers = HeaderMap::new();
        headers.insert(header::RANGE, range.parse().expect("header"));
        wanted(&headers, 100, "\"t\"")
    }

    #[test]
    fn ranges_are_clipped_and_unsupported_ones_ignored() {
        assert_eq!(of("bytes=0-9"), Wanted::Part { start: 0, length: 10 });
        assert_eq!(of("bytes=90-"), Wanted::Part { start: 90, length: 10 });
        assert_eq!(of("bytes=90-500"), Wanted::Part { start: 90, length: 10 });
        assert_eq!(of("bytes=-30"), Wanted::Part { start: 70, length: 30 });
        assert_eq!(of("bytes=-500"), Wanted::Part { start: 0, length: 100 });
        assert_eq!(of("bytes=100-"), Wanted::Impossible);
        assert_eq!(of("bytes=-0"), Wanted::Impossible);
        for odd in ["bytes=5-2", "bytes=0-1,5-6", "lines=1-2", "bytes=-", "bytes=a-b"] {
            assert_eq!(of(odd), Wanted::All, "{odd}");
        }
    }

    #[test]
    fn an_outdated_range_gets_the_whole_new_file() {
        let mut headers = HeaderMap::new();
        headers.insert(header::RANGE, "bytes=0-9".parse().expect("header"));
        headers.insert(header::IF_RANGE, "\"old\"".parse().expect("header"));
        assert_eq!(wanted(&headers, 100, "\"new\""), Wanted::All);
        assert_eq!(wanted(&headers, 100, "\"old\""), Wanted::Part { start: 0, length: 10 });
    }
}
