//! `/login` and `/logout`: a browser's session in place of a token.
//!
//! A page cannot store a token out of reach of scripts, and event streams and images send no
//! header. So the token is presented once and replaced by a cookie that no script can read.

use std::sync::Arc;

use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::access::{bad_token, session, token_of};
use super::extract::Json;
use super::problem::Problem;
use crate::app::App;
use crate::token::{Secret, digest};

/// How long a session lasts, in seconds.
const LASTS: i64 = 7 * 24 * 3600;

/// A token to start a session with.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Login {
    /// Token that begins with `fled_`.
    token: String,
}

/// The session of a browser.
#[derive(Debug, Serialize, ToSchema)]
pub struct Session {
    /// Whether the API requires a token.
    needed: bool,
    /// Scopes of this browser's token, separated by commas; `null` without a valid session.
    scopes: Option<String>,
    /// The only visible job, if the session comes from a link.
    job: Option<String>,
}

/// Reports whether a token is required and whether this browser has a session.
pub async fn show(
    State(app): State<Arc<App>>,
    headers: HeaderMap,
) -> Result<axum::Json<Session>, Problem> {
    let needed = app.store.has_tokens().await?;
    let token = token_of(&app, &headers).await?;
    let (scopes, job) = token.map(|token| (token.scopes.to_string(), token.job)).unzip();
    let job = job.flatten();
    Ok(axum::Json(Session { needed, scopes, job }))
}

/// Starts a session with a token.
///
/// The session cookie replaces the token for up to a week.
pub async fn login(
    State(app): State<Arc<App>>,
    headers: HeaderMap,
    Json(body): Json<Login>,
) -> Result<Response, Problem> {
    let token = app.store.token_that_holds(&digest(body.token.trim())).await?;
    let token = token.ok_or_else(bad_token)?;
    let secret = Secret::new().map_err(|error| {
        tracing::error!(%error, "cannot start a session");
        Problem::internal()
    })?;
    // A new login leaves no old session behind.
    end(&app, &headers).await?;
    let ends = app.store.now().await? + LASTS * 1000;
    app.store.insert_session(&secret.digest(), &token.id, ends).await?;
    Ok(answer(&headers, secret.reveal(), LASTS))
}

/// Ends the session.
pub async fn logout(State(app): State<Arc<App>>, headers: HeaderMap) -> Result<Response, Problem> {
    end(&app, &headers).await?;
    Ok(answer(&headers, "", 0))
}

async fn end(app: &App, headers: &HeaderMap) -> Result<(), Problem> {
    if let Some(session) = session(headers) {
        app.store.end_session(&digest(session)).await?;
    }
    Ok(())
}

/// 204 with the session cookie.
fn answer(headers: &HeaderMap, session: &str, seconds: i64) -> Response {
    // Only a proxy knows whether the browser uses TLS; one that lies harms only itself.
    let is_tls =
        headers.get("x-forwarded-proto").is_some_and(|scheme| scheme.as_bytes() == b"https");
    let secure = if is_tls { "; Secure" } else { "" };
    let name = super::access::COOKIE;
    // Without a path it is sent to what lies beside `/login`, below a proxy's path, too, and to no
    // other service of that proxy.
    let cookie = format!("{name}={session}; HttpOnly; SameSite=Strict; Max-Age={seconds}{secure}");
    match HeaderValue::try_from(cookie) {
        Ok(cookie) => (StatusCode::NO_CONTENT, [(header::SET_COOKIE, cookie)]).into_response(),
        Err(_) => Problem::internal().into_response(),
    }
}
