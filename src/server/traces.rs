//! Spans of requests, attempts and stages, for OpenTelemetry: sent by OTLP over HTTP to the
//! collector that the usual variables name. Where they name none there is no exporter and no
//! thread.
//!
//! What is not sent: paths, names, and the words of faults, which may hold either.

mod client;
mod job;
mod parent;

use std::time::Duration;

use opentelemetry::context::FutureExt;
use opentelemetry::trace::{SpanKind, Status, TraceContextExt, Tracer, TracerProvider};
use opentelemetry::{Context, Key, KeyValue};
use opentelemetry_otlp::{Protocol, SpanExporter, WithExportConfig, WithHttpConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::trace::{SdkTracer, SdkTracerProvider};

use crate::error::{Result, ServerError};
use client::Client;

pub use job::AttemptTrace;
pub use parent::current;

/// Where spans are sent; the second is for them alone.
const ENDPOINTS: [&str; 2] = [
    "OTEL_EXPORTER_OTLP_ENDPOINT",
    "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT",
];

/// How they are sent, likewise.
const PROTOCOLS: [&str; 2] = [
    "OTEL_EXPORTER_OTLP_PROTOCOL",
    "OTEL_EXPORTER_OTLP_TRACES_PROTOCOL",
];

/// What the service is called where nobody calls it otherwise.
const NAME: &str = "fled";

/// What was not sent yet gets so long when the server stops.
const FAREWELL: Duration = Duration::from_secs(2);

/// Who makes spans, if anybody does.
#[derive(Clone, Debug, Default)]
pub struct Traces {
    made: Option<(SdkTracerProvider, SdkTracer)>,
}

/// A request that is answered.
#[derive(Debug)]
pub struct RequestTrace(Context);

impl Traces {
    /// As the variables of OpenTelemetry ask for.
    ///
    /// # Errors
    /// [`ServerError::Traces`] when they cannot be followed.
    pub fn from_environment() -> Result<Self> {
        let told = |name: &&str| std::env::var(name).ok().filter(|value| !value.is_empty());
        let is = |name: &str, value: &str| {
            std::env::var(name).is_ok_and(|told| told.eq_ignore_ascii_case(value))
        };
        let is_off = is("OTEL_SDK_DISABLED", "true") || is("OTEL_TRACES_EXPORTER", "none");
        if is_off || !ENDPOINTS.iter().any(|name| told(name).is_some()) {
            return Ok(Self::default());
        }
        if let Some(other) = PROTOCOLS.iter().rev().find_map(told)
            && other != "http/protobuf"
        {
            return Err(ServerError::Traces(format!(
                "OTEL_EXPORTER_OTLP_PROTOCOL is {other}, and only http/protobuf is spoken: give \
                 that, and the collector's port for it, mostly 4318"
            )));
        }
        let exporter = SpanExporter::builder()
            .with_http()
            .with_protocol(Protocol::HttpBinary)
            .with_http_client(Client::new())
            .build()
            .map_err(|error| ServerError::Traces(error.to_string()))?;
        Ok(Self::by(exporter))
    }

    /// In batches, by a thread of its own. Where the exporter is slow or away, spans wait, 2048 at
    /// most, and further ones are dropped.
    fn by(exporter: SpanExporter) -> Self {
        let mut resource = Resource::builder();
        let found = Resource::builder().build();
        let service = found.get(&Key::from_static_str("service.name"));
        if service.is_none_or(|name| name.as_str().starts_with("unknown_service")) {
            resource = resource.with_service_name(NAME);
        }
        let version = KeyValue::new("service.version", env!("CARGO_PKG_VERSION"));
        let provider = SdkTracerProvider::builder()
            .with_batch_exporter(exporter)
            .with_resource(resource.with_attribute(version).build())
            .build();
        let tracer = provider.tracer(NAME);
        Self {
            made: Some((provider, tracer)),
        }
    }

    /// Begins the span of a request, which may belong to a trace of its client. `None` where
    /// nobody asks for traces.
    pub fn request(
        &self,
        method: &str,
        route: &str,
        id: Option<&str>,
        traceparent: Option<&str>,
    ) -> Option<RequestTrace> {
        let (_, tracer) = self.made.as_ref()?;
        let mut attributes = vec![
            KeyValue::new("http.request.method", method.to_owned()),
            KeyValue::new("http.route", route.to_owned()),
        ];
        attributes.extend(id.map(|id| KeyValue::new("fled.request_id", id.to_owned())));
        let span = tracer
            .span_builder(format!("{method} {route}"))
            .with_kind(SpanKind::Server)
            .with_attributes(attributes);
        let parent = parent::of(traceparent);
        let span = span.start_with_context(tracer, &parent);
        Some(RequestTrace(parent.with_span(span)))
    }

    /// Who makes spans.
    fn tracer(&self) -> Option<&SdkTracer> {
        self.made.as_ref().map(|(_, tracer)| tracer)
    }

    /// Sends what was not sent yet, and nothing more.
    pub async fn stop(&self) {
        let Some((provider, _)) = self.made.clone() else {
            return;
        };
        let stop = move || provider.shutdown_with_timeout(FAREWELL);
        match tokio::task::spawn_blocking(stop).await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::warn!(%error, "the last spans were not sent"),
            Err(error) => tracing::warn!(%error, "the last spans were not sent"),
        }
    }
}

impl RequestTrace {
    /// Lets what `work` does belong to it: [`current`] answers there.
    pub async fn around<T>(&self, work: impl Future<Output = T>) -> T {
        work.with_context(self.0.clone()).await
    }

    /// Ends it.
    pub fn end(self, status: u16) {
        let span = self.0.span();
        let code = KeyValue::new("http.response.status_code", i64::from(status));
        span.set_attribute(code);
        if status >= 500 {
            span.set_status(Status::error(""));
        }
        span.end();
    }
}
