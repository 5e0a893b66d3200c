//! A PostgreSQL server for the tests, in a temporary folder and on a free port, separate from the
//! system's.

use std::fs;
use std::net::TcpListener;
use std::os::unix::fs::{PermissionsExt, chown};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Time limit for the start or the end of a server.
const PATIENCE: Duration = Duration::from_secs(60);

/// Debian's folder of PostgreSQL programs, which are not in the search path.
const DEBIAN: &str = "/usr/lib/postgresql";

/// A PostgreSQL server.
#[derive(Debug)]
pub struct Postgres {
    folder: PathBuf,
    port: u16,
    child: Option<Child>,
    remover: Child,
    databases: AtomicU32,
}

impl Postgres {
    /// The server shared by the tests of a process, for the life of the process.
    ///
    /// # Panics
    /// If PostgreSQL is not installed or does not start.
    pub fn shared() -> &'static Self {
        static SHARED: OnceLock<Postgres> = OnceLock::new();
        SHARED.get_or_init(|| {
            let (sender, receiver) = mpsc::channel();
            // The server ends with the thread that started it, so this one lives as long as the
            // tests.
            std::thread::spawn(move || {
                if sender.send(Self::start()).is_ok() {
                    loop {
                        std::thread::park();
                    }
                }
            });
            receiver.recv().expect("PostgreSQL begins")
        })
    }

    /// Creates and starts a server.
    ///
    /// # Panics
    /// If PostgreSQL is not installed or does not start.
    pub fn start() -> Self {
        let folder = tempfile::tempdir().expect("temporary directory").keep();
        fs::set_permissions(&folder, fs::Permissions::from_mode(0o755)).expect("permissions");
        let data = folder.join("data");
        fs::create_dir(&data).expect("create");
        fs::set_permissions(&data, fs::Permissions::from_mode(0o700)).expect("permissions");
        if let Some((user, group)) = other_user() {
            chown(&data, Some(user), Some(group)).expect("chown");
            chown(&folder, Some(user), Some(group)).expect("chown");
        }
        let made = as_user(&program("initdb"))
            .args(["-U", "fled", "--auth=trust", "--encoding=UTF8", "--locale=C.UTF-8", "-D"])
            .arg(&data)
            .output()
            .expect("initdb runs");
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        let port = {
            let taken = TcpListener::bind("127.0.0.1:0").expect("a free port");
            taken.local_addr().expect("address").port()
        };
        let remover = remover(&folder);
        let mut server = Self { folder, port, child: None, remover, databases: AtomicU32::new(0) };
        server.begin();
        server
    }

    /// Starts the server again after it was killed.
    ///
    /// # Panics
    /// If it does not start.
    pub fn begin(&mut self) {
        let log = fs::File::create(self.folder.join("log")).expect("log");
        let child = as_user(&program("postgres"))
            .arg("-D")
            .arg(self.folder.join("data"))
            .args(["-p", &self.port.to_string(), "-c", "listen_addresses=127.0.0.1", "-k"])
            .arg(&self.folder)
            // The tests do not cover power cuts.
            .args(["-c", "fsync=off", "-c", "max_connections=200"])
            .args(["-c", "min_wal_size=32MB", "-c", "max_wal_size=64MB"])
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .expect("postgres starts");
        self.child = Some(child);
        let begun = Instant::now();
        while self.psql("postgres", "SELECT 1").is_err() {
            let log = fs::read_to_string(self.folder.join("log")).unwrap_or_default();
            assert!(begun.elapsed() < PATIENCE, "PostgreSQL does not begin: {log}");
            sleep(Duration::from_millis(50));
        }
    }

    /// Kills the server, as if its machine lost power. Cuts its connections.
    ///
    /// # Panics
    /// If it does not end.
    pub fn kill(&mut self) {
        let Some(mut child) = self.child.take() else {
            return;
        };
        // Its child processes notice that the parent is gone, and end.
        child.kill().expect("kill");
        child.wait().expect("ended");
        let lock = self.folder.join("data/postmaster.pid");
        fs::remove_file(&lock).expect("its lock");
        sleep(Duration::from_millis(500));
    }

    /// Creates an empty database and returns its URL.
    ///
    /// # Panics
    /// If it cannot be created.
    pub fn database(&self) -> String {
        let number = self.databases.fetch_add(1, Ordering::Relaxed);
        let name = format!("fled_{number}");
        let made = self.psql("postgres", &format!("CREATE DATABASE {name}"));
        made.expect("a database is made");
        format!("postgres://fled@127.0.0.1:{}/{name}", self.port)
    }

    /// The port of the server.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Runs a query; returns the rows as text.
    ///
    /// # Errors
    /// The error message.
    ///
    /// # Panics
    /// If `psql` is not installed.
    pub fn psql(&self, database: &str, sql: &str) -> Result<String, String> {
        let answer = Command::new(program("psql"))
            .env("PGCONNECT_TIMEOUT", "5")
            .args(["-X", "-q", "-A", "-t", "-h", "127.0.0.1", "-U", "fled"])
            .args(["-p", &self.port.to_string(), "-d", database, "-c", sql])
            .output()
            .expect("psql runs");
        if answer.status.success() {
            Ok(String::from_utf8_lossy(&answer.stdout).trim().to_owned())
        } else {
            Err(String::from_utf8_lossy(&answer.stderr).into_owned())
        }
    }
}

impl Drop for Postgres {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
        drop(self.remover.stdin.take());
        let _ = self.remover.wait();
    }
}

/// A process that removes `folder` once its input is closed, at the latest by the end of this
/// process: a static server is never dropped, and its databases take hundreds of megabytes.
fn remover(folder: &Path) -> Child {
    // PostgreSQL's processes write until they notice that theirs has ended.
    Command::new("sh")
        .args(["-c", "read -r _; sleep 1; rm -rf \"$0\" || { sleep 5; rm -rf \"$0\"; }"])
        .arg(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        // An interrupt at the terminal must not end it.
        .process_group(0)
        .spawn()
        .expect("sh starts")
}

/// A program of the newest installed PostgreSQL.
fn program(name: &str) -> PathBuf {
    let versions = fs::read_dir(DEBIAN).map(|entries| {
        let versions = entries.flatten().filter_map(|entry| {
            let version: u32 = entry.file_name().to_str()?.parse().ok()?;
            let path = entry.path().join("bin").join(name);
            path.is_file().then_some((version, path))
        });
        versions.max()
    });
    match versions {
        Ok(Some((_, path))) => path,
        _ => PathBuf::from(name),
    }
}

/// The user `postgres` or `nobody` if the tests run as root, which PostgreSQL refuses.
fn other_user() -> Option<(u32, u32)> {
    let root = fs::metadata("/proc/self").is_ok_and(|about| {
        use std::os::unix::fs::MetadataExt;
        about.uid() == 0
    });
    root.then(|| {
        let users = fs::read_to_string("/etc/passwd").unwrap_or_default();
        let named = |name: &str| {
            let line = users.lines().find(|line| line.split(':').next() == Some(name))?;
            let mut fields = line.split(':').skip(2);
            Some((fields.next()?.parse().ok()?, fields.next()?.parse().ok()?))
        };
        named("postgres").or_else(|| named("nobody")).unwrap_or((65534, 65534))
    })
}

/// A command that ends with the thread that started it, and does not run as root.
fn as_user(program: &Path) -> Command {
    let mut command = Command::new("setpriv");
    if let Some((user, group)) = other_user() {
        command.arg(format!("--reuid={user}")).arg(format!("--regid={group}"));
        command.arg("--clear-groups");
    }
    command.args(["--pdeathsig", "KILL", "--"]).arg(program);
    command
}
