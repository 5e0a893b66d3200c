//! How spans are sent: by the HTTP client, and so the TLS, that the server has anyway.

use std::pin::Pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use opentelemetry_http::{Bytes, HttpClient, HttpError, Request, Response};

/// An answer may take so long, as OpenTelemetry proposes.
const PATIENCE: Duration = Duration::from_secs(10);

/// Bytes of an answer at most: it says how many spans were refused.
const ANSWER: u64 = 1 << 20;

/// A client that says once that its collector is away, until it is back.
#[derive(Debug)]
pub(super) struct Client {
    agent: ureq::Agent,
    is_away: AtomicBool,
}

impl Client {
    pub(super) fn new() -> Self {
        let agent = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .max_redirects(0)
            .timeout_global(Some(PATIENCE))
            .build()
            .new_agent();
        Self {
            agent,
            is_away: AtomicBool::new(false),
        }
    }

    /// Only ever called by the thread of the exporter, which may wait.
    fn send(&self, request: &Request<Bytes>) -> Result<Response<Bytes>, HttpError> {
        let mut sent = Request::builder()
            .method(request.method())
            .uri(request.uri());
        for (name, value) in request.headers() {
            sent = sent.header(name, value);
        }
        let answer = self.agent.run(sent.body(request.body().as_ref())?)?;
        let (head, mut body) = answer.into_parts();
        let body = body.with_config().limit(ANSWER).read_to_vec()?;
        Ok(Response::from_parts(head, Bytes::from(body)))
    }

    fn tell(&self, outcome: &Result<Response<Bytes>, HttpError>) {
        let fault = match outcome {
            Ok(answer) if answer.status().is_success() => {
                self.is_away.store(false, Ordering::Relaxed);
                return;
            }
            Ok(answer) => format!("it answers {}", answer.status()),
            Err(error) => error.to_string(),
        };
        if !self.is_away.swap(true, Ordering::Relaxed) {
            tracing::warn!(
                fault,
                "the collector takes no traces: they are dropped until it does"
            );
        }
    }
}

impl HttpClient for Client {
    fn send_bytes<'life0, 'async_trait>(
        &'life0 self,
        request: Request<Bytes>,
    ) -> Pin<Box<dyn Future<Output = Result<Response<Bytes>, HttpError>> + Send + 'async_trait>>
    where
        'life0: 'async_trait,
        Self: 'async_trait,
    {
        Box::pin(async move {
            let outcome = self.send(&request);
            self.tell(&outcome);
            outcome
        })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::AtomicUsize;

    use tracing::span::{Attributes, Id, Record};
    use tracing::{Event, Level, Metadata, Subscriber};

    use super::*;

    /// Counts what is warned of here.
    struct Counting(Arc<AtomicUsize>);

    impl Subscriber for Counting {
        fn enabled(&self, about: &Metadata<'_>) -> bool {
            *about.level() <= Level::WARN && about.target() == "fled_server::traces::client"
        }

        fn new_span(&self, _: &Attributes<'_>) -> Id {
            Id::from_u64(1)
        }

        fn record(&self, _: &Id, _: &Record<'_>) {}

        fn record_follows_from(&self, _: &Id, _: &Id) {}

        fn event(&self, _: &Event<'_>) {
            self.0.fetch_add(1, Ordering::Relaxed);
        }

        fn enter(&self, _: &Id) {}

        fn exit(&self, _: &Id) {}
    }

    #[test]
    fn a_collector_that_is_away_is_told_of_once_until_it_is_back() {
        let told = Arc::new(AtomicUsize::new(0));
        let count = || told.load(Ordering::Relaxed);
        tracing::subscriber::with_default(Counting(told.clone()), || {
            let client = Client::new();
            let away = || client.tell(&Err("nobody listens".into()));
            away();
            away();
            assert_eq!(count(), 1);
            client.tell(&Ok(Response::new(Bytes::new())));
            assert_eq!(count(), 1);
            away();
            assert_eq!(count(), 2);
        });
    }
}
