//! `/v1/jobs/{id}/events`: server-sent events read from the database.
//!
//! A change wakes a stream, which asks for the events after the last one it sent; one read of the
//! database serves all streams of a job (`store/feed.rs`). So no event is lost, repeated or out of
//! order, even if the client reconnects or the server restarts.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderName, StatusCode};
use axum::response::sse::{Event, KeepAlive};
use axum::response::{IntoResponse, Response, Sse};
use futures::Stream;
use serde::Deserialize;
use tokio::sync::watch;
use utoipa::{IntoParams, ToSchema};

use super::access;
use super::extract::Query;
use super::lookup::find;
use super::problem::Problem;
use crate::app::App;
use crate::store::{EventFeed, EventRow};

/// How long a stream may outlast the validity of its token.
const ACCESS_CHECK: Duration = Duration::from_secs(5);

/// nginx passes each event on at once if this is `no`; otherwise it collects them.
const BUFFERING: HeaderName = HeaderName::from_static("x-accel-buffering");

/// From where to stream.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct StreamQuery {
    /// Same as the header `Last-Event-ID`, for clients that cannot set it.
    #[param(minimum = 0)]
    after: Option<i64>,
}

/// An event of the stream.
#[derive(ToSchema)]
#[expect(dead_code, reason = "it describes what is written field by field")]
pub struct StreamEvent {
    /// Number, from 1.
    id: String,
    /// Type: `state`, `planned`, `stage_started` and so on.
    event: String,
    /// A JSON object.
    data: String,
}

/// Streams the events of a job.
///
/// Their types are `state`, `planned`, `detail_chosen` (what `detail=auto` became),
/// `stage_started`, `strategy_started` (the search for poses tries another way), `overlap_found`
/// (too few poses, and not all photographs clearly show the same things), `stage_finished`,
/// `progress`, `training_seen`, `held_out_seen`, `view_seen`, `round_finished` and `warning`. The
/// stream ends with the job; 204 means that no more events will come.
#[utoipa::path(get, path = "/v1/jobs/{id}/events", operation_id = "stream_events", tag = "jobs",
    params(("id" = String, Path), StreamQuery,
        ("Last-Event-ID" = Option<i64>, Header, minimum = 0, description = "Number of the last event received; the stream continues after it")),
    responses(
        (status = 200, description = "Events, each with its number as `id`", body = StreamEvent, content_type = "text/event-stream"),
        (status = 204, description = "The job has ended and every event was sent"),
        (status = 404, description = "Not found", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "No event of this job has the number", body = Problem, content_type = "application/problem+json")))]
pub async fn stream(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    Query(query): Query<StreamQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    // Watch before the first read, or a change between the two would be missed.
    let versions = app.store.changes();
    let job = find(&app, &id).await?;
    let last = match headers.get("last-event-id") {
        Some(value) => value.to_str().ok().and_then(|text| text.trim().parse().ok()),
        None => Some(query.after.unwrap_or(0)),
    };
    // An invalid number is rejected in either place.
    let last = last.filter(|_| query.after.is_none_or(|after| after >= 0));
    let last = known(&app, &id, last).await?;
    if job.state.is_terminal() && app.store.events_after(&id, last, 1).await?.is_empty() {
        // The only status after which a browser does not reconnect.
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let cursor = Cursor {
        feed: app.store.feed(&id),
        app,
        last,
        versions,
        batch: Vec::new().into_iter(),
        headers,
        checked: Instant::now(),
    };
    let keep_alive = KeepAlive::new().interval(Duration::from_secs(15));
    let stream = Sse::new(cursor.into_stream()).keep_alive(keep_alive);
    Ok(([(BUFFERING, "no")], stream).into_response())
}

/// Checks that `last` is the number of an event of the job; 0 is before the first.
async fn known(app: &App, id: &str, last: Option<i64>) -> Result<i64, Problem> {
    if last == Some(0) {
        return Ok(0);
    }
    if let Some(last) = last.filter(|&last| last > 0)
        && app.store.events_after(id, last - 1, 1).await?.iter().any(|event| event.seq == last)
    {
        return Ok(last);
    }
    Err(Problem::unprocessable("bad_input", "`Last-Event-ID` does not name an event of this job.")
        .hint("Leave it out to receive every event."))
}

struct Cursor {
    app: Arc<App>,
    feed: Arc<EventFeed>,
    last: i64,
    versions: watch::Receiver<u64>,
    batch: std::vec::IntoIter<Arc<EventRow>>,
    /// The headers that authorised the client, and when they were last checked.
    headers: HeaderMap,
    checked: Instant,
}

impl Cursor {
    fn into_stream(self) -> impl Stream<Item = Result<Event, Infallible>> {
        futures::stream::unfold(self, async |mut cursor| {
            let row = cursor.next().await?;
            let event = Event::default()
                .id(row.seq.to_string())
                .event(&row.kind)
                .data(row.data.to_string());
            Some((Ok(event), cursor))
        })
    }

    /// Returns the next event; `None` when the job is over or gone, the token is no longer valid,
    /// or the server stops.
    async fn next(&mut self) -> Option<Arc<EventRow>> {
        loop {
            if let Some(row) = self.batch.next() {
                self.last = row.seq;
                return Some(row);
            }
            if self.checked.elapsed() >= ACCESS_CHECK {
                if !access::holds(&self.app, &self.headers).await.ok()? {
                    return None;
                }
                self.checked = Instant::now();
            }
            let version = *self.versions.borrow_and_update();
            let next = self.feed.after(&self.app.store, self.last, version);
            let next = next.await.ok()?;
            let until_check = ACCESS_CHECK.saturating_sub(self.checked.elapsed());
            if next.events.is_empty() {
                if next.is_all {
                    return None;
                }
                tokio::select! {
                    changed = self.versions.changed() => changed.ok()?,
                    () = tokio::time::sleep(until_check) => {}
                    () = self.app.shutdown.cancelled() => return None,
                }
            }
            self.batch = next.events.into_iter();
        }
    }
}
