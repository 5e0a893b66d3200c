//! The configurations of nginx and Caddy in docs/service.md, tried with those programs, and the
//! headers that a proxy heeds.

use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command};
use std::thread::sleep;
use std::time::{Duration, Instant};

use fled_tests::Client;
use serde_json::json;

use crate::support::tokens::token_of;
use crate::support::{Server, photographs};

const PATIENCE: Duration = Duration::from_secs(60);
/// The name of the host in the document.
const NAME: &str = "fled.example.org";

#[test]
fn an_event_stream_is_not_collected_by_a_proxy() {
    let server = Server::start();
    let job = server.job("ok");
    let stream = server.get(&format!("/v1/jobs/{job}/events"), &[]).expect(200);
    assert_eq!(stream.header("x-accel-buffering"), "no");
}

#[test]
fn every_location_and_cookie_holds_below_a_path() {
    let server = Server::start();
    let job = server.job("ok");
    let (header, _) = token_of("anna", &server, "admin");
    let headers = [("authorization", header.as_str())];
    let share = server.post_json(&format!("/v1/jobs/{job}/shares"), &json!({}), &headers);
    assert!(share.expect(201).location().starts_with(&format!("/v1/jobs/{job}/shares/")));
    let hook = json!({ "url": "https://example.com/hook" });
    let hook = server.post_json("/v1/webhooks", &hook, &headers).expect(201);
    assert!(hook.location().starts_with("/v1/webhooks/"));
}

/// The block of a document between "```LANGUAGE" and "```".
fn block(language: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/service.md");
    let text = std::fs::read_to_string(path).expect("the document");
    let (_, rest) = text.split_once(&format!("```{language}\n")).expect("a block");
    rest.split_once("```").expect("its end").0.to_owned()
}

/// A running proxy.
struct Proxy(Child);

impl Drop for Proxy {
    fn drop(&mut self) {
        let stopped = Command::new("kill").arg(self.0.id().to_string()).status();
        assert!(stopped.expect("kill runs").success());
        self.0.wait().expect("ended");
    }
}

impl Proxy {
    /// Starts a program, and waits until it answers at `base`.
    fn start(mut command: Command, client: &Client) -> Self {
        let proxy = Self(command.spawn().expect("installed by `make test-nightly`"));
        let address = client.base.trim_start_matches("http://").split('/').next();
        let address = address.expect("an address");
        let begun = Instant::now();
        while std::net::TcpStream::connect(address).is_err() {
            assert!(begun.elapsed() < PATIENCE, "the proxy does not start");
            sleep(Duration::from_millis(50));
        }
        proxy
    }
}

/// A free address of this machine.
fn free() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    listener.local_addr().expect("an address").to_string()
}

#[test]
#[ignore = "make test-nightly"]
fn nginx_passes_everything_as_documented() {
    let server = Server::start();
    let (folder, address) = (tempfile::tempdir().expect("temporary folder"), free());
    let block = block("nginx");
    let lines = block.lines().filter(|line| !line.contains("ssl_"));
    let site: Vec<_> = lines.map(|line| line.replace("443 ssl", &address)).collect();
    let site = site.join("\n").replace("127.0.0.1:8080", server.base.trim_start_matches("http://"));
    let place = folder.path().display();
    let temporary = ["client_body", "proxy", "fastcgi", "uwsgi", "scgi"];
    let temporary = temporary.map(|kind| format!("{kind}_temp_path {place}/{kind};")).join("\n");
    let file = folder.path().join("nginx.conf");
    let text = format!(
        "daemon off; pid {place}/pid; error_log stderr; events {{}}\n\
         http {{ access_log off;\n{temporary}\n{site}\n}}"
    );
    std::fs::write(&file, text).expect("written");
    let client = Client::new(format!("http://{address}/fled"), PATIENCE);
    let mut command = Command::new("nginx");
    command.arg("-c").arg(&file).arg("-p").arg(folder.path());
    let _proxy = Proxy::start(command, &client);
    passes(&server, &client);
}

#[test]
#[ignore = "make test-nightly"]
fn caddy_passes_everything_as_documented() {
    let server = Server::start();
    let (folder, address) = (tempfile::tempdir().expect("temporary folder"), free());
    let site = block("caddy").replace(NAME, &format!("http://{address}"));
    let site = site.replace("127.0.0.1:8080", server.base.trim_start_matches("http://"));
    let file = folder.path().join("Caddyfile");
    std::fs::write(&file, format!("{{\n\tadmin off\n}}\n{site}")).expect("written");
    let client = Client::new(format!("http://{address}/fled"), PATIENCE);
    let mut command = Command::new("caddy");
    command.args(["run", "--adapter", "caddyfile", "--config"]).arg(&file);
    command.env("HOME", folder.path());
    let _proxy = Proxy::start(command, &client);
    passes(&server, &client);
}

/// Uses all that a proxy may break, below its path.
fn passes(server: &Server, client: &Client) {
    let page = client.get("/", &[]).expect(200).text();
    let (_, rest) = page.split_once("<script type=\"module\" src=\"").expect("a script");
    let script = rest.split('"').next().expect("an address");
    assert!(!script.starts_with('/'), "{script}");
    client.get(&format!("/{script}"), &[]).expect(200);
    assert!(client.get("", &[]).expect(200).text() == page, "without the slash, too");
    let html = [("accept", "text/html")];
    assert!(client.get("/no/such/page", &html).expect(404).text().contains("Page not found"));

    // More than nginx takes by default, in a piece of an upload and in a form.
    let large = vec![7; 5 << 20];
    let headers = [("tus-resumable", "1.0.0"), ("upload-metadata", "filename d2Fsay5wbmc=")];
    let length = large.len().to_string();
    let begin = [&headers[..], &[("upload-length", length.as_str())]].concat();
    let upload = client.ask("POST", "/v1/uploads", &begin, b"").expect(201).location();
    let path = upload.strip_prefix("/fled").expect("below the path");
    let kind = ("content-type", "application/offset+octet-stream");
    let piece = [headers[0], kind, ("upload-offset", "0")];
    client.ask("PATCH", path, &piece, &large).expect(204);
    client.ask("DELETE", path, &headers[..1], b"").expect(204);
    let mut parts = photographs(4);
    parts.push(fled_tests::file("large.txt", &large));
    let capture = client.upload("/v1/captures", &parts, &[]).expect(201).json();

    let options = json!({ "adapter": "slow:30" });
    let order = json!({ "capture_id": capture["id"], "preset": "preview", "options": options });
    let job = client.post_json("/v1/jobs", &order, &[]).expect(202);
    let id = job.json()["id"].as_str().expect("id").to_owned();
    assert_eq!(job.location(), format!("/fled/v1/jobs/{id}"));
    assert_eq!(client.events(&id, 0, 3).len(), 3);
    assert!(server.show(&id)["finished_at"].is_null(), "events arrive while the job runs");
    client.wait_state(&id, "succeeded");

    // A browser sends its origin, from which a page may log in.
    let (header, _) = token_of("anna", server, "admin");
    let token = json!({ "token": header.trim_start_matches("Bearer ") });
    let origin = client.base.trim_end_matches("/fled");
    let login = client.post_json("/login", &token, &[("origin", origin)]).expect(204);
    let cookie = login.header("set-cookie").split(';').next().expect("a cookie");
    client.get("/v1/jobs", &[("cookie", cookie)]).expect(200);
}
