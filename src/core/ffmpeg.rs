//! What every use of ffmpeg shares: how it is begun, and the last that it says.

use std::ffi::{OsStr, OsString};
use std::io::Read;
use std::path::{Path, absolute};
use std::process::Command;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

/// Bytes of what ffmpeg says that are kept: what it tells of a file with many streams fits.
const TAIL: usize = 64 << 10;

/// After its end its last words are there at once.
const PATIENCE: Duration = Duration::from_secs(1);

/// The program, told to ask nothing, to say only what is wrong, and to end there. `first` are
/// arguments before, where it is one that starts ffmpeg.
pub(crate) fn command(program: impl AsRef<OsStr>, first: &[OsString]) -> Command {
    let mut command = Command::new(program);
    command.args(first).args(["-nostdin", "-hide_banner", "-loglevel", "error", "-xerror"]);
    command
}

/// What it says, once it has said it all.
pub(crate) struct Words(Receiver<String>);

impl Words {
    /// Listens to standard error.
    pub(crate) fn of(stream: Option<impl Read + Send + 'static>) -> Self {
        let (sender, receiver) = sync_channel(1);
        if let Some(mut stream) = stream {
            std::thread::spawn(move || {
                let (mut said, mut buffer) = (Vec::new(), [0; 1024]);
                while let Ok(count @ 1..) = stream.read(&mut buffer) {
                    said.extend_from_slice(&buffer[..count]);
                    let excess = said.len().saturating_sub(TAIL);
                    said.drain(..excess);
                }
                // Nobody listens where it ended well.
                let _ = sender.send(String::from_utf8_lossy(&said).into_owned());
            });
        }
        Self(receiver)
    }

    /// All of one that has ended, as far as it is kept, without where the file lies that it is
    /// about.
    pub(crate) fn all(&self, file: &Path) -> String {
        let said = self.0.recv_timeout(PATIENCE).unwrap_or_default();
        let path = absolute(file).unwrap_or_else(|_| file.to_owned());
        said.replace(&path.display().to_string(), "it")
    }
}

/// The last line of what it said.
pub(crate) fn last_line(said: &str) -> &str {
    let last = said.lines().map(str::trim).rfind(|line| !line.is_empty());
    last.unwrap_or("nothing")
}
