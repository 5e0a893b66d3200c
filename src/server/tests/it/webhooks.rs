//! Webhooks through a real server process: signatures, retries, and refusal of inner networks.

// The example receiver of the documentation.
#[path = "../../../../docs/webhooks/genuine.rs"]
mod genuine;

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread::sleep;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::support::tokens::token_of;
use crate::support::{Server, photographs};
use serde_json::{Value, json};

/// Timeout of everything that is awaited.
const PATIENCE: Duration = Duration::from_secs(30);

/// A received request.
struct Received {
    headers: BTreeMap<String, String>,
    body: String,
}

impl Received {
    fn json(&self) -> Value {
        serde_json::from_str(&self.body).expect("JSON")
    }

    fn headers(&self) -> [&str; 3] {
        ["webhook-id", "webhook-timestamp", "webhook-signature"].map(|name| &*self.headers[name])
    }
}

/// Listens, and answers the n-th request with the n-th status; the last one repeats.
fn listener(statuses: &'static [u16]) -> (String, Receiver<Received>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("bound");
    let url = format!("http://{}/hook", listener.local_addr().expect("an address"));
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        for (at, stream) in listener.incoming().enumerate() {
            let mut stream = stream.expect("a connection");
            let Some(request) = read(&mut stream) else {
                continue;
            };
            let status = statuses[at.min(statuses.len() - 1)];
            let answer = format!(
                "HTTP/1.1 {status} -\r\nlocation: http://127.0.0.1:1/\r\ncontent-length: 0\r\nconnection: close\r\n\r\n"
            );
            stream.write_all(answer.as_bytes()).expect("answered");
            if sender.send(request).is_err() {
                return;
            }
        }
    });
    (url, receiver)
}

fn read(stream: &mut TcpStream) -> Option<Received> {
    let mut reader = BufReader::new(stream);
    let mut line = String::new();
    reader.read_line(&mut line).ok().filter(|&read| read > 0)?;
    let mut headers = BTreeMap::new();
    loop {
        let mut line = String::new();
        reader.read_line(&mut line).ok()?;
        let Some((name, value)) = line.split_once(':') else {
            break;
        };
        headers.insert(name.to_ascii_lowercase(), value.trim().to_owned());
    }
    let mut body = vec![0; headers.get("content-length")?.parse().ok()?];
    reader.read_exact(&mut body).ok()?;
    let body = String::from_utf8(body).expect("UTF-8");
    Some(Received { headers, body })
}

fn server() -> Server {
    Server::start_with(&[("FLED_FAKE_INNER", "1")])
}

/// Creates a webhook, and returns its id and secret.
fn hook(server: &Server, url: &str, types: Option<&[&str]>) -> (String, String) {
    let mut wanted = json!({ "url": url });
    if let Some(types) = types {
        wanted["types"] = json!(types);
    }
    let made = server.post_json("/v1/webhooks", &wanted, &[]).expect(201).json();
    let text = |name: &str| made[name].as_str().expect(name).to_owned();
    (text("id"), text("secret"))
}

fn now() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).expect("after 1970");
    since.as_secs() as i64
}

fn deliveries(server: &Server, hook: &str) -> Vec<Value> {
    let path = format!("/v1/webhooks/{hook}/deliveries");
    let listed = server.get(&path, &[]).expect(200).json();
    listed["deliveries"].as_array().expect("deliveries").clone()
}

fn until<T>(what: &str, look: impl Fn() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(start.elapsed() < PATIENCE, "{what}");
        sleep(Duration::from_millis(50));
    }
}

#[test]
fn subscribed_events_of_a_job_are_delivered_with_a_signature() {
    let server = server();
    let (url, requests) = listener(&[204]);
    let (_, secret) = hook(&server, &url, None);
    let job = server.job("");
    let mut types = Vec::new();
    while !["job.succeeded", "round.finished"].iter().all(|one| types.contains(&(*one).to_owned()))
    {
        let request = requests.recv_timeout(PATIENCE).expect("reported");
        assert!(
            genuine::genuine(&secret, request.headers(), request.body.as_bytes(), now()),
            "{:?}",
            request.headers
        );
        assert!(request.headers["user-agent"].starts_with("fled/"));
        let [id, sent, signature] = request.headers();
        let other = format!("{} ", request.body);
        for (headers, body) in [
            ([id, sent, signature], &other),
            (["msg_other", sent, signature], &request.body),
            ([id, "1", signature], &request.body),
            ([id, sent, "v1,AAAA"], &request.body),
        ] {
            assert!(!genuine::genuine(&secret, headers, body.as_bytes(), now()));
        }
        let event = request.json();
        assert_eq!(event["data"]["job_id"], job.as_str());
        assert!(event["timestamp"].as_str().is_some_and(|time| time.ends_with('Z')));
        if event["type"] == "round.finished" {
            assert!(event["data"]["metrics"].is_object(), "{event}");
        }
        types.push(event["type"].as_str().expect("a type").to_owned());
    }
    assert!(!types.contains(&"job.running".to_owned()), "{types:?}");
}

#[test]
fn a_failed_delivery_is_retried_even_after_a_restart() {
    let mut server = server();
    let (url, requests) = listener(&[500, 500, 200]);
    let (id, _) = hook(&server, &url, None);
    let test = format!("/v1/webhooks/{id}/test");
    server.post_json(&test, &json!({}), &[]).expect(202);
    let first = requests.recv_timeout(PATIENCE).expect("reported");
    let tried = || {
        let delivery = deliveries(&server, &id).pop()?;
        delivery["answer"].is_string().then_some(delivery)
    };
    let delivery = until("the attempt is noted", tried);
    assert!(delivery["delivered_at"].is_null(), "{delivery}");
    server.kill();
    server.restart_with(&[("FLED_FAKE_INNER", "1")]);
    let second = requests.recv_timeout(PATIENCE).expect("reported again");
    assert_eq!(first.headers["webhook-id"], second.headers["webhook-id"]);
    assert_eq!(first.body, second.body);
    // A manual redelivery is sent at once, whatever the outcome before.
    let name = first.headers["webhook-id"].clone();
    let path = format!("/v1/webhooks/{id}/deliveries/{name}/redeliver");
    server.post_json(&path, &json!({}), &[]).expect(202);
    requests.recv_timeout(PATIENCE).expect("reported at once");
    until("it arrived", || {
        let delivery = deliveries(&server, &id).pop()?;
        delivery["delivered_at"].is_string().then_some(())
    });
}

#[test]
fn a_gone_endpoint_gets_no_more_deliveries() {
    let server = server();
    let (url, requests) = listener(&[410]);
    let (id, _) = hook(&server, &url, Some(&["job.queued"]));
    server.job("");
    requests.recv_timeout(PATIENCE).expect("reported");
    until("it is gone", || {
        let hooks = server.get("/v1/webhooks", &[]).expect(200).json();
        hooks["webhooks"][0]["gone_at"].is_string().then_some(())
    });
    server.job("");
    assert_eq!(deliveries(&server, &id).len(), 1);
    let test = format!("/v1/webhooks/{id}/test");
    server.post_json(&test, &json!({}), &[]).expect(409);
    let path = format!("/v1/webhooks/{id}");
    server.ask("DELETE", &path, &[], b"").expect(204);
    server.ask("DELETE", &path, &[], b"").expect(404);
}

#[test]
fn inner_networks_and_invalid_webhooks_are_refused() {
    let mut server = server();
    let (url, requests) = listener(&[200]);
    let (id, _) = hook(&server, &url, None);
    // A name that resolves to an inner address only after the webhook was created.
    server.restart();
    let test = format!("/v1/webhooks/{id}/test");
    server.post_json(&test, &json!({}), &[]).expect(202);
    let answer = until("the attempt is noted", || {
        let delivery = deliveries(&server, &id).pop()?;
        delivery["answer"].as_str().map(str::to_owned)
    });
    assert!(answer.contains("internal network"), "{answer}");
    assert!(requests.try_recv().is_err(), "nothing came");
    for (wanted, at) in [
        (json!({ "url": "file:///etc/passwd" }), "/url"),
        (json!({ "url": url }), "/url"),
        (json!({ "url": "http://0x7f.1/" }), "/url"),
        (json!({ "url": "https://me:secret@example.org/" }), "/url"),
        (json!({ "url": "https://example.org/", "types": ["job.lost"] }), "/types/0"),
        (json!({ "url": "https://example.org/", "types": [] }), "/types"),
    ] {
        let problem = server.post_json("/v1/webhooks", &wanted, &[]).expect(422).json();
        assert_eq!(problem["pointer"], at, "{wanted}");
    }
    for _ in 1..20 {
        hook(&server, "https://example.org/", None);
    }
    let wanted = json!({ "url": "https://example.org/" });
    server.post_json("/v1/webhooks", &wanted, &[]).expect(409);
}

#[test]
fn a_redirect_is_a_failure_and_not_followed() {
    let server = server();
    let (url, requests) = listener(&[302]);
    let (id, _) = hook(&server, &url, None);
    let test = format!("/v1/webhooks/{id}/test");
    server.post_json(&test, &json!({}), &[]).expect(202);
    requests.recv_timeout(PATIENCE).expect("reported");
    let delivery = until("the attempt is noted", || {
        let delivery = deliveries(&server, &id).pop()?;
        delivery["answer"].is_string().then_some(delivery)
    });
    assert_eq!(delivery["answer"], "302");
    assert!(delivery["next_at"].is_string(), "{delivery}");
}

/// The first endpoint accepts connections but never answers.
#[test]
fn a_silent_endpoint_does_not_delay_other_webhooks() {
    let server = server();
    let silent = TcpListener::bind("127.0.0.1:0").expect("bound");
    let address = silent.local_addr().expect("an address");
    let (slow, _) = hook(&server, &format!("http://{address}/"), Some(&["job.queued"]));
    let (url, requests) = listener(&[200]);
    hook(&server, &url, Some(&["job.queued"]));
    let begun = Instant::now();
    for _ in 0..3 {
        server.job("");
        requests.recv_timeout(PATIENCE).expect("reported");
    }
    assert!(begun.elapsed() < Duration::from_secs(14), "{:?}", begun.elapsed());
    assert_eq!(deliveries(&server, &slow).len(), 3);
}

#[test]
fn a_webhook_without_a_token_ends_with_the_first_token() {
    let server = server();
    let (url, requests) = listener(&[200]);
    let (id, _) = hook(&server, &url, Some(&["job.queued"]));
    let (admin, _) = token_of("root", &server, "admin");
    let shown = [("authorization", &*admin)];
    let made = |url: &str| {
        let wanted = json!({ "url": url, "types": ["job.queued"] });
        server.post_json("/v1/webhooks", &wanted, &shown).expect(201);
    };
    let (other, others) = listener(&[200]);
    made(&other);
    let capture = server.upload("/v1/captures", &photographs(4), &shown).expect(201).json();
    let body = json!({ "capture_id": capture["id"], "preset": "preview" });
    server.post_json("/v1/jobs", &body, &shown).expect(202);
    others.recv_timeout(PATIENCE).expect("reported");
    assert!(requests.try_recv().is_err(), "the older one gets nothing");
    let path = format!("/v1/webhooks/{id}/deliveries");
    let list = server.get(&path, &shown).expect(200).json();
    assert_eq!(list["deliveries"], json!([]));
    // A token without read access gets no webhook.
    let reads_nothing = token_of("ben", &server, "jobs:write").0;
    let wanted = json!({ "url": url });
    let bens = [("authorization", &*reads_nothing)];
    server.post_json("/v1/webhooks", &wanted, &bens).expect(403);
}

#[test]
fn a_webhook_is_notified_only_of_its_owners_jobs() {
    let server = server();
    let everything = "jobs:read,jobs:write,renders";
    let (ann, _) = token_of("ann", &server, everything);
    let (ben, _) = token_of("ben", &server, everything);
    let (url, requests) = listener(&[200]);
    let wanted = json!({ "url": url, "types": ["job.queued"] });
    let anns = [("authorization", &*ann)];
    let bens = [("authorization", &*ben)];
    let made = server.post_json("/v1/webhooks", &wanted, &anns).expect(201).json();
    let id = made["id"].as_str().expect("an id");
    let path = format!("/v1/webhooks/{id}/deliveries");
    server.get(&path, &bens).expect(404);
    let hooks = server.get("/v1/webhooks", &bens).expect(200).json();
    assert_eq!(hooks["webhooks"], json!([]));
    for who in [bens, anns] {
        let capture = server.upload("/v1/captures", &photographs(4), &who).expect(201).json();
        let body = json!({ "capture_id": capture["id"], "preset": "preview" });
        server.post_json("/v1/jobs", &body, &who).expect(202);
    }
    let request = requests.recv_timeout(PATIENCE).expect("reported");
    let listed = server.get("/v1/jobs", &anns).expect(200).json();
    assert_eq!(request.json()["data"]["job_id"], listed["jobs"][0]["id"]);
    let deliveries = server.get(&path, &anns).expect(200).json();
    assert_eq!(deliveries["deliveries"].as_array().map(Vec::len), Some(1));
}

/// A receiver program, which ends with the test.
struct Program {
    child: Child,
    lines: Receiver<String>,
}

impl Program {
    fn start(program: &str, file: &str, port: u16, secret: &str) -> Self {
        let file = format!("{}/../../docs/webhooks/{file}", env!("CARGO_MANIFEST_DIR"));
        let mut child = Command::new(program)
            .arg(file)
            .arg(port.to_string())
            .env("FLED_WEBHOOK_SECRET", secret)
            .stdout(Stdio::piped())
            .spawn()
            .expect(program);
        let stdout = BufReader::new(child.stdout.take().expect("piped"));
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in stdout.lines().map_while(Result::ok) {
                let _ = sender.send(line);
            }
        });
        until("it listens", || TcpStream::connect(("127.0.0.1", port)).ok());
        Self { child, lines }
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn the_documented_receivers_accept_only_genuine_deliveries() {
    let server = server();
    for (program, file) in [("python3", "receive.py"), ("node", "receive.mjs")] {
        let free = TcpListener::bind("127.0.0.1:0").expect("bound");
        let port = free.local_addr().expect("an address").port();
        drop(free);
        let url = format!("http://127.0.0.1:{port}/");
        let (id, secret) = hook(&server, &url, Some(&["job.failed"]));
        let receiver = Program::start(program, file, port, &secret);
        let test = format!("/v1/webhooks/{id}/test");
        server.post_json(&test, &json!({}), &[]).expect(202);
        let line = receiver.lines.recv_timeout(PATIENCE).expect(file);
        assert!(line.starts_with("msg_") && line.contains("webhook.test"), "{file}: {line}");
        until("it arrived", || {
            let delivery = deliveries(&server, &id).pop()?;
            delivery["delivered_at"].is_string().then_some(())
        });
        // With another secret it refuses, and nothing is printed.
        drop(receiver);
        let receiver =
            Program::start(program, file, port, "whsec_AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA");
        server.post_json(&test, &json!({}), &[]).expect(202);
        until("it is refused", || {
            let refused = |delivery: &Value| delivery["answer"] == "401";
            deliveries(&server, &id).iter().any(refused).then_some(())
        });
        assert!(receiver.lines.try_recv().is_err(), "{file}");
    }
}
