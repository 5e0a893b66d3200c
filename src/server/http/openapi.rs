//! `/openapi.yaml`: generated from the handlers, checked in, compared by a test.

use axum::http::header;
use axum::response::IntoResponse;
use utoipa::OpenApi;

use super::{artifacts, captures, events, health, jobs, log, options, render, rounds};

#[derive(OpenApi)]
#[openapi(
    info(
        title = "fled",
        description = "From dark, noisy, shaken photographs of a place to a bright, sharp 3D scene.",
        license(name = "MIT OR Apache-2.0")
    ),
    paths(
        captures::create,
        captures::list,
        captures::show,
        captures::delete,
        jobs::create,
        jobs::list,
        jobs::show,
        jobs::cancel,
        jobs::retry,
        jobs::delete,
        events::stream,
        rounds::show,
        log::show,
        render::get,
        render::post,
        artifacts::list,
        artifacts::download,
        options::show,
        health::live,
        health::ready,
        show
    )
)]
struct Api;

/// The description of the API.
///
/// # Panics
/// Never: the document is made of plain data.
pub fn document() -> String {
    Api::openapi()
        .to_yaml()
        .expect("plain data can be written as YAML")
}

/// This document.
#[utoipa::path(get, path = "/openapi.yaml", tag = "health",
    responses((status = 200, description = "OpenAPI 3.1", body = String, content_type = "application/yaml")))]
pub async fn show() -> impl IntoResponse {
    ([(header::CONTENT_TYPE, "application/yaml")], document())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// `FLED_WRITE_OPENAPI=1 cargo test --release -p fled-server openapi` writes the file.
    #[test]
    fn the_checked_in_description_is_that_of_the_handlers() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../openapi.yaml");
        if std::env::var_os("FLED_WRITE_OPENAPI").is_some() {
            std::fs::write(&path, document()).expect("write");
        }
        let checked_in = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(
            checked_in == document(),
            "openapi.yaml is out of date: FLED_WRITE_OPENAPI=1 cargo test --release -p fled-server openapi"
        );
    }
}
