//! `/v1/webhooks`: notifications of jobs.

use std::fmt::Display;
use std::sync::Arc;

use axum::extract::{Extension, Path, State};
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use super::access::Visitor;
use super::extract::Json;
use super::problem::Problem;
use super::shapes::time;
use crate::app::App;
use crate::store::{DeliveryRow, TokenRow, WebhookRow};
use crate::token::{Scope, new_id};
use crate::webhooks::egress::check_url;
use crate::webhooks::{Secret, TYPES, USUAL, secret_text};

/// Maximum webhooks of an owner.
const MOST: u32 = 20;
/// Maximum deliveries in a list.
const LISTED: u32 = 100;

/// A webhook to create.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewWebhook {
    /// Address to notify: `https://` or `http://`.
    #[schema(max_length = 2000)]
    url: String,
    /// Types of events: `job.queued`, `job.running`, `job.succeeded`, `job.failed`,
    /// `job.cancelled`, `round.finished`. All but the first two by default.
    types: Option<Vec<String>>,
}

/// An address that is notified of jobs.
#[derive(Debug, Serialize, ToSchema)]
pub struct Webhook {
    /// Public name.
    id: String,
    /// Address that is notified.
    url: String,
    /// Types of events.
    types: Vec<String>,
    /// Time of creation, RFC 3339.
    created_at: String,
    /// Time at which the endpoint answered 410 and deliveries stopped, RFC 3339.
    gone_at: Option<String>,
}

/// A new webhook with its secret, which is returned only once.
#[derive(Debug, Serialize, ToSchema)]
pub struct MadeWebhook {
    #[serde(flatten)]
    webhook: Webhook,
    /// Secret that signs its deliveries, as in Standard Webhooks: `whsec_` and base64.
    secret: String,
}

/// The webhooks of an owner.
#[derive(Debug, Serialize, ToSchema)]
pub struct Webhooks {
    /// The webhooks, oldest first.
    webhooks: Vec<Webhook>,
}

/// A delivery to a webhook.
#[derive(Debug, Serialize, ToSchema)]
pub struct Delivery {
    /// `webhook-id`, the same in every attempt.
    id: String,
    /// Type of the event.
    r#type: String,
    /// Body that is sent.
    #[schema(value_type = Object)]
    body: Value,
    /// Time of the event, RFC 3339.
    created_at: String,
    /// Number of attempts so far.
    attempts: u32,
    /// Time of the next attempt; absent once it has arrived or was given up.
    #[serde(skip_serializing_if = "Option::is_none")]
    next_at: Option<String>,
    /// Time of arrival.
    #[serde(skip_serializing_if = "Option::is_none")]
    delivered_at: Option<String>,
    /// Outcome of the last attempt: a status, or why there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    answer: Option<String>,
}

/// The latest deliveries of a webhook.
#[derive(Debug, Serialize, ToSchema)]
pub struct Deliveries {
    /// At most 100 deliveries, newest first.
    deliveries: Vec<Delivery>,
}

/// A queued delivery.
#[derive(Debug, Serialize, ToSchema)]
pub struct OnItsWay {
    /// `webhook-id` of the delivery.
    id: String,
}

/// Creates a webhook that is notified of the owner's jobs, as in Standard Webhooks 1.0.
#[utoipa::path(post, path = "/v1/webhooks", operation_id = "create_webhook",
    tag = "webhooks", request_body = NewWebhook,
    responses(
        (status = 201, description = "The webhook; its secret is returned only this once", body = MadeWebhook, headers(("Location" = String))),
        (status = 409, description = "The limit of webhooks is reached", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "Invalid URL or unknown event type", body = Problem, content_type = "application/problem+json")))]
pub async fn create(
    State(app): State<Arc<App>>,
    Extension(visitor): Extension<Visitor>,
    Json(new): Json<NewWebhook>,
) -> Result<impl IntoResponse, Problem> {
    let types = types(&new)?;
    // Notifications reveal what `jobs:read` protects.
    let reads = |token: &TokenRow| token.scopes.allow(Scope::JobsRead);
    if !visitor.token().is_none_or(reads) {
        let detail = "This token lacks the scope `jobs:read`.";
        return Err(Problem::new(StatusCode::FORBIDDEN, "missing_scope", detail));
    }
    check_url(&new.url, app.config.inner_webhooks).map_err(|reason| {
        Problem::unprocessable("bad_url", format!("The URL cannot be used: {reason}."))
            .pointer("/url")
    })?;
    let secret = Secret::new().map_err(|error| unmade(&error))?;
    let row = WebhookRow {
        id: new_id().map_err(|error| unmade(&error))?,
        url: new.url,
        secret: secret.0,
        types,
        owner: visitor.owner().map(str::to_owned),
        sees_all: visitor.sees_only().is_none(),
        made_by: visitor.token().map(|token| token.id.clone()),
        created_at: app.store.now().await?,
        gone_at: None,
    };
    if !app.store.insert_webhook(&row, MOST).await? {
        let detail = format!("You already have {MOST} webhooks.");
        return Err(Problem::conflict("too_many_webhooks", detail)
            .hint("Delete webhooks that are no longer needed."));
    }
    let location = format!("/v1/webhooks/{}", row.id);
    let made = MadeWebhook { secret: secret_text(&row.secret), webhook: shown(row) };
    let answer = [(header::LOCATION, location)];
    Ok((StatusCode::CREATED, answer, axum::Json(made)))
}

fn unmade(error: &dyn Display) -> Problem {
    tracing::error!(%error, "cannot create a webhook");
    Problem::internal()
}

fn types(new: &NewWebhook) -> Result<Vec<String>, Problem> {
    let Some(types) = &new.types else {
        return Ok(USUAL.map(str::to_owned).to_vec());
    };
    let unknown = types.iter().position(|one| !TYPES.contains(&one.as_str()));
    match unknown {
        Some(at) => {
            let detail = "There is no event of this type.";
            Err(Problem::unprocessable("bad_type", detail)
                .pointer(format!("/types/{at}"))
                .hint(format!("Known types are {}.", TYPES.join(", "))))
        }
        None if types.is_empty() => {
            let detail = "`types` is empty.";
            Err(Problem::unprocessable("bad_type", detail).pointer("/types"))
        }
        None => Ok(types.clone()),
    }
}

/// Lists webhooks.
///
/// Their secrets are not returned.
#[utoipa::path(get, path = "/v1/webhooks", operation_id = "list_webhooks", tag = "webhooks",
    responses((status = 200, description = "The webhooks, oldest first", body = Webhooks)))]
pub async fn list(
    State(app): State<Arc<App>>,
    Extension(visitor): Extension<Visitor>,
) -> Result<axum::Json<Webhooks>, Problem> {
    let rows = app.store.webhooks(visitor.sees_only()).await?;
    let webhooks = rows.into_iter().map(shown).collect();
    Ok(axum::Json(Webhooks { webhooks }))
}

/// Deletes a webhook and its deliveries.
#[utoipa::path(delete, path = "/v1/webhooks/{id}", operation_id = "delete_webhook",
    tag = "webhooks", params(("id" = String, Path)),
    responses(
        (status = 204, description = "Deleted"),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json")))]
pub async fn delete(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    find(&app, &id).await?;
    app.store.delete_webhook(&id).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Sends a test event to a webhook.
#[utoipa::path(post, path = "/v1/webhooks/{id}/test", operation_id = "test_webhook",
    tag = "webhooks", params(("id" = String, Path)),
    responses(
        (status = 202, description = "The delivery is queued", body = OnItsWay),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The endpoint has answered 410, or a test is already queued", body = Problem, content_type = "application/problem+json")))]
pub async fn test(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<impl IntoResponse, Problem> {
    let row = find(&app, &id).await?;
    check_not_gone(&row)?;
    let id = app.store.test_webhook(&row.id).await?;
    let id = id.ok_or_else(|| {
        Problem::conflict("on_its_way", "A test of this webhook is already on its way.")
    })?;
    Ok((StatusCode::ACCEPTED, axum::Json(OnItsWay { id })))
}

/// Lists the latest deliveries of a webhook and their outcome.
#[utoipa::path(get, path = "/v1/webhooks/{id}/deliveries", operation_id = "list_deliveries",
    tag = "webhooks", params(("id" = String, Path)),
    responses(
        (status = 200, description = "At most 100 deliveries, newest first", body = Deliveries),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json")))]
pub async fn deliveries(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<axum::Json<Deliveries>, Problem> {
    let row = find(&app, &id).await?;
    let rows = app.store.deliveries(&row.id, LISTED).await?;
    let deliveries = rows.into_iter().map(delivery).collect();
    Ok(axum::Json(Deliveries { deliveries }))
}

/// Sends a delivery again, whether or not it arrived, with the full number of attempts.
#[utoipa::path(post, path = "/v1/webhooks/{id}/deliveries/{delivery}/redeliver",
    operation_id = "redeliver",
    tag = "webhooks", params(("id" = String, Path), ("delivery" = String, Path)),
    responses(
        (status = 202, description = "The delivery is queued", body = OnItsWay),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The endpoint has answered 410", body = Problem, content_type = "application/problem+json")))]
pub async fn redeliver(
    State(app): State<Arc<App>>,
    Path((id, delivery)): Path<(String, String)>,
) -> Result<impl IntoResponse, Problem> {
    let row = find(&app, &id).await?;
    check_not_gone(&row)?;
    if !app.store.redeliver(&row.id, &delivery).await? {
        return Err(Problem::not_found("delivery"));
    }
    Ok((StatusCode::ACCEPTED, axum::Json(OnItsWay { id: delivery })))
}

async fn find(app: &App, id: &str) -> Result<WebhookRow, Problem> {
    let row = app.store.webhook(id).await?;
    row.ok_or_else(|| Problem::not_found("webhook"))
}

fn check_not_gone(row: &WebhookRow) -> Result<(), Problem> {
    if row.gone_at.is_none() {
        return Ok(());
    }
    let detail = "The endpoint has answered 410 Gone.";
    Err(Problem::conflict("gone", detail).hint("Delete the webhook and create it again."))
}

fn shown(row: WebhookRow) -> Webhook {
    Webhook {
        id: row.id,
        url: row.url,
        types: row.types,
        created_at: time(row.created_at),
        gone_at: row.gone_at.map(time),
    }
}

fn delivery(row: DeliveryRow) -> Delivery {
    Delivery {
        id: row.id,
        r#type: row.kind,
        body: serde_json::from_str(&row.body).unwrap_or_default(),
        created_at: time(row.created_at),
        attempts: row.attempts,
        next_at: row.next_at.map(time),
        delivered_at: row.delivered_at.map(time),
        answer: row.answer,
    }
}
