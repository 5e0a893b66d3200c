//! Traces as a collector gets them: what belongs to what, and what is not told.

mod support;

use std::collections::{BTreeMap, HashMap};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::thread::{sleep, spawn};
use std::time::{Duration, Instant};

use fled_core::event::Stage;
use fled_tests::Postgres;
use opentelemetry_proto::tonic::collector::trace::v1::ExportTraceServiceRequest;
use opentelemetry_proto::tonic::common::v1::any_value::Value as Told;
use opentelemetry_proto::tonic::common::v1::{AnyValue, KeyValue};
use prost::Message;
use serde_json::json;
use support::Server;
use support::tokens::token_of;

const PATIENCE: Duration = Duration::from_secs(30);

/// A trace of a client's, and its span.
const TRACE: &str = "0af7651916cd43dd8448eb211c80319c";
const CLIENT: &str = "b7ad6b7169203331";

#[derive(Clone, Debug)]
struct Span {
    service: String,
    name: String,
    trace: String,
    id: String,
    parent: String,
    attributes: BTreeMap<String, String>,
    failed: bool,
    began: u64,
    ended: u64,
}

/// Somebody who takes spans.
struct Collector {
    address: String,
    spans: Arc<Mutex<Vec<Span>>>,
}

impl Collector {
    fn new() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let address = format!("http://{}", listener.local_addr().expect("address"));
        let spans: Arc<Mutex<Vec<Span>>> = Arc::default();
        let kept = spans.clone();
        spawn(move || {
            for stream in listener.incoming() {
                let kept = kept.clone();
                spawn(move || take(stream.expect("a connection"), &kept));
            }
        });
        Self { address, spans }
    }

    /// Waits until there are so many spans that are meant.
    fn wait(&self, count: usize, is_meant: impl Fn(&Span) -> bool) -> Vec<Span> {
        let begun = Instant::now();
        loop {
            let spans = self.spans.lock().expect("not poisoned").clone();
            let meant = spans.iter().filter(|span| is_meant(span)).count();
            if meant >= count {
                return spans;
            }
            assert!(begun.elapsed() < PATIENCE, "{meant} of {count}: {spans:#?}");
            sleep(Duration::from_millis(50));
        }
    }
}

/// Answers requests on a connection, as OTLP over HTTP is spoken.
fn take(stream: TcpStream, kept: &Mutex<Vec<Span>>) {
    let mut answers = stream.try_clone().expect("a second handle");
    let mut stream = BufReader::new(stream);
    loop {
        let mut first = String::new();
        if stream.read_line(&mut first).unwrap_or(0) == 0 {
            return;
        }
        assert_eq!(first.trim_end(), "POST /v1/traces HTTP/1.1");
        let mut length = 0;
        loop {
            let mut line = String::new();
            stream.read_line(&mut line).expect("a header");
            let line = line.trim_end().to_ascii_lowercase();
            if let Some(told) = line.strip_prefix("content-length:") {
                length = told.trim().parse().expect("a number");
            }
            if line.is_empty() {
                break;
            }
        }
        let mut body = vec![0; length];
        stream.read_exact(&mut body).expect("a body");
        let told = ExportTraceServiceRequest::decode(body.as_slice()).expect("protobuf");
        kept.lock().expect("not poisoned").extend(spans(told));
        answers
            .write_all(b"HTTP/1.1 200 OK\r\ncontent-length: 0\r\n\r\n")
            .expect("answered");
    }
}

fn spans(told: ExportTraceServiceRequest) -> Vec<Span> {
    let mut spans = Vec::new();
    for resource in told.resource_spans {
        let about = attributes(resource.resource.expect("a resource").attributes);
        for span in resource.scope_spans.into_iter().flat_map(|of| of.spans) {
            spans.push(Span {
                service: about["service.name"].clone(),
                name: span.name,
                trace: hex(&span.trace_id),
                id: hex(&span.span_id),
                parent: hex(&span.parent_span_id),
                attributes: attributes(span.attributes),
                failed: span.status.is_some_and(|status| status.code == 2),
                began: span.start_time_unix_nano,
                ended: span.end_time_unix_nano,
            });
        }
    }
    spans
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn attributes(told: Vec<KeyValue>) -> BTreeMap<String, String> {
    let shown = |value: Option<AnyValue>| match value.and_then(|value| value.value) {
        Some(Told::StringValue(text)) => text,
        Some(Told::IntValue(number)) => number.to_string(),
        Some(Told::BoolValue(flag)) => flag.to_string(),
        other => panic!("{other:?}"),
    };
    let told = told.into_iter();
    told.map(|one| (one.key, shown(one.value))).collect()
}

/// Whether a process has a thread that sends spans.
fn sends(server: &Server) -> bool {
    let tasks = std::fs::read_dir(format!("/proc/{}/task", server.pid()));
    tasks.expect("Linux").flatten().any(|task| {
        let name = std::fs::read_to_string(task.path().join("comm"));
        name.is_ok_and(|name| name.starts_with("OpenTelemetry"))
    })
}

/// Whose secrets and names there are, and what of them is in no span.
fn tells_nothing_of(spans: &[Span], secrets: &[&str]) {
    let known = [
        "error.type",
        "fled.attempt",
        "fled.best_round",
        "fled.job",
        "fled.outcome",
        "fled.preset",
        "fled.request_id",
        "fled.round",
        "fled.skipped",
        "fled.worker",
        "http.request.method",
        "http.response.status_code",
        "http.route",
    ];
    for span in spans {
        for (key, value) in &span.attributes {
            assert!(known.contains(&key.as_str()), "{key}: {value}");
            let is_path = value.starts_with('/') && key != "http.route";
            assert!(!is_path, "{key}: {value}");
            let told = secrets.iter().find(|secret| value.contains(**secret));
            assert_eq!(told, None, "{key}: {value}");
        }
    }
}

/// Sees that an attempt at a preview has all its stages, in order and within it; how many.
fn stages_below(attempt: &Span, spans: &[&Span]) -> usize {
    let stages: Vec<&&Span> = spans
        .iter()
        .filter(|span| span.parent == attempt.id)
        .collect();
    let told: Vec<(&str, &str)> = stages
        .iter()
        .map(|stage| (stage.name.as_str(), stage.attributes["fled.round"].as_str()))
        .collect();
    let rounds = ["1", "2"].into_iter();
    let expected = rounds.flat_map(|round| Stage::ALL[1..].iter().map(move |s| (s.name(), round)));
    let expected: Vec<(&str, &str)> = [("poses", "0")].into_iter().chain(expected).collect();
    assert_eq!(told, expected);
    for stage in stages {
        let within = attempt.began <= stage.began && stage.ended <= attempt.ended;
        assert!(within && stage.began < stage.ended, "{stage:?}");
    }
    expected.len()
}

#[test]
fn a_request_its_job_and_the_stages_on_another_machine_are_one_tree() {
    let collector = Collector::new();
    let postgres = Postgres::start();
    let url = postgres.database();
    let store = tempfile::tempdir().expect("temporary directory");
    let store = store.path().display().to_string();
    let start = |workers: &str, name: &str| {
        Server::start_with(&[
            ("FLED_FAKE_DB", url.as_str()),
            ("FLED_FAKE_STORE", store.as_str()),
            ("FLED_FAKE_WORKERS", workers),
            ("OTEL_EXPORTER_OTLP_ENDPOINT", collector.address.as_str()),
            ("OTEL_SERVICE_NAME", name),
            ("OTEL_BSP_SCHEDULE_DELAY", "200"),
        ])
    };
    let (api, _worker) = (start("0", ""), start("1", "worker"));
    let order = json!({ "capture_id": api.capture(4), "preset": "preview",
                        "options": { "adapter": "ok" } });
    let traceparent = format!("00-{TRACE}-{CLIENT}-01");
    let headers = [
        ("traceparent", traceparent.as_str()),
        ("x-request-id", "walk-1"),
    ];
    let made = api.post_json("/v1/jobs", &order, &headers).expect(202);
    let job = made.json()["id"].as_str().expect("id").to_owned();
    api.wait_state(&job, "succeeded");
    let spans = collector.wait(1, |span| span.name == "attempt");

    let ours: Vec<&Span> = spans.iter().filter(|span| span.trace == TRACE).collect();
    let by_id: HashMap<&str, &Span> = ours.iter().map(|span| (span.id.as_str(), *span)).collect();
    let one = |name: &str| {
        let mut found = ours.iter().filter(|span| span.name == name);
        let (first, more) = (found.next(), found.next());
        assert!(more.is_none(), "{name} twice");
        *first.unwrap_or_else(|| panic!("no {name}: {ours:#?}"))
    };
    let request = one("POST /v1/jobs");
    assert_eq!(request.parent, CLIENT);
    assert_eq!(request.attributes["http.response.status_code"], "202");
    assert_eq!(request.attributes["fled.request_id"], "walk-1");
    assert_eq!(request.service, "fled");
    let attempt = one("attempt");
    assert_eq!(attempt.parent, request.id);
    assert_eq!(attempt.service, "worker");
    assert_eq!(attempt.attributes["fled.job"], job);
    assert_eq!(attempt.attributes["fled.outcome"], "succeeded");
    assert!(!attempt.failed);
    let stages = stages_below(attempt, &ours);
    // All of them, and nothing else, hang together.
    for span in &ours {
        assert!(span.parent == CLIENT || by_id.contains_key(span.parent.as_str()));
    }
    assert_eq!(ours.len(), 2 + stages);
    let data = api.data.path().display().to_string();
    tells_nothing_of(&spans, &[&data, &store, "postgres", ".png"]);
}

#[test]
fn what_fails_says_so_by_its_name_and_no_more_and_nobody_is_named() {
    let collector = Collector::new();
    let endpoint = format!("{}/v1/traces", collector.address);
    let server = Server::start_with(&[
        ("OTEL_EXPORTER_OTLP_TRACES_ENDPOINT", &endpoint),
        ("OTEL_BSP_SCHEDULE_DELAY", "200"),
    ]);
    assert!(sends(&server));
    let job = server.job("leak");
    server.wait_state(&job, "failed");
    let (anna, _) = token_of("Anna Muster", &server, "admin");
    let headers = [("authorization", anna.as_str())];
    let shown = format!("/v1/jobs/{job}?token=geheim");
    server.get(&shown, &headers).expect(200);
    server.get("/nowhere/secret.png", &headers).expect(404);
    let is_attempt = |span: &Span| span.name == "attempt";
    collector.wait(1, is_attempt);
    let spans = collector.wait(1, |span| span.name == "GET none");
    let attempt = spans.iter().find(|span| is_attempt(span));
    let attempt = attempt.expect("an attempt");
    assert!(attempt.failed);
    assert_eq!(attempt.attributes["fled.outcome"], "failed");
    assert_eq!(attempt.attributes["error.type"], "bad_input");
    let secret = anna.trim_start_matches("Bearer ");
    tells_nothing_of(
        &spans,
        &["Anna", secret, "geheim", "secret", "images", "damaged"],
    );
}

#[test]
fn without_the_variable_nothing_is_sent_and_a_collector_that_is_away_costs_nothing() {
    let collector = Collector::new();
    let silent = Server::start_with(&[
        ("OTEL_SERVICE_NAME", "fled"),
        ("OTEL_EXPORTER_OTLP_ENDPOINT", ""),
    ]);
    assert!(!sends(&silent));
    let off = Server::start_with(&[
        ("OTEL_EXPORTER_OTLP_ENDPOINT", collector.address.as_str()),
        ("OTEL_SDK_DISABLED", "true"),
        ("OTEL_BSP_SCHEDULE_DELAY", "50"),
    ]);
    assert!(!sends(&off));
    let nobody = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = format!("http://{}", nobody.local_addr().expect("address"));
    // It listens, and never answers.
    let away = Server::start_with(&[
        ("OTEL_EXPORTER_OTLP_ENDPOINT", address.as_str()),
        ("OTEL_BSP_SCHEDULE_DELAY", "50"),
        ("OTEL_BSP_MAX_QUEUE_SIZE", "4"),
    ]);
    assert!(sends(&away));
    let took = |server: &Server| {
        let job = server.job("ok");
        server.wait_state(&job, "succeeded");
        let begun = Instant::now();
        for _ in 0..200 {
            server.get("/livez", &[]).expect(200);
        }
        begun.elapsed()
    };
    let (without, with) = (took(&silent), took(&away));
    took(&off);
    assert!(
        with < without * 3 + Duration::from_secs(1),
        "{with:?} {without:?}"
    );
    assert!(collector.spans.lock().expect("not poisoned").is_empty());
}

#[test]
fn a_protocol_that_is_not_spoken_is_refused_at_the_start() {
    let data = tempfile::tempdir().expect("temporary directory");
    let refused = Command::new(env!("CARGO_BIN_EXE_fled-fake"))
        .arg("serve")
        .arg(data.path().join("data"))
        .arg(data.path().join("address"))
        .env("OTEL_EXPORTER_OTLP_ENDPOINT", "http://127.0.0.1:4317")
        .env("OTEL_EXPORTER_OTLP_PROTOCOL", "grpc")
        .output()
        .expect("starts");
    let words = String::from_utf8_lossy(&refused.stderr);
    assert!(!refused.status.success());
    assert!(words.contains("http/protobuf"), "{words}");
}
