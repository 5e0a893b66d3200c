//! Metrics of the server, for Prometheus.

use std::fmt;
use std::sync::atomic::AtomicU64;
use std::time::Duration;

use prometheus_client::encoding::{EncodeLabelSet, text};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::{Registry, Unit};

/// Upper bounds of the histogram, in seconds: reads take one millisecond, renders some hundred,
/// uploads minutes.
const TIMES: [f64; 9] = [0.002, 0.01, 0.05, 0.2, 1.0, 5.0, 30.0, 120.0, 600.0];

/// The labels of an answered request.
#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
pub struct Answered {
    /// GET, POST and so on.
    pub method: String,
    /// The route without ids, such as `/v1/jobs/{id}`; `none` for unknown paths.
    pub route: String,
    /// The HTTP status.
    pub status: u16,
}

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct Route {
    route: String,
}

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct Worker {
    worker: String,
    host: String,
}

/// Values that are read at each request for metrics.
#[derive(Debug, Default)]
pub struct Now<'a> {
    /// Jobs of each state.
    pub jobs: Vec<(&'a str, i64)>,
    /// Free bytes of the data directory.
    pub free_bytes: Option<u64>,
    /// The longest time since a lease was extended, in seconds; 0 if no job runs.
    pub lease_age: f64,
    /// Waiting time of the oldest queued job in seconds; 0 if none waits.
    pub waiting: f64,
    /// Workers of each state.
    pub workers: Vec<(&'a str, i64)>,
    /// A worker, its machine, and its training speed over all its jobs, in steps per second.
    pub steps: Vec<(String, String, f64)>,
}

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct State {
    state: String,
}

/// The counters of a server, and the gauges that are read on request.
pub struct Telemetry {
    registry: Registry,
    requests: Family<Answered, Counter>,
    seconds: Family<Route, Histogram, fn() -> Histogram>,
    jobs: Family<State, Gauge>,
    free: Gauge,
    lease_age: Gauge<f64, AtomicU64>,
    waiting: Gauge<f64, AtomicU64>,
    workers: Family<State, Gauge>,
    steps: Family<Worker, Gauge<f64, AtomicU64>>,
}

impl fmt::Debug for Telemetry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Telemetry")
    }
}

impl Default for Telemetry {
    fn default() -> Self {
        let requests = Family::default();
        let of_times: fn() -> Histogram = || Histogram::new(TIMES);
        let seconds = Family::new_with_constructor(of_times);
        let (jobs, free) = (Family::default(), Gauge::default());
        let mut registry = Registry::with_prefix("fled");
        registry.register("requests", "Requests answered", requests.clone());
        registry.register_with_unit(
            "request",
            "Time until a response began",
            Unit::Seconds,
            seconds.clone(),
        );
        registry.register("jobs", "Jobs, by state", jobs.clone());
        registry.register_with_unit(
            "disk_free",
            "Free space of the data directory",
            Unit::Bytes,
            free.clone(),
        );
        let (lease_age, waiting) = (Gauge::default(), Gauge::default());
        let (workers, steps) = (Family::default(), Family::default());
        registry.register_with_unit(
            "lease_age",
            "Time since the least recent heartbeat of a running job",
            Unit::Seconds,
            lease_age.clone(),
        );
        registry.register_with_unit(
            "queue_wait",
            "Time that the oldest queued job has waited",
            Unit::Seconds,
            waiting.clone(),
        );
        registry.register("workers", "Workers, by state", workers.clone());
        registry.register("worker_steps_per_second", "Training speed of a worker", steps.clone());
        Self { registry, requests, seconds, jobs, free, lease_age, waiting, workers, steps }
    }
}

impl Telemetry {
    /// Counts an answer.
    pub fn answered(&self, answered: &Answered, took: Duration) {
        let route = Route { route: answered.route.clone() };
        self.requests.get_or_create(answered).inc();
        self.seconds.get_or_create(&route).observe(took.as_secs_f64());
    }

    /// Returns everything as OpenMetrics text, with the current values of the gauges.
    pub fn text(&self, now: &Now<'_>) -> String {
        for (family, counts) in [(&self.jobs, &now.jobs), (&self.workers, &now.workers)] {
            for (state, count) in counts {
                let state = State { state: (*state).to_owned() };
                family.get_or_create(&state).set(*count);
            }
        }
        if let Some(free) = now.free_bytes {
            self.free.set(i64::try_from(free).unwrap_or(i64::MAX));
        }
        self.lease_age.set(now.lease_age);
        self.waiting.set(now.waiting);
        // Remove workers that have left.
        self.steps.clear();
        for (worker, host, speed) in &now.steps {
            let worker = Worker { worker: worker.clone(), host: host.clone() };
            self.steps.get_or_create(&worker).set(*speed);
        }
        let mut metrics = String::new();
        match text::encode(&mut metrics, &self.registry) {
            Ok(()) => metrics,
            // Writing to a string cannot fail.
            Err(fmt::Error) => String::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metrics_report_what_was_counted() {
        let telemetry = Telemetry::default();
        let answered =
            Answered { method: "GET".to_owned(), route: "/v1/jobs/{id}".to_owned(), status: 200 };
        for _ in 0..3 {
            telemetry.answered(&answered, Duration::from_millis(7));
        }
        let metrics = telemetry.text(&Now {
            jobs: vec![("queued", 2), ("running", 0)],
            free_bytes: Some(5),
            waiting: 1.5,
            steps: vec![("w".to_owned(), "machine".to_owned(), 12.5)],
            ..Now::default()
        });
        for line in [
            "fled_requests_total{method=\"GET\",route=\"/v1/jobs/{id}\",status=\"200\"} 3",
            "fled_request_seconds_bucket{le=\"0.002\",route=\"/v1/jobs/{id}\"} 0",
            "fled_request_seconds_bucket{le=\"0.01\",route=\"/v1/jobs/{id}\"} 3",
            "fled_jobs{state=\"queued\"} 2",
            "fled_disk_free_bytes 5",
            "fled_queue_wait_seconds 1.5",
            "fled_worker_steps_per_second{worker=\"w\",host=\"machine\"} 12.5",
        ] {
            assert!(metrics.lines().any(|sample| sample == line), "{line}\n{metrics}");
        }
        assert!(metrics.ends_with("# EOF\n"));
    }
}
