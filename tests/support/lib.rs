//! Shared helpers of the service's tests: a client for its HTTP API.

mod postgres;
mod s3;

use std::io::{BufRead, BufReader};
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde_json::Value;
use ureq::ResponseExt;

pub use postgres::Postgres;
pub use s3::{Fault, S3};

/// Time limit of a request.
const PATIENCE: Duration = Duration::from_secs(30);

/// A client of one server.
#[derive(Debug)]
pub struct Client {
    /// `http://` and the address.
    pub base: String,
    agent: ureq::Agent,
    patience: Duration,
}

/// A server's response.
#[derive(Debug)]
pub struct Reply {
    /// The path of the request.
    pub path: String,
    /// The status code.
    pub status: u16,
    /// All headers.
    pub headers: ureq::http::HeaderMap,
    /// The whole body.
    pub body: Vec<u8>,
}

impl Reply {
    /// The body as JSON.
    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|error| panic!("{error}: {}", self.text()))
    }

    /// The body as text.
    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }

    /// The value of a header, empty when absent.
    pub fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().expect("ASCII"))
    }

    /// The path in `Location`, resolved from the request's own, as a client of HTTP does.
    pub fn location(&self) -> String {
        let location = self.header("location");
        assert!(!location.starts_with('/'), "{location} does not hold below the path of a proxy");
        let mut folders: Vec<_> = self.path.split('/').collect();
        folders.pop();
        for part in location.split('/').filter(|part| *part != ".") {
            match part {
                ".." => drop(folders.pop()),
                _ => folders.push(part),
            }
        }
        folders.join("/")
    }

    /// Panics with the body unless the status is `status`.
    #[track_caller]
    pub fn expect(self, status: u16) -> Self {
        assert_eq!(self.status, status, "{}", self.text());
        self
    }
}

impl Client {
    /// `patience` is the time limit of [`Self::wait`].
    pub fn new(base: String, patience: Duration) -> Self {
        let agent = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .timeout_global(Some(PATIENCE))
            .build()
            .new_agent();
        Self { base, agent, patience }
    }

    /// Sends a GET request with headers.
    pub fn get(&self, path: &str, headers: &[(&str, &str)]) -> Reply {
        let mut request = self.agent.get(format!("{}{path}", self.base));
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        reply(request.call())
    }

    /// Sends a DELETE request.
    pub fn delete(&self, path: &str) -> Reply {
        self.delete_as(path, &[])
    }

    /// Sends a DELETE request with headers.
    pub fn delete_as(&self, path: &str, headers: &[(&str, &str)]) -> Reply {
        let mut request = self.agent.delete(format!("{}{path}", self.base));
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        reply(request.call())
    }

    /// Sends a PUT request without a body.
    pub fn put(&self, path: &str) -> Reply {
        reply(self.agent.put(format!("{}{path}", self.base)).send_empty())
    }

    /// Sends a POST request with bytes.
    pub fn post(&self, path: &str, body: &[u8], headers: &[(&str, &str)]) -> Reply {
        let mut request = self.agent.post(format!("{}{path}", self.base));
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        reply(request.send(body))
    }

    /// Sends a request with any method, headers and body.
    pub fn ask(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &[u8]) -> Reply {
        let mut request = ureq::http::Request::builder();
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let request = request.method(method).uri(format!("{}{path}", self.base));
        let request = request.body(body).expect("a request");
        reply(self.agent.run(request))
    }

    /// Sends a POST request with JSON.
    pub fn post_json(&self, path: &str, body: &Value, headers: &[(&str, &str)]) -> Reply {
        let headers = [headers, &[("content-type", "application/json")]].concat();
        self.post(path, body.to_string().as_bytes(), &headers)
    }

    /// Sends a POST request with a multipart form.
    pub fn upload(&self, path: &str, parts: &[Part], headers: &[(&str, &str)]) -> Reply {
        let headers = [headers, &[("content-type", "multipart/form-data; boundary=XXXX")]].concat();
        self.post(path, &multipart(parts), &headers)
    }

    /// The current state of the job.
    pub fn show(&self, job: &str) -> Value {
        self.get(&format!("/v1/jobs/{job}"), &[]).expect(200).json()
    }

    /// Waits until the job meets the condition.
    #[track_caller]
    pub fn wait(&self, job: &str, what: &str, is: impl Fn(&Value) -> bool) -> Value {
        let start = Instant::now();
        loop {
            let shown = self.show(job);
            if is(&shown) {
                return shown;
            }
            assert!(start.elapsed() < self.patience, "not {what}: {shown:#}");
            sleep(Duration::from_millis(20));
        }
    }

    /// Waits until the job is in the state; panics if it ends in another.
    #[track_caller]
    pub fn wait_state(&self, job: &str, state: &str) -> Value {
        let is_over = |shown: &Value| shown["finished_at"].is_string();
        let shown = self.wait(job, state, |shown| shown["state"] == state || is_over(shown));
        assert_eq!(shown["state"], state, "{shown:#}");
        shown
    }

    /// The events after number `after`, as (number, name, payload), until the stream ends or there
    /// are `most`.
    pub fn events(&self, job: &str, after: i64, most: usize) -> Vec<(i64, String, Value)> {
        let request = self
            .agent
            .get(format!("{}/v1/jobs/{job}/events", self.base))
            .header("last-event-id", after.to_string());
        let response = request.call().expect("stream");
        let mut events = Vec::new();
        let (mut id, mut name) = (0, String::new());
        for line in BufReader::new(response.into_body().into_reader()).lines() {
            // The stream of a killed server ends in an error; the events before it count.
            let Ok(line) = line else { break };
            match line.split_once(": ").or_else(|| line.split_once(':')) {
                Some(("id", text)) => id = text.trim().parse().expect("number"),
                Some(("event", text)) => name = text.trim().to_owned(),
                Some(("data", text)) => {
                    events.push((
                        id,
                        name.clone(),
                        serde_json::from_str(text.trim()).expect("JSON"),
                    ));
                    if events.len() == most {
                        break;
                    }
                }
                _ => {}
            }
        }
        events
    }
}

fn reply(outcome: Result<ureq::http::Response<ureq::Body>, ureq::Error>) -> Reply {
    let mut response = outcome.expect("an answer");
    let body = response.body_mut().with_config().limit(1 << 30).read_to_vec().expect("body");
    let path = response.get_uri().path().to_owned();
    let status = response.status().as_u16();
    Reply { path, status, headers: response.headers().clone(), body }
}

/// Field name, file name, content.
pub type Part = (String, Option<String>, Vec<u8>);

/// A text field.
pub fn text(name: &str, value: &str) -> Part {
    (name.to_owned(), None, value.as_bytes().to_vec())
}

/// A file of the field `images`.
pub fn file(name: &str, content: &[u8]) -> Part {
    ("images".to_owned(), Some(name.to_owned()), content.to_vec())
}

/// The body of a form, with the boundary `XXXX`.
pub fn multipart(parts: &[Part]) -> Vec<u8> {
    let mut body = Vec::new();
    for (name, file, content) in parts {
        let file = file.as_ref().map_or(String::new(), |file| format!("; filename=\"{file}\""));
        body.extend(
            format!("--XXXX\r\nContent-Disposition: form-data; name=\"{name}\"{file}\r\n\r\n")
                .bytes(),
        );
        body.extend(content);
        body.extend(b"\r\n");
    }
    body.extend(b"--XXXX--\r\n");
    body
}

/// Number of processes with the job's mark.
pub fn processes_of(job: &str) -> usize {
    pids_of(job).len()
}

/// The processes with the job's mark in their environment.
pub fn pids_of(job: &str) -> Vec<u32> {
    let mark = format!("FLED_JOB_ID={job}");
    let processes = std::fs::read_dir("/proc").expect("Linux");
    let marked = |path: std::path::PathBuf| {
        std::fs::read(path.join("environ"))
            .is_ok_and(|text| text.split(|&b| b == 0).any(|v| v == mark.as_bytes()))
    };
    processes
        .flatten()
        .filter(|entry| marked(entry.path()))
        .filter_map(|entry| entry.file_name().to_str()?.parse().ok())
        .collect()
}

/// Waits up to two seconds for all processes of a job to end; returns whether they did.
pub fn gone(job: &str) -> bool {
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(2) {
        if processes_of(job) == 0 {
            return true;
        }
        sleep(Duration::from_millis(20));
    }
    false
}
