//! The dashboard: plain embedded files, without external resources.
//!
//! A page consists of some fifty small modules. Their addresses contain the build, so that a
//! browser can cache them permanently and never combines a page with the scripts of another build.
//! The page lists all modules that it needs at once, and those that each of its parts needs when
//! opened, so that a browser does not discover them one after another.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::LazyLock;

use axum::extract::Path;
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use rust_embed::RustEmbed;

use super::CONTENT_SECURITY_POLICY;
use super::below::top;
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

/// A file.
struct Asset {
    content: Cow<'static, [u8]>,
    etag: String,
}

/// All files, by name.
static ASSETS: LazyLock<HashMap<String, Asset>> = LazyLock::new(|| {
    let asset = |name: Cow<'static, str>| {
        let mut content = Web::get(&name)?.data;
        if let Some(page_name) = name.strip_suffix(".html") {
            let script = if page_name == "index" { "main.js" } else { &format!("{page_name}.js") };
            content = page(&String::from_utf8_lossy(&content), script).into_bytes().into();
        }
        let digest = blake3::hash(&content).to_hex();
        // Weak, because it is sent compressed, too.
        let asset = Asset { etag: format!("W/\"{}\"", &digest[..32]), content };
        Some((name.into_owned(), asset))
    };
    Web::iter().filter_map(asset).collect()
});

/// The digest of all files: the part of their addresses that changes with each build.
static BUILD: LazyLock<String> = LazyLock::new(|| {
    let names: BTreeSet<_> = Web::iter().collect();
    let mut hasher = blake3::Hasher::new();
    for name in names {
        let file = Web::get(&name).map(|file| file.data).unwrap_or_default();
        hasher.update(name.as_bytes()).update(&[0]).update(blake3::hash(&file).as_bytes());
    }
    hasher.finalize().to_hex()[..16].to_owned()
});

/// A page with the addresses of this build, links to all modules that its `script` imports, and
/// inactive links to those that it may import later, which name the module they are for.
fn page(html: &str, script: &str) -> String {
    let base = format!("assets/{}/", *BUILD);
    let modules = imported(script);
    let first = modules.iter().map(|name| format!("rel=\"modulepreload\" href=\"{base}{name}\""));
    let mut later: BTreeMap<String, Vec<String>> = BTreeMap::new();
    let parts: BTreeSet<String> = modules.iter().flat_map(|name| imported_later(name)).collect();
    for part in parts {
        for name in imported(&part).into_iter().filter(|name| !modules.contains(name)) {
            later.entry(name).or_default().push(part.clone());
        }
    }
    let later = later
        .iter()
        .map(|(name, of)| format!("data-of=\"{}\" href=\"{base}{name}\"", of.join(" ")));
    let links: String = first.chain(later).map(|link| format!("<link {link}>\n")).collect();
    html.replace("assets/", &base).replace("</head>", &format!("{links}</head>"))
}

/// What the module `script` imports on demand.
fn imported_later(script: &str) -> BTreeSet<String> {
    let text = Web::get(script).map(|file| file.data).unwrap_or_default();
    let text = String::from_utf8_lossy(&text);
    let paths = text.split("import(\"./").skip(1).filter_map(|rest| rest.split_once('"'));
    paths.map(|(path, _)| beside(script, path)).collect()
}

/// The module `name` and all that it imports statically, directly or indirectly.
fn imported(name: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut waiting = vec![name.to_owned()];
    while let Some(name) = waiting.pop() {
        let Some(file) = Web::get(&name).filter(|_| !found.contains(&name)) else { continue };
        let text = String::from_utf8_lossy(&file.data);
        for rest in text.split(" from \"").skip(1) {
            if let Some((path, _)) = rest.split_once('"') {
                waiting.push(beside(&name, path));
            }
        }
        found.insert(name);
    }
    found
}

/// Resolves the relative `path` from the file `name`.
fn beside(name: &str, path: &str) -> String {
    let mut parts: Vec<_> = name.split('/').collect();
    parts.pop();
    for part in path.split('/') {
        match part {
            "." => {}
            ".." => drop(parts.pop()),
            _ => parts.push(part),
        }
    }
    parts.join("/")
}

/// The page, which decides what to show.
pub async fn index(headers: HeaderMap) -> Response {
    file("index.html", &headers)
}

/// The scene of one job alone. Any page may embed it in a frame: it shows what its address allows
/// and has no controls that change anything.
pub async fn embedded(headers: HeaderMap) -> Response {
    let policy = CONTENT_SECURITY_POLICY.replace("frame-ancestors 'none'", "frame-ancestors *");
    ([(header::CONTENT_SECURITY_POLICY, policy)], file("embed.html", &headers)).into_response()
}

/// Where there is nothing: a page for people's browsers, a problem document for programs.
pub async fn missing(uri: Uri, headers: HeaderMap) -> Response {
    let accepted = headers.get(header::ACCEPT).and_then(|kinds| kinds.to_str().ok());
    let is_shown = accepted.is_some_and(|kinds| kinds.contains("text/html"));
    let Some(page) = ASSETS.get("missing.html").filter(|_| is_shown) else {
        return Problem::not_found("page")
            .hint(
                "`openapi.yaml` beside the dashboard lists every address. A proxy that serves this \
                 server below a path must remove that path.",
            )
            .into_response();
    };
    let top = top(uri.path());
    let page = String::from_utf8_lossy(&page.content);
    let page = page.replace("\"assets/", &format!("\"{top}assets/"));
    let page = page.replace("href=\"./\"", &format!("href=\"{top}\""));
    let kind = [(header::CONTENT_TYPE, media_type("missing.html"))];
    (StatusCode::NOT_FOUND, kind, page).into_response()
}

/// Styles and scripts, by name or below the address of a build. A page of another build, still open
/// or sent by another replica, gets the files of this one, but only files of this build are cached
/// permanently.
pub async fn asset(Path(name): Path<String>, headers: HeaderMap) -> Response {
    let is_build = |part: &str| part.len() == 16 && part.bytes().all(|b| b.is_ascii_hexdigit());
    match name.split_once('/') {
        Some((build, name)) if is_build(build) => {
            let cache = [(header::CACHE_CONTROL, "public, max-age=31536000, immutable")];
            let response = file(name, &headers);
            let is_kept = build == *BUILD && response.status() != StatusCode::NOT_FOUND;
            if is_kept { (cache, response).into_response() } else { response }
        }
        _ => file(&name, &headers),
    }
}

fn file(name: &str, headers: &HeaderMap) -> Response {
    let Some(asset) = ASSETS.get(name) else {
        return Problem::not_found("file").into_response();
    };
    let common = [(header::CONTENT_TYPE, media_type(name)), (header::ETAG, &asset.etag)];
    if is_known(headers, &asset.etag) {
        return (StatusCode::NOT_MODIFIED, common).into_response();
    }
    (common, &*asset.content).into_response()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_names_all_its_modules_by_this_build() {
        let page = String::from_utf8_lossy(&ASSETS["index.html"].content);
        let base = format!("assets/{}/", *BUILD);
        assert_eq!(page.matches("assets/").count(), page.matches(&base).count());
        let modules = imported("main.js");
        assert!(modules.contains("lib/dom.js"), "imported by main.js and by others");
        for name in &modules {
            let link = format!("<link rel=\"modulepreload\" href=\"{base}{name}\">");
            assert_eq!(page.matches(&link).count(), 1, "{name}");
            assert!(ASSETS.contains_key(name), "{name}");
        }
        let named = |of: &str, name: &str| {
            page.contains(&format!("<link data-of=\"{of}\" href=\"{base}{name}\">"))
        };
        assert!(named("job/job.js", "job/views.js"), "{page}");
        assert!(named("pages/gallery.js", "pages/gallery.js"), "imported by pages/layout.js");
        assert!(named("compare/compare.js job/job.js", "lib/split.js"), "{page}");
        assert!(!page.contains("scene/view.js"), "loaded once a scene is opened");
    }

    #[test]
    fn every_address_holds_below_the_path_of_a_proxy() {
        const PLACES: [&str; 7] =
            ["v1/", "assets/", "login", "logout", "livez", "readyz", "openapi."];
        for name in Web::iter().filter(|name| name.ends_with(".js") || name.ends_with(".html")) {
            let text = Web::get(&name).expect("a file").data;
            let text = String::from_utf8_lossy(&text);
            for place in PLACES {
                for quote in ['"', '\'', '`'] {
                    let absolute = format!("{quote}/{place}");
                    let is_comment = |line: &str| line.trim_start().starts_with(['/', '*']);
                    let found =
                        text.lines().find(|line| line.contains(&absolute) && !is_comment(line));
                    assert_eq!(found, None, "{name}: leave out the first slash");
                }
            }
        }
    }

    #[tokio::test]
    async fn a_missing_page_is_for_people_only() {
        let page = async |path: &'static str, accept: &'static str| {
            let headers = HeaderMap::from_iter([(header::ACCEPT, accept.parse().expect("header"))]);
            missing(Uri::from_static(path), headers).await
        };
        let is_html = |answer: &Response| {
            assert_eq!(answer.status(), StatusCode::NOT_FOUND);
            answer.headers()[header::CONTENT_TYPE] == "text/html; charset=utf-8"
        };
        assert!(is_html(&page("/a/b", "text/html,application/xhtml+xml,*/*;q=0.8").await));
        assert!(!is_html(&page("/a/b", "*/*").await));
    }

    #[tokio::test]
    async fn only_files_of_this_build_are_kept_for_good() {
        let kept = async |name: String| {
            let response = asset(Path(name), HeaderMap::new()).await;
            (response.status(), response.headers().contains_key(header::CACHE_CONTROL))
        };
        assert_eq!(kept(format!("{}/lib/dom.js", *BUILD)).await, (StatusCode::OK, true));
        assert_eq!(kept("lib/dom.js".to_owned()).await, (StatusCode::OK, false));
        assert_eq!(kept("0123456789abcdef/lib/dom.js".to_owned()).await, (StatusCode::OK, false));
        let missing = (StatusCode::NOT_FOUND, false);
        assert_eq!(kept(format!("{}/nothing.js", *BUILD)).await, missing);
    }

    #[test]
    fn a_known_file_is_not_sent_again() {
        let first = file("main.js", &HeaderMap::new());
        let etag = first.headers()[header::ETAG].clone();
        let again = HeaderMap::from_iter([(header::IF_NONE_MATCH, etag.clone())]);
        let known = file("main.js", &again);
        assert_eq!(known.status(), StatusCode::NOT_MODIFIED);
        assert_eq!(known.headers()[header::ETAG], etag);
        assert_eq!(file("style.css", &again).status(), StatusCode::OK);
        assert_eq!(file("nothing.js", &again).status(), StatusCode::NOT_FOUND);
    }
}
