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
mod meshes;
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
use axum::routing::{get, post};
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::csrf::{CsrfLayer, ProtectionError};
use tower_http::request_id::{MakeRequestUuid, PropagateRequestIdLayer, SetRequestIdLayer};
use tower_http::set_header::SetResponseHeaderLayer;
use tower_http::trace::TraceLayer;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::app::App;
use paths::UPLOAD;

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

/// Every route, with its layers.
pub fn router(app: Arc<App>) -> Router {
    let header = |name: HeaderName, value: &'static str| {
        SetResponseHeaderLayer::if_not_present(name, HeaderValue::from_static(value))
    };
    Router::from(routes())
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

/// Every route; those of the API with their description.
fn routes() -> OpenApiRouter<Arc<App>> {
    let small = OpenApiRouter::default()
        .routes(routes!(sample::create))
        .routes(routes!(captures::show, captures::delete))
        .routes(routes!(photographs::thumbnail))
        .routes(routes!(photographs::original))
        .merge(of_a_job())
        .merge(of_webhooks())
        .routes(routes!(options::show))
        .routes(routes!(health::live))
        .routes(routes!(health::ready))
        .routes(routes!(metrics::show))
        .routes(routes!(workers::list))
        .routes(routes!(openapi::show))
        .routes(routes!(openapi::show_json))
        .route("/login", get(login::show).post(login::login))
        .route("/logout", post(login::logout))
        .route("/docs", get(openapi::docs))
        .route("/", get(dashboard::index))
        .route("/embed", get(dashboard::embedded))
        .route("/assets/{*name}", get(dashboard::asset))
        .layer(DefaultBodyLimit::max(SMALL));
    uploads().merge(small)
}

/// Every route below a job.
fn of_a_job() -> OpenApiRouter<Arc<App>> {
    OpenApiRouter::default()
        .routes(routes!(jobs::show, change::change, jobs::delete))
        .routes(routes!(jobs::cancel))
        .routes(routes!(retry::retry))
        .routes(routes!(prioritize::prioritize))
        .routes(routes!(pin::pin, pin::unpin))
        .routes(routes!(share::list, share::create))
        .routes(routes!(share::end))
        .routes(routes!(events::stream))
        .routes(routes!(rounds::show))
        .routes(routes!(live::show))
        .routes(routes!(log::show))
        .routes(routes!(render::get, render::post))
        .routes(routes!(artifacts::list))
        .routes(routes!(artifacts::download))
        .routes(routes!(exports::list))
        .routes(routes!(exports::download))
        .routes(routes!(videos::list, videos::create))
        .routes(routes!(videos::show, videos::delete))
        .routes(routes!(videos::download))
}

/// Every route of webhooks.
fn of_webhooks() -> OpenApiRouter<Arc<App>> {
    OpenApiRouter::default()
        .routes(routes!(webhooks::list, webhooks::create))
        .routes(routes!(webhooks::delete))
        .routes(routes!(webhooks::test))
        .routes(routes!(webhooks::deliveries))
        .routes(routes!(webhooks::redeliver))
}

/// Routes that take bodies of any size: the largest upload is checked while it streams; no handler
/// buffers it.
fn uploads() -> OpenApiRouter<Arc<App>> {
    let pieces = OpenApiRouter::default()
        .routes(routes!(tus::create, tus::options))
        .routes(routes!(tus::head, tus::patch, tus::delete, tus::options_of_one))
        .route(UPLOAD, post(tus::by_override))
        .route_layer(middleware::from_fn(tus::check_version));
    OpenApiRouter::default()
        .routes(routes!(captures::list, captures::create))
        .routes(routes!(jobs::list, jobs::create))
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
