//! A fake server in a process of its own.

#![allow(dead_code, unused_imports, reason = "each test file uses its part")]

pub mod farm;
pub mod tokens;
pub mod tus;

use std::io::Write;
use std::net::TcpStream;
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::thread::sleep;
use std::time::{Duration, Instant};

use fled_core::image::{EncodeFormat, Image};
use fled_tests::Client;
pub use fled_tests::{Part, file, gone, processes_of, text};
use serde_json::json;

const PROGRAM: &str = env!("CARGO_BIN_EXE_fled-fake");
/// Timeout of a job.
const PATIENCE: Duration = Duration::from_secs(60);

pub struct Server {
    pub data: tempfile::TempDir,
    child: Child,
    client: Client,
}

impl Deref for Server {
    type Target = Client;

    fn deref(&self) -> &Client {
        &self.client
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.kill();
    }
}

impl Server {
    pub fn start() -> Self {
        Self::start_with(&[])
    }

    /// With limits, which `fled-fake` reads from its environment.
    pub fn start_with(limits: &[(&str, &str)]) -> Self {
        let data = tempfile::tempdir().expect("temporary directory");
        let child = spawn(data.path(), limits);
        Self::of(data, child)
    }

    /// With a disk of its own of this size, in a private mount namespace: its data is visible below
    /// [`Server::seen`].
    pub fn start_on_disk(bytes: u64, limits: &[(&str, &str)]) -> Self {
        let data = tempfile::tempdir().expect("temporary directory");
        let disk = data.path().join("data");
        std::fs::create_dir(&disk).expect("a folder");
        let mount = format!("mount -t tmpfs -o size={bytes} none \"$0\" && exec \"$@\"");
        let mut command = Command::new("unshare");
        command.args(["--map-root-user", "--mount", "sh", "-c", &mount]);
        command.arg(&disk).arg(PROGRAM);
        let child = spawn_by(command, data.path(), limits);
        Self::of(data, child)
    }

    fn of(data: tempfile::TempDir, (child, base): (Child, String)) -> Self {
        let client = Client::new(base, PATIENCE);
        Self { data, child, client }
    }

    /// The data directory as the server sees it.
    pub fn seen(&self) -> PathBuf {
        let root = format!("/proc/{}/root", self.child.id());
        let path = self.data.path().join("data");
        Path::new(&root).join(path.strip_prefix("/").expect("absolute"))
    }

    /// Sends SIGKILL.
    pub fn kill(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    pub fn restart(&mut self) {
        self.restart_with(&[]);
    }

    pub fn restart_with(&mut self, limits: &[(&str, &str)]) {
        self.kill();
        let (child, base) = spawn(self.data.path(), limits);
        (self.child, self.client) = (child, Client::new(base, PATIENCE));
    }

    /// Peak memory of the server's process, in bytes.
    pub fn peak_memory(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id()));
        let status = status.expect("the server lives");
        let peak = status
            .lines()
            .find_map(|line| line.strip_prefix("VmHWM:"))
            .and_then(|rest| rest.trim().strip_suffix(" kB"))
            .expect("Linux");
        1024 * peak.trim().parse::<u64>().expect("a number")
    }

    /// The id of the server's process.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// The /proc folders of the server's child processes.
    pub fn children(&self) -> Vec<PathBuf> {
        let parent = format!("PPid:\t{}\n", self.child.id());
        let is_child = |process: &PathBuf| {
            let status = std::fs::read_to_string(process.join("status"));
            status.is_ok_and(|status| status.contains(&parent))
        };
        let processes = std::fs::read_dir("/proc").expect("Linux").flatten();
        let processes = processes.map(|process| process.path());
        processes.filter(is_child).collect()
    }

    /// Sends a whole multipart body without reading the answer; dropping the stream hangs up.
    pub fn begin_upload(&self, path: &str, parts: &[Part]) -> TcpStream {
        let address = self.base.trim_start_matches("http://");
        let body = fled_tests::multipart(parts);
        let mut stream = TcpStream::connect(address).expect("connect");
        let head = format!(
            "POST {path} HTTP/1.1\r\nHost: {address}\r\nContent-Length: {}\r\n\
             Content-Type: multipart/form-data; boundary=XXXX\r\n\r\n",
            body.len()
        );
        stream.write_all(head.as_bytes()).expect("head");
        stream.write_all(&body).expect("body");
        stream
    }

    /// Uploads a capture of `n` different photographs, and returns its id.
    pub fn capture(&self, n: usize) -> String {
        let reply = self.upload("/v1/captures", &photographs(n), &[]).expect(201);
        reply.json()["id"].as_str().expect("id").to_owned()
    }

    /// Creates a job with this plan, and returns its id.
    pub fn job(&self, plan: &str) -> String {
        let capture = self.capture(4);
        let body =
            json!({ "capture_id": capture, "preset": "preview", "options": { "adapter": plan } });
        let reply = self.post_json("/v1/jobs", &body, &[]).expect(202);
        reply.json()["id"].as_str().expect("id").to_owned()
    }
}

fn spawn(data: &Path, limits: &[(&str, &str)]) -> (Child, String) {
    spawn_by(Command::new(PROGRAM), data, limits)
}

fn spawn_by(mut command: Command, data: &Path, limits: &[(&str, &str)]) -> (Child, String) {
    let file = data.join("address");
    let _ = std::fs::remove_file(&file);
    command
        .arg("serve")
        .arg(data.join("data"))
        .arg(&file)
        .env("FLED_MODELS", data.join("models"))
        .envs(limits.iter().copied());
    let child = command.spawn().expect("start");
    let start = Instant::now();
    loop {
        match std::fs::read_to_string(&file) {
            Ok(address) if address.contains(':') => return (child, format!("http://{address}")),
            _ => assert!(start.elapsed() < Duration::from_secs(20), "the server does not start"),
        }
        sleep(Duration::from_millis(10));
    }
}

pub fn photographs(n: usize) -> Vec<Part> {
    (0..n).map(|i| file(&format!("{i:03}.png"), &photograph(i))).collect()
}

/// A texture that differs for each seed.
pub fn photograph(seed: usize) -> Vec<u8> {
    let mut image: Image = Image::new(160, 120);
    for y in 0..120 {
        for x in 0..160 {
            let v =
                ((x * (7 + seed) + y * (13 + 3 * seed) + (x * y) / (5 + seed)) % 97) as f32 / 400.0;
            image.set(x, y, [v, v * 0.8, v * 0.6]);
        }
    }
    image.encode(EncodeFormat::Png).expect("encode")
}

/// An uncompressed zip.
pub fn zip(files: &[(&str, Vec<u8>)]) -> Vec<u8> {
    packed(files, zip::CompressionMethod::Stored)
}

/// A compressed zip.
pub fn deflated(files: &[(&str, Vec<u8>)]) -> Vec<u8> {
    packed(files, zip::CompressionMethod::Deflated)
}

fn packed(files: &[(&str, Vec<u8>)], method: zip::CompressionMethod) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, content) in files {
        let options = zip::write::SimpleFileOptions::default().compression_method(method);
        writer.start_file(*name, options).expect("entry");
        writer.write_all(content).expect("content");
    }
    writer.finish().expect("zip").into_inner()
}
