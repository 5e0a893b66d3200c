//! The HTTP API, version 1, and the dashboard.

#![allow(unused_qualifications, reason = "the code that utoipa's attributes write has them")]

mod access;
mod allowance;
mod artifacts;
mod below;
mod captures;
mod change;
mod client;
mod connections;
mod dashboard;
mod events;
mod exports;
mod extract;
mod fetch;
mod health;
mod host;
mod jobs;
mod live;
mod log;
mod login;
mod lookup;
mod metrics;
mod openapi;
mod options;
mod order;
mod page;
mod paths;
mod photographs;
mod pin;
mod prioritize;
mod priority;
mod problem;
mod quota;
mod range;
mod render;
mod retry;
mod room;
mod rounds;
mod sample;
mod sent;
mod shapes;
mod share;
mod texts;
mod tus;
mod upload;
mod uploaded;
mod videos;
mod webhooks;
mod workers;

use std::any::Any;
use std::sync::Arc;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::{Extensions, HeaderMap, HeaderName, HeaderValue, StatusCode, Version, header};
use axum::middleware;
use axum::response::{IntoResponse, Response};
use axum::routing::{delete, get, head, post, put};
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::csrf::{CsrfLayer, ProtectionError};
use tower_http::request_id::{MakeRequestUuid, PropagateRequestIdLayer, SetRequestIdLayer};
use tower_http::set_header::SetResponseHeaderLayer;
use tower_http::trace::TraceLayer;

use crate::app::App;
use paths::{
    EXPORT, EXPORTS, UPLOAD, UPLOADS, VIDEO, VIDEO_FILE, VIDEOS, WEBHOOK, WEBHOOKS, WORKERS,
};

pub use connections::serve as serve_connections;
pub use openapi::document;
pub use problem::Problem;
#[doc(hidden)]
pub use tus::read_headers as read_tus_headers;

/// Maximum bytes of a body that is not an upload.
const SMALL: usize = 1 << 20;

/// Only the server's own content may run or be shown; no other page may frame it, but for
/// [`dashboard::embedded`].
const CONTENT_SECURITY_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; \
    img-src 'self' blob:; media-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Every route.
pub fn router(app: Arc<App>) -> Router {
    let small = Router::new()
        .route("/v1/captures/sample", post(sample::create))
        .route("/v1/captures/{id}", get(captures::show).delete(captures::delete))
        .route("/v1/captures/{id}/thumbnails/{*name}", get(photographs::thumbnail))
        .route("/v1/captures/{id}/photographs/{*name}", get(photographs::original))
        .merge(of_a_job())
        .merge(of_webhooks())
        .route("/v1/options", get(options::show))
        .route("/login", get(login::show).post(login::login))
        .route("/logout", post(login::logout))
        .route("/livez", get(health::live))
        .route("/metrics", get(metrics::show))
        .route(WORKERS, get(workers::list))
        .route("/readyz", get(health::ready))
        .route("/openapi.yaml", get(openapi::show))
        .route("/openapi.json", get(openapi::show_json))
        .route("/docs", get(openapi::docs))
        .route("/", get(dashboard::index))
        .route("/embed", get(dashboard::embedded))
        .route("/assets/{*name}", get(dashboard::asset))
        .layer(DefaultBodyLimit::max(SMALL));
    let header = |name: HeaderName, value: &'static str| {
        SetResponseHeaderLayer::if_not_present(name, HeaderValue::from_static(value))
    };
    uploads()
        .merge(small)
        .fallback(dashboard::missing)
        .method_not_allowed_fallback(async || {
            Problem::new(
                StatusCode::METHOD_NOT_ALLOWED,
                "method_not_allowed",
                "This endpoint does not support this method.",
            )
        })
        .layer(middleware::from_fn_with_state(app.clone(), fetch::bring))
        .layer(middleware::from_fn_with_state(app.clone(), access::check))
        .layer(middleware::from_fn(texts::check_path))
        // Another site's page must not start or delete jobs through a visitor's browser.
        .layer(CsrfLayer::new().with_rejection_response(from_elsewhere))
        .layer(middleware::from_fn_with_state(app.clone(), host::check))
        .layer(CatchPanicLayer::custom(panicked))
        .layer(middleware::from_fn(tus::mark))
        .layer(middleware::from_fn(below::relate))
        .layer(header(header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY))
        .layer(header(header::X_CONTENT_TYPE_OPTIONS, "nosniff"))
        .layer(header(header::REFERRER_POLICY, "no-referrer"))
        .layer(header(header::CACHE_CONTROL, "no-cache"))
        .layer(CompressionLayer::new().compress_when(is_text))
        .layer(TraceLayer::new_for_http())
        .layer(middleware::from_fn_with_state(app.clone(), metrics::count))
        .layer(PropagateRequestIdLayer::x_request_id())
        .layer(SetRequestIdLayer::x_request_id(MakeRequestUuid))
        .with_state(app)
}

/// Every route below a job.
fn of_a_job() -> Router<Arc<App>> {
    Router::new()
        .route("/v1/jobs/{id}", get(jobs::show).patch(change::change).delete(jobs::delete))
        .route("/v1/jobs/{id}/cancel", post(jobs::cancel))
        .route("/v1/jobs/{id}/retry", post(retry::retry))
        .route("/v1/jobs/{id}/priority", put(prioritize::prioritize))
        .route("/v1/jobs/{id}/pin", put(pin::pin).delete(pin::unpin))
        .route("/v1/jobs/{id}/shares", get(share::list).post(share::create))
        .route("/v1/jobs/{id}/shares/{share}", delete(share::end))
        .route("/v1/jobs/{id}/events", get(events::stream))
        .route("/v1/jobs/{id}/rounds", get(rounds::show))
        .route("/v1/jobs/{id}/live", get(live::show))
        .route("/v1/jobs/{id}/log", get(log::show))
        .route("/v1/jobs/{id}/render", get(render::get).post(render::post))
        .route("/v1/jobs/{id}/artifacts", get(artifacts::list))
        .route("/v1/jobs/{id}/artifacts/{*name}", get(artifacts::download))
        .route(EXPORTS, get(exports::list))
        .route(EXPORT, get(exports::download))
        .route(VIDEOS, get(videos::list).post(videos::create))
        .route(VIDEO, get(videos::show).delete(videos::delete))
        .route(VIDEO_FILE, get(videos::download))
}

/// Every route of webhooks.
fn of_webhooks() -> Router<Arc<App>> {
    Router::new()
        .route(WEBHOOKS, get(webhooks::list).post(webhooks::create))
        .route(WEBHOOK, delete(webhooks::delete))
        .route("/v1/webhooks/{id}/test", post(webhooks::test))
        .route("/v1/webhooks/{id}/deliveries", get(webhooks::deliveries))
        .route("/v1/webhooks/{id}/deliveries/{delivery}/redeliver", post(webhooks::redeliver))
}

/// Routes that take bodies of any size: the largest upload is checked while it streams; no handler
/// buffers it.
fn uploads() -> Router<Arc<App>> {
    let pieces = Router::new()
        .route(UPLOADS, post(tus::create).options(tus::options))
        .route(
            UPLOAD,
            head(tus::head)
                .patch(tus::patch)
                .delete(tus::delete)
                .post(tus::by_override)
                .options(tus::options_of_one),
        )
        .route_layer(middleware::from_fn(tus::check_version));
    Router::new()
        .route("/v1/captures", get(captures::list).post(captures::create))
        .route("/v1/jobs", get(jobs::list).post(jobs::create))
        .merge(pieces)
        .layer(DefaultBodyLimit::disable())
}

/// Whether an answer is worth compressing: text that no client asks for in ranges.
fn is_text(_: StatusCode, _: Version, headers: &HeaderMap, _: &Extensions) -> bool {
    const TEXTS: [&str; 4] = ["json", "text/", "yaml", "svg"];
    let kind = headers.get(header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or("");
    let is_text = TEXTS.iter().any(|text| kind.contains(text)) && kind != "text/event-stream";
    is_text && !headers.contains_key(header::ACCEPT_RANGES)
}

fn from_elsewhere(_: ProtectionError) -> Response {
    Problem::new(StatusCode::FORBIDDEN, "cross_origin", "A page of another site sent this request.")
        .hint("Use the dashboard of this server, or a program with a token.")
        .into_response()
}

#[expect(clippy::needless_pass_by_value, reason = "the layer hands it over so")]
fn panicked(fault: Box<dyn Any + Send + 'static>) -> Response {
    let text = fault.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| fault.downcast_ref::<&str>().copied()).unwrap_or("no message");
    tracing::error!(text, "a handler panicked");
    Problem::internal().into_response()
}
