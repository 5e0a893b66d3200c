//! `/v1/jobs/{id}/shares`: links that give their holder access to one job.

use std::sync::Arc;

use axum::extract::{Extension, Path, State};
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::access::Visitor;
use super::extract::Json;
use super::lookup::find;
use super::problem::Problem;
use super::shapes::time;
use crate::app::App;
use crate::store::{NewShare, ShareRow, TokenRow};
use crate::token::{Scope, Secret, new_id};

/// Scopes of a share link: to see the job and render novel views.
const SCOPES: &str = "jobs:read,renders";
/// Default validity of a link, in days.
const DAYS: u16 = 30;
/// Maximum validity of a link, in days.
const MOST_DAYS: u16 = 365;
/// Maximum valid links of a job.
const MOST: u32 = 100;
/// Maximum length of a name, in characters.
const NAME: usize = 100;
const DAY_MS: i64 = 24 * 3600 * 1000;

/// A link to create.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewLink {
    /// Label that tells the link apart.
    #[serde(default)]
    #[schema(max_length = 100)]
    name: String,
    /// Validity, days.
    #[serde(default = "days")]
    #[schema(minimum = 1, maximum = 365, default = 30)]
    days: u16,
}

fn days() -> u16 {
    DAYS
}

/// A valid link.
#[derive(Debug, Serialize, ToSchema)]
pub struct Share {
    /// Public name, used to revoke it.
    id: String,
    /// Label that tells the link apart.
    name: String,
    /// Time of creation, RFC 3339.
    created_at: String,
    /// End of its validity, RFC 3339.
    expires_at: String,
    /// Time of the last use, to the minute, RFC 3339.
    last_used_at: Option<String>,
}

/// A new link with its token, which is returned only once.
#[derive(Debug, Serialize, ToSchema)]
pub struct MadeShare {
    #[serde(flatten)]
    share: Share,
    /// Token that opens only this job. The server keeps only its SHA-256.
    token: String,
    /// Dashboard page of the job for holders of the link, relative to the server's address.
    path: String,
}

/// The valid links of a job.
#[derive(Debug, Serialize, ToSchema)]
pub struct Shares {
    /// The links, newest first.
    shares: Vec<Share>,
}

/// Creates a link that opens this job to anyone who has it.
///
/// The link gives access to the job's page, pictures, files and novel views, and to nothing else.
#[utoipa::path(post, path = "/v1/jobs/{id}/shares", operation_id = "share_job",
    tag = "jobs", params(("id" = String, Path)),
    request_body = NewLink,
    responses(
        (status = 201, description = "The link; its token is returned only this once", body = MadeShare, headers(("Location" = String))),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The server requires no tokens, or the job's limit of links is reached", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "Invalid number of days, or the name is too long", body = Problem, content_type = "application/problem+json")))]
pub async fn create(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    Extension(visitor): Extension<Visitor>,
    Json(new): Json<NewLink>,
) -> Result<impl IntoResponse, Problem> {
    let maker = maker(&visitor)?;
    check(&new)?;
    let job = find(&app, &id).await?;
    let no_randomness = |error| {
        tracing::error!(%error, "cannot create a link");
        Problem::internal()
    };
    let secret = Secret::new().map_err(no_randomness)?;
    let now = app.store.now().await?;
    let ends = now + i64::from(new.days) * DAY_MS;
    let share = NewShare {
        id: new_id().map_err(no_randomness)?,
        name: new.name,
        digest: secret.digest(),
        job: job.id.clone(),
        made_by: maker.id.clone(),
        scopes: SCOPES,
        // A link expires no later than the token that created it.
        expires_at: maker.expires_at.map_or(ends, |end| ends.min(end)),
    };
    if !app.store.insert_share(&share, MOST).await? {
        let detail = format!("This job already has {MOST} valid links.");
        return Err(Problem::conflict("too_many_shares", detail)
            .hint("Revoke links that are no longer needed."));
    }
    let made = MadeShare {
        path: format!("/#/share/{}/{}", job.id, secret.reveal()),
        token: secret.reveal().to_owned(),
        share: Share {
            id: share.id,
            name: share.name,
            created_at: time(now),
            expires_at: time(share.expires_at),
            last_used_at: None,
        },
    };
    let location = format!("/v1/jobs/{}/shares/{}", job.id, made.share.id);
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], axum::Json(made)))
}

/// Lists the valid links of a job.
///
/// Their tokens are not returned.
#[utoipa::path(get, path = "/v1/jobs/{id}/shares", operation_id = "list_shares",
    tag = "jobs", params(("id" = String, Path)),
    responses(
        (status = 200, description = "The links, newest first", body = Shares),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json")))]
pub async fn list(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<axum::Json<Shares>, Problem> {
    let job = find(&app, &id).await?;
    let shares = app.store.shares(&job.id).await?;
    let shares = shares.into_iter().map(shown).collect();
    Ok(axum::Json(Shares { shares }))
}

/// Revokes a link.
///
/// Pages that were opened with it lose access within seconds.
#[utoipa::path(delete, path = "/v1/jobs/{id}/shares/{share}", operation_id = "end_share",
    tag = "jobs", params(("id" = String, Path), ("share" = String, Path)),
    responses(
        (status = 204, description = "Revoked"),
        (status = 404, description = "Not found, or already revoked", body = Problem, content_type = "application/problem+json")))]
pub async fn end(
    State(app): State<Arc<App>>,
    Path((id, share)): Path<(String, String)>,
) -> Result<StatusCode, Problem> {
    if app.store.end_share(&id, &share).await? {
        Ok(StatusCode::NO_CONTENT)
    } else {
        Err(Problem::not_found("link"))
    }
}

/// The token that creates a link. It must have every scope that it grants.
fn maker(visitor: &Visitor) -> Result<&TokenRow, Problem> {
    let Some(token) = visitor.token() else {
        let detail =
            "This server requires no tokens, so the job's address already works as a link.";
        return Err(Problem::conflict("no_tokens", detail)
            .hint("Create a first token with `fled token create` to use links."));
    };
    for scope in [Scope::JobsRead, Scope::Renders] {
        if !token.scopes.allow(scope) {
            let detail = format!("This token lacks the scope `{}`.", scope.name());
            return Err(Problem::new(StatusCode::FORBIDDEN, "missing_scope", detail)
                .hint(format!("A link has the scopes {SCOPES}, so your token needs both.")));
        }
    }
    Ok(token)
}

fn check(new: &NewLink) -> Result<(), Problem> {
    if !(1..=MOST_DAYS).contains(&new.days) {
        let detail = format!("A link is valid for 1 to {MOST_DAYS} days.");
        return Err(Problem::unprocessable("bad_days", detail).pointer("/days"));
    }
    if new.name.chars().count() > NAME {
        let detail = format!("A link's name has at most {NAME} characters.");
        return Err(Problem::unprocessable("bad_name", detail).pointer("/name"));
    }
    Ok(())
}

fn shown(row: ShareRow) -> Share {
    Share {
        id: row.id,
        name: row.name,
        created_at: time(row.created_at),
        expires_at: time(row.expires_at),
        last_used_at: row.last_used_at.map(time),
    }
}
