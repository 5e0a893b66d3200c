//! Common parts of all uses of ffmpeg: its start and its last messages.

use std::ffi::{OsStr, OsString};
use std::io::Read;
use std::path::{Path, absolute};
use std::process::Command;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

/// Bytes kept of ffmpeg's messages: enough for a file with many streams.
const TAIL: usize = 64 << 10;

/// After its exit its last messages arrive at once.
const PATIENCE: Duration = Duration::from_secs(1);

/// Whether a program that starts ffmpeg ended with this exit code because it did not find it, or
/// found something that cannot be run. ffmpeg uses neither code.
pub fn is_not_started(code: i32) -> bool {
    matches!(code, 126 | 127)
}

/// The program, with options to ask nothing, to report only errors, and to exit on them. `first`
/// are leading arguments, if it is a program that starts ffmpeg.
pub fn command(program: impl AsRef<OsStr>, first: &[OsString]) -> Command {
    let mut command = Command::new(program);
    command.args(first).args(["-nostdin", "-hide_banner", "-loglevel", "error", "-xerror"]);
    command
}

/// Its messages, once it has closed the stream.
pub struct Words(Receiver<String>);

impl Words {
    /// Reads standard error.
    pub fn of(stream: Option<impl Read + Send + 'static>) -> Self {
        let (sender, receiver) = sync_channel(1);
        if let Some(mut stream) = stream {
            std::thread::spawn(move || {
                let (mut text, mut buffer) = (Vec::new(), [0; 1024]);
                while let Ok(count @ 1..) = stream.read(&mut buffer) {
                    text.extend_from_slice(&buffer[..count]);
                    let excess = text.len().saturating_sub(TAIL);
                    text.drain(..excess);
                }
                // The receiver is gone if ffmpeg succeeded.
                let _ = sender.send(String::from_utf8_lossy(&text).into_owned());
            });
        }
        Self(receiver)
    }

    /// All messages of a process that has exited, as far as they are kept, without the folder of
    /// the file that they refer to.
    pub fn all(&self, file: &Path) -> String {
        let text = self.0.recv_timeout(PATIENCE).unwrap_or_default();
        let path = absolute(file).unwrap_or_else(|_| file.to_owned());
        text.replace(&path.display().to_string(), "it")
    }
}

/// The last line of the messages.
pub fn last_line(text: &str) -> &str {
    let last = text.lines().map(str::trim).rfind(|line| !line.is_empty());
    last.unwrap_or("nothing")
}
