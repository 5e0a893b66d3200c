//! Authorisation of requests.
//!
//! As long as no token exists, everyone who reaches the server may do everything; by default it
//! then listens on its own machine only. From the first token on, the whole API needs one.

use std::sync::Arc;

use axum::RequestExt;
use axum::extract::{MatchedPath, RawPathParams, Request, State};
use axum::http::{HeaderMap, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::allowance;
use super::client::ClientAddress;
use super::paths::{EXPORT, EXPORTS, UPLOAD, UPLOADS, VIDEO, VIDEO_FILE, VIDEOS, WEBHOOK, WORKERS};
use super::problem::Problem;
use crate::app::App;
use crate::rate::Client;
use crate::store::{Quotas, Room, TokenRow};
use crate::token::{Scope, digest};

/// Routes open to everyone: whether the server is alive, its description, and the page without its
/// data.
const OPEN: [&str; 10] = [
    "/",
    "/embed",
    "/assets/{*name}",
    "/login",
    "/logout",
    "/livez",
    "/readyz",
    "/openapi.yaml",
    "/openapi.json",
    "/docs",
];
/// Routes that a share link opens: everything that shows its job.
const SHARED: [&str; 12] = [
    "/v1/jobs/{id}",
    "/v1/jobs/{id}/events",
    "/v1/jobs/{id}/live",
    "/v1/jobs/{id}/rounds",
    "/v1/jobs/{id}/render",
    "/v1/jobs/{id}/artifacts",
    "/v1/jobs/{id}/artifacts/{*name}",
    EXPORTS,
    EXPORT,
    VIDEOS,
    VIDEO,
    VIDEO_FILE,
];
/// The cookie that carries a session.
pub(super) const COOKIE: &str = "fled_session";

/// The client of a request and what it may access. Every request to the API has one.
#[derive(Clone, Debug)]
pub(super) struct Visitor {
    owner: Option<String>,
    sees_all: bool,
    quotas: Quotas,
    /// The presented token; `None` if no token is required.
    token: Option<TokenRow>,
}

impl Visitor {
    /// The presented token; `None` if no token is required.
    pub(super) fn token(&self) -> Option<&TokenRow> {
        self.token.as_ref()
    }

    /// The only job they can see, if they presented a share link.
    pub(super) fn only_job(&self) -> Option<&str> {
        self.token()?.job.as_deref()
    }

    /// The owner of their uploads; `None` if no token is required.
    pub(super) fn owner(&self) -> Option<&str> {
        self.owner.as_deref()
    }

    /// The owner whose captures and jobs are all they can see; `None` if they see all.
    pub(super) fn sees_only(&self) -> Option<&str> {
        self.owner().filter(|_| !self.sees_all)
    }

    /// Limits for a new job of theirs, with at most `queue` queued jobs.
    pub(super) fn room(&self, queue: u32) -> Room<'_> {
        Room { queue, of_owner: self.owner().zip(self.quotas.jobs) }
    }

    /// The owner and their limit in bytes for captures and results; `None` for no limit.
    pub(super) fn quota_bytes(&self) -> Option<(&str, u64)> {
        self.owner().zip(self.quotas.bytes)
    }
}

/// A refused request.
struct Refused {
    /// The owner of the presented token, if it is valid.
    owner: Option<String>,
    problem: Problem,
}

impl<T: Into<Problem>> From<T> for Refused {
    fn from(problem: T) -> Self {
        Self { owner: None, problem: problem.into() }
    }
}

/// Lets authorised requests pass, within their rate limit.
pub(super) async fn check(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let path = request.extensions().get::<MatchedPath>().cloned();
    let path = path.as_ref().map(MatchedPath::as_str);
    let needed = needed(path, request.method());
    let cost = allowance::cost(path, request.method());
    if needed.is_none() && allowance::is_reading(request.method()) {
        return next.run(request).await;
    }
    let admission = match needed {
        Some(needed) => admit(&app, request.headers(), needed).await.map(Some),
        None => Ok(None),
    };
    let client = client(&request, &admission);
    let left = client.and_then(|client| app.rates.take(&client, cost));
    let mut answer = match (left.and_then(|left| left.wait), admission) {
        (Some(wait), _) => allowance::used_up(wait),
        (None, Err(refused)) => refused.problem.into_response(),
        (None, Ok(None)) => next.run(request).await,
        (None, Ok(Some(visitor))) => match own(&app, request, visitor).await {
            Ok(request) => next.run(request).await,
            Err(problem) => problem.into_response(),
        },
    };
    if let Some(left) = left {
        allowance::tell(&left, answer.headers_mut());
    }
    answer
}

/// The client that a request counts for; `None` for a user on this machine while no token exists.
fn client(request: &Request, admission: &Result<Option<Visitor>, Refused>) -> Option<Client> {
    let owner = match admission {
        Ok(visitor) => visitor.as_ref().and_then(Visitor::owner),
        Err(refused) => refused.owner.as_deref(),
    };
    if let Some(owner) = owner {
        return Some(Client::Owner(owner.to_owned()));
    }
    let ClientAddress(address) = *request.extensions().get()?;
    match admission {
        Ok(None) => Some(Client::Login(address)),
        Ok(Some(_)) if address.is_loopback() => None,
        _ => Some(Client::Address(address)),
    }
}

/// Adds the visitor to a request, if they may access what it names.
async fn own(app: &App, mut request: Request, visitor: Visitor) -> Result<Request, Problem> {
    let path = request.extensions().get::<MatchedPath>().cloned();
    if let (Some(path), Some(owner)) = (path, visitor.sees_only()) {
        match visitor.only_job() {
            Some(job) => check_shared(&mut request, path.as_str(), job).await?,
            None => check_owner(app, &mut request, path.as_str(), owner).await?,
        }
    }
    request.extensions_mut().insert(visitor);
    Ok(request)
}

/// Checks the owner; what belongs to another owner is reported as not found. This is the only check
/// of paths that name a capture, a job, an upload or a webhook by id.
async fn check_owner(
    app: &App,
    request: &mut Request,
    path: &str,
    owner: &str,
) -> Result<(), Problem> {
    if !path.contains("{id}") {
        return Ok(());
    }
    let kind = match path {
        UPLOAD => "upload",
        path if path.starts_with("/v1/jobs/") => "job",
        path if path.starts_with(WEBHOOK) => "webhook",
        _ => "capture",
    };
    let nothing = || Problem::not_found(kind);
    let id = named(request).await.ok_or_else(nothing)?;
    let owns = match kind {
        "upload" => app.store.owns_upload(owner, &id).await?,
        "job" => app.store.owns_job(owner, &id).await?,
        "webhook" => app.store.owns_webhook(owner, &id).await?,
        _ => app.store.owns_capture(owner, &id).await?,
    };
    if owns { Ok(()) } else { Err(nothing()) }
}

/// Checks that a share link accesses only its own job.
async fn check_shared(request: &mut Request, path: &str, job: &str) -> Result<(), Problem> {
    if !SHARED.contains(&path) {
        let detail = "A share link gives access to its own job only.";
        return Err(Problem::new(StatusCode::FORBIDDEN, "only_one_job", detail));
    }
    let named = named(request).await;
    if named.as_deref() == Some(job) { Ok(()) } else { Err(Problem::not_found("job")) }
}

/// The id in a path, decoded as the handler will decode it.
async fn named(request: &mut Request) -> Option<String> {
    let parts: RawPathParams = request.extract_parts().await.ok()?;
    let id = parts.iter().find(|(name, _)| *name == "id");
    id.map(|(_, id)| id.to_owned())
}

/// The scope that a request needs; `None` if it is open to everyone.
fn needed(path: Option<&str>, method: &Method) -> Option<Scope> {
    // An unknown route has nothing to protect.
    let path = path?;
    if OPEN.contains(&path) {
        return None;
    }
    Some(match (path, method) {
        // The tus protocol's discovery, nothing else.
        (UPLOADS | UPLOAD, &Method::OPTIONS) => return None,
        // To resume an upload a client first asks for its offset.
        (UPLOADS | UPLOAD, _) => Scope::JobsWrite,
        ("/v1/jobs/{id}/render", _) => Scope::Renders,
        // They reveal data of all owners.
        ("/metrics" | WORKERS, _) => Scope::Admin,
        (_, &Method::GET | &Method::HEAD) => Scope::JobsRead,
        _ => Scope::JobsWrite,
    })
}

async fn admit(app: &App, headers: &HeaderMap, needed: Scope) -> Result<Visitor, Refused> {
    if !app.store.has_tokens().await? {
        return Ok(Visitor { owner: None, sees_all: true, quotas: Quotas::default(), token: None });
    }
    let token = token_of(app, headers).await?.ok_or_else(|| {
        if headers.contains_key(header::AUTHORIZATION) || session(headers).is_some() {
            return bad_token();
        }
        unauthorized("no_token", "A token is required.")
            .hint("Send `Authorization: Bearer fled_...`. Create a token with `fled token create`.")
    })?;
    if token.scopes.allow(needed) {
        return Ok(Visitor {
            owner: Some(token.owner().to_owned()),
            sees_all: token.scopes.allow(Scope::Admin),
            quotas: token.quotas,
            token: Some(token),
        });
    }
    let detail = format!("This token lacks the scope `{}`.", needed.name());
    let problem = Problem::new(StatusCode::FORBIDDEN, "missing_scope", detail);
    Err(Refused {
        owner: Some(token.owner().to_owned()),
        problem: problem.hint(format!("Its scopes are: {}.", token.scopes)),
    })
}

/// Returns whether these headers still grant access: a response may outlast its token.
pub(super) async fn holds(app: &App, headers: &HeaderMap) -> Result<bool, Problem> {
    Ok(!app.store.has_tokens().await? || token_of(app, headers).await?.is_some())
}

/// Returns the valid token that a request presents, directly or through its session. A header takes
/// precedence over the cookie.
pub(super) async fn token_of(app: &App, headers: &HeaderMap) -> Result<Option<TokenRow>, Problem> {
    Ok(if headers.contains_key(header::AUTHORIZATION) {
        match bearer(headers) {
            Some(shown) => app.store.token_that_holds(&digest(shown)).await?,
            None => None,
        }
    } else {
        match session(headers) {
            Some(session) => app.store.token_of_session(&digest(session)).await?,
            None => None,
        }
    })
}

/// The session in a browser's cookie.
pub(super) fn session(headers: &HeaderMap) -> Option<&str> {
    let cookies = headers.get_all(header::COOKIE).iter();
    let mut cookies =
        cookies.filter_map(|value| value.to_str().ok()).flat_map(|value| value.split(';'));
    cookies.find_map(|cookie| {
        let (name, value) = cookie.trim().split_once('=')?;
        (name == COOKIE && !value.is_empty()).then_some(value)
    })
}

/// 401: the token or session is not valid.
pub(super) fn bad_token() -> Problem {
    let detail = "This token or session is unknown, revoked or expired.";
    unauthorized("bad_token", detail).hint("Ask the server's administrator for a new token.")
}

/// Returns the bearer token of a request. No other place reads it, and it is never logged.
fn bearer(headers: &HeaderMap) -> Option<&str> {
    let mut values = headers.get_all(header::AUTHORIZATION).iter();
    let value = values.next()?.to_str().ok()?;
    if values.next().is_some() {
        return None;
    }
    let (scheme, token) = value.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then_some(token.trim())
}

fn unauthorized(code: &'static str, detail: &str) -> Problem {
    Problem::new(StatusCode::UNAUTHORIZED, code, detail)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unlisted_routes_need_a_scope() {
        let (get, post) = (&Method::GET, &Method::POST);
        for open in OPEN {
            assert_eq!(needed(Some(open), get), None);
        }
        let job = "/v1/jobs/{id}";
        assert_eq!(needed(Some(job), get), Some(Scope::JobsRead));
        assert_eq!(needed(Some(job), &Method::HEAD), Some(Scope::JobsRead));
        assert_eq!(needed(Some(job), &Method::DELETE), Some(Scope::JobsWrite));
        assert_eq!(needed(Some(job), &Method::PATCH), Some(Scope::JobsWrite));
        assert_eq!(needed(Some(job), &Method::OPTIONS), Some(Scope::JobsWrite));
        let render = "/v1/jobs/{id}/render";
        assert_eq!(needed(Some(render), get), Some(Scope::Renders));
        assert_eq!(needed(Some(render), post), Some(Scope::Renders));
        let artifact = "/v1/jobs/{id}/artifacts/{*name}";
        assert_eq!(needed(Some(artifact), get), Some(Scope::JobsRead));
        for uploads in [UPLOADS, UPLOAD] {
            assert_eq!(needed(Some(uploads), &Method::OPTIONS), None);
            for method in [&Method::HEAD, get, post, &Method::PATCH, &Method::DELETE] {
                assert_eq!(needed(Some(uploads), method), Some(Scope::JobsWrite));
            }
        }
        assert_eq!(needed(Some(VIDEOS), get), Some(Scope::JobsRead));
        assert_eq!(needed(Some(VIDEOS), post), Some(Scope::JobsWrite));
        assert_eq!(needed(Some("/metrics"), get), Some(Scope::Admin));
        assert_eq!(needed(Some("/of/tomorrow"), get), Some(Scope::JobsRead));
    }

    #[test]
    fn only_one_bearer_token_is_read() {
        let of = |values: &[&str]| {
            let mut headers = HeaderMap::new();
            for value in values {
                headers.append(header::AUTHORIZATION, value.parse().expect("header"));
            }
            bearer(&headers).map(str::to_owned)
        };
        assert_eq!(of(&["Bearer fled_1"]).as_deref(), Some("fled_1"));
        assert_eq!(of(&["bearer  fled_1"]).as_deref(), Some("fled_1"));
        assert_eq!(of(&["Bearer fled_1", "Bearer fled_2"]), None);
        assert_eq!(of(&["Basic fled_1"]), None);
        assert_eq!(of(&["fled_1"]), None);
        assert_eq!(of(&[]), None);
    }

    #[test]
    fn the_session_is_found_among_other_cookies() {
        let of = |value: &str| {
            let mut headers = HeaderMap::new();
            headers.append(header::COOKIE, value.parse().expect("header"));
            session(&headers).map(str::to_owned)
        };
        assert_eq!(of("a=b; fled_session=fled_1; c=d").as_deref(), Some("fled_1"));
        assert_eq!(of("fled_session="), None);
        assert_eq!(of("xfled_session=1; fled_sessions=2"), None);
    }
}
