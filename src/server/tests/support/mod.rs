//! A played server in a process of its own, and a client.

#![allow(dead_code, reason = "each test file uses its part")]

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::thread::sleep;
use std::time::{Duration, Instant};

use fled_core::image::{EncodeFormat, Image};
use serde_json::{Value, json};

pub struct Server {
    pub data: tempfile::TempDir,
    child: Child,
    pub base: String,
    agent: ureq::Agent,
}

impl Drop for Server {
    fn drop(&mut self) {
        self.kill();
    }
}

pub struct Reply {
    pub status: u16,
    pub headers: ureq::http::HeaderMap,
    pub body: Vec<u8>,
}

impl Reply {
    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|error| panic!("{error}: {}", self.text()))
    }

    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }

    pub fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().expect("ASCII"))
    }

    #[track_caller]
    pub fn expect(self, status: u16) -> Self {
        assert_eq!(self.status, status, "{}", self.text());
        self
    }
}

impl Server {
    pub fn start() -> Self {
        let data = tempfile::tempdir().expect("temporary directory");
        let (child, base) = spawn(data.path());
        let agent = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .timeout_global(Some(Duration::from_secs(30)))
            .build()
            .new_agent();
        Self { data, child, base, agent }
    }

    /// kill -9, and nothing else.
    pub fn kill(&mut self) {
        // Gone already is as good.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    pub fn restart(&mut self) {
        self.kill();
        (self.child, self.base) = spawn(self.data.path());
    }

    pub fn get(&self, path: &str, headers: &[(&str, &str)]) -> Reply {
        let mut request = self.agent.get(format!("{}{path}", self.base));
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        reply(request.call())
    }

    pub fn delete(&self, path: &str) -> Reply {
        reply(self.agent.delete(format!("{}{path}", self.base)).call())
    }

    pub fn post(&self, path: &str, body: &[u8], headers: &[(&str, &str)]) -> Reply {
        let mut request = self.agent.post(format!("{}{path}", self.base));
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        reply(request.send(body))
    }

    pub fn post_json(&self, path: &str, body: &Value, headers: &[(&str, &str)]) -> Reply {
        let headers = [headers, &[("content-type", "application/json")]].concat();
        self.post(path, body.to_string().as_bytes(), &headers)
    }

    pub fn upload(&self, path: &str, parts: &[Part], headers: &[(&str, &str)]) -> Reply {
        let headers = [headers, &[("content-type", "multipart/form-data; boundary=XXXX")]].concat();
        self.post(path, &multipart(parts), &headers)
    }

    /// A capture of `n` different photographs; its id.
    pub fn capture(&self, n: usize) -> String {
        let reply = self.upload("/v1/captures", &photographs(n), &[]).expect(201);
        reply.json()["id"].as_str().expect("id").to_owned()
    }

    /// A job of the plan; its id.
    pub fn job(&self, plan: &str) -> String {
        let capture = self.capture(4);
        let body = json!({ "capture_id": capture, "preset": "preview", "options": { "adapter": plan } });
        let reply = self.post_json("/v1/jobs", &body, &[]).expect(202);
        reply.json()["id"].as_str().expect("id").to_owned()
    }

    pub fn show(&self, job: &str) -> Value {
        self.get(&format!("/v1/jobs/{job}"), &[]).expect(200).json()
    }

    /// Waits until the job is as asked.
    #[track_caller]
    pub fn wait(&self, job: &str, what: &str, is: impl Fn(&Value) -> bool) -> Value {
        let start = Instant::now();
        loop {
            let shown = self.show(job);
            if is(&shown) {
                return shown;
            }
            assert!(start.elapsed() < Duration::from_secs(30), "not {what}: {shown:#}");
            sleep(Duration::from_millis(20));
        }
    }

    #[track_caller]
    pub fn wait_state(&self, job: &str, state: &str) -> Value {
        self.wait(job, state, |shown| shown["state"] == state)
    }

    /// The events after a number until the stream ends or there are `most`: (number, name, payload).
    pub fn events(&self, job: &str, after: i64, most: usize) -> Vec<(i64, String, Value)> {
        let request = self
            .agent
            .get(format!("{}/v1/jobs/{job}/events", self.base))
            .header("last-event-id", after.to_string());
        let response = request.call().expect("stream");
        let mut events = Vec::new();
        let (mut id, mut name) = (0, String::new());
        for line in BufReader::new(response.into_body().into_reader()).lines() {
            // A stream of a killed server ends in an error: what came before counts.
            let Ok(line) = line else { break };
            match line.split_once(": ").or_else(|| line.split_once(':')) {
                Some(("id", text)) => id = text.trim().parse().expect("number"),
                Some(("event", text)) => name = text.trim().to_owned(),
                Some(("data", text)) => {
                    events.push((id, name.clone(), serde_json::from_str(text.trim()).expect("JSON")));
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
    Reply { status: response.status().as_u16(), headers: response.headers().clone(), body }
}

fn spawn(data: &Path) -> (Child, String) {
    let file = data.join("address");
    let _ = std::fs::remove_file(&file);
    let program = PathBuf::from(env!("CARGO_BIN_EXE_fled-fake"));
    let child = Command::new(program).arg("serve").arg(data.join("data")).arg(&file).spawn().expect("start");
    let start = Instant::now();
    loop {
        match std::fs::read_to_string(&file) {
            Ok(address) if address.contains(':') => return (child, format!("http://{address}")),
            _ => assert!(start.elapsed() < Duration::from_secs(20), "the server does not start"),
        }
        sleep(Duration::from_millis(10));
    }
}

/// Field name, file name, content.
pub type Part = (String, Option<String>, Vec<u8>);

pub fn text(name: &str, value: &str) -> Part {
    (name.to_owned(), None, value.as_bytes().to_vec())
}

pub fn file(name: &str, content: &[u8]) -> Part {
    ("images".to_owned(), Some(name.to_owned()), content.to_vec())
}

pub fn photographs(n: usize) -> Vec<Part> {
    (0..n).map(|i| file(&format!("{i:03}.png"), &photograph(i))).collect()
}

/// Texture that differs from photograph to photograph.
pub fn photograph(seed: usize) -> Vec<u8> {
    let mut image: Image = Image::new(160, 120);
    for y in 0..120 {
        for x in 0..160 {
            let v = ((x * (7 + seed) + y * (13 + 3 * seed) + (x * y) / (5 + seed)) % 97) as f32 / 400.0;
            image.set(x, y, [v, v * 0.8, v * 0.6]);
        }
    }
    image.encode(EncodeFormat::Png).expect("encode")
}

/// A zip without compression.
pub fn zip(files: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, content) in files {
        let options =
            zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
        writer.start_file(*name, options).expect("entry");
        std::io::Write::write_all(&mut writer, content).expect("content");
    }
    writer.finish().expect("zip").into_inner()
}

fn multipart(parts: &[Part]) -> Vec<u8> {
    let mut body = Vec::new();
    for (name, file, content) in parts {
        let file = file.as_ref().map_or(String::new(), |file| format!("; filename=\"{file}\""));
        body.extend(
            format!("--XXXX\r\nContent-Disposition: form-data; name=\"{name}\"{file}\r\n\r\n").bytes(),
        );
        body.extend(content);
        body.extend(b"\r\n");
    }
    body.extend(b"--XXXX--\r\n");
    body
}
