//! The dashboard: plain embedded files, without external resources.
//!
//! A page consists of some fifty small modules. They are sent compressed, and a browser that has
//! them revalidates by their tags: reopening a page transfers no file again, and a page of another
//! build is never shown with old scripts.

use std::borrow::Cow;
use std::collections::HashMap;
use std::io::Write;
use std::sync::LazyLock;

use axum::extract::Path;
use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use flate2::Compression;
use flate2::write::GzEncoder;
use rust_embed::RustEmbed;

use super::problem::Problem;
use super::sent::is_known;

#[derive(RustEmbed)]
#[folder = "../../web"]
#[include = "*.html"]
#[include = "*.css"]
#[include = "*.js"]
#[include = "*.svg"]
#[include = "*.webp"]
struct Web;

/// A file, plain and compressed.
struct Asset {
    plain: Cow<'static, [u8]>,
    gzipped: Vec<u8>,
    /// Digest of its content, in hexadecimal.
    digest: String,
}

/// All files, by name.
static ASSETS: LazyLock<HashMap<String, Asset>> = LazyLock::new(|| {
    let asset = |name: Cow<'static, str>| {
        let file = Web::get(&name)?;
        let asset = Asset {
            gzipped: gzipped(&file.data),
            digest: blake3::hash(&file.data).to_hex()[..32].to_owned(),
            plain: file.data,
        };
        Some((name.into_owned(), asset))
    };
    Web::iter().filter_map(asset).collect()
});

/// The page, which decides by itself what to show.
pub async fn index(headers: HeaderMap) -> Response {
    file("index.html", &headers)
}

/// Its styles and scripts.
pub async fn asset(Path(name): Path<String>, headers: HeaderMap) -> Response {
    file(&name, &headers)
}

fn file(name: &str, headers: &HeaderMap) -> Response {
    let Some(asset) = ASSETS.get(name) else {
        return Problem::not_found("file").into_response();
    };
    let is_gzipped = takes_gzip(headers);
    // The two forms of a file need different tags.
    let form = if is_gzipped { "gzip" } else { "plain" };
    let etag = format!("\"{}-{form}\"", asset.digest);
    let common: [(HeaderName, &str); 3] = [
        (header::CONTENT_TYPE, media_type(name)),
        (header::VARY, "Accept-Encoding"),
        (header::ETAG, &etag),
    ];
    if is_known(headers, &etag) {
        return (StatusCode::NOT_MODIFIED, common).into_response();
    }
    if is_gzipped {
        let encoding = [(header::CONTENT_ENCODING, "gzip")];
        return (common, encoding, asset.gzipped.as_slice()).into_response();
    }
    (common, &*asset.plain).into_response()
}

fn media_type(name: &str) -> &'static str {
    match name.rsplit_once('.').map(|(_, extension)| extension) {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("webp") => "image/webp",
        _ => "image/svg+xml",
    }
}

/// Returns whether a client accepts gzip with a non-zero weight.
fn takes_gzip(headers: &HeaderMap) -> bool {
    let accepted = headers.get_all(header::ACCEPT_ENCODING).iter();
    let words = accepted.filter_map(|value| value.to_str().ok());
    words.flat_map(|words| words.split(',')).any(|word| {
        let (coding, weight) = word.split_once(';').unwrap_or((word, ""));
        let is_refused = weight
            .trim()
            .strip_prefix("q=")
            .is_some_and(|weight| weight.trim().parse::<f32>().is_ok_and(|weight| weight == 0.0));
        coding.trim().eq_ignore_ascii_case("gzip") && !is_refused
    })
}

fn gzipped(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes).and_then(|()| encoder.finish()).expect("memory takes every byte")
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use axum::http::HeaderValue;
    use flate2::read::GzDecoder;

    use super::*;

    fn accepting(words: &'static str) -> HeaderMap {
        HeaderMap::from_iter([(header::ACCEPT_ENCODING, HeaderValue::from_static(words))])
    }

    #[test]
    fn gzip_keeps_every_file_and_halves_their_size() {
        for asset in ASSETS.values() {
            let mut read = Vec::new();
            GzDecoder::new(asset.gzipped.as_slice()).read_to_end(&mut read).expect("gzip");
            assert!(read == *asset.plain);
        }
        let texts = || ASSETS.iter().filter(|(name, _)| !name.ends_with(".webp"));
        let sum = |size: fn(&Asset) -> usize| texts().map(|(_, asset)| size(asset)).sum::<usize>();
        let (plain, gzipped) = (sum(|a| a.plain.len()), sum(|a| a.gzipped.len()));
        assert!(gzipped * 5 < plain * 2, "{gzipped} of {plain} bytes");
    }

    #[test]
    fn gzip_is_sent_only_to_clients_that_accept_it() {
        for taken in ["gzip", "br, GZIP;q=0.5", "deflate,gzip; q=1"] {
            assert!(takes_gzip(&accepting(taken)), "{taken}");
        }
        for refused in ["", "br", "gzip;q=0", "gzip; q=0.0", "xgzip"] {
            assert!(!takes_gzip(&accepting(refused)), "{refused}");
        }
        assert!(!takes_gzip(&HeaderMap::new()));
    }

    #[test]
    fn a_cached_file_is_revalidated_by_form() {
        let gzip = file("main.js", &accepting("gzip"));
        assert_eq!(gzip.headers()[header::CONTENT_ENCODING], "gzip");
        let etag = gzip.headers()[header::ETAG].clone();
        let mut again = accepting("gzip");
        again.insert(header::IF_NONE_MATCH, etag.clone());
        let known = file("main.js", &again);
        assert_eq!(known.status(), StatusCode::NOT_MODIFIED);
        assert_eq!(known.headers()[header::ETAG], etag);
        again.remove(header::ACCEPT_ENCODING);
        assert_eq!(file("main.js", &again).status(), StatusCode::OK);
        assert_eq!(file("nothing.js", &again).status(), StatusCode::NOT_FOUND);
    }
}
