//! The protocol between the service and its children: one line per message on standard output.

use std::ffi::OsString;
use std::io::{self, Write};
use std::path::PathBuf;

use fled_core::event::Event;

/// Prints and flushes one line of the protocol.
pub fn say(line: &str) {
    let mut out = io::stdout().lock();
    // If the pipe is closed, the server has gone and this process will end too.
    let _ = writeln!(out, "{line}").and_then(|()| out.flush());
}

pub fn tell(event: &Event) {
    say(&serde_json::to_string(event).expect("events are plain data"));
}

/// The value that follows an argument.
pub fn argument(arguments: &[OsString], name: &str) -> Result<PathBuf, String> {
    let at = arguments.iter().position(|argument| argument == name);
    at.and_then(|at| arguments.get(at + 1)).map(PathBuf::from).ok_or(format!("{name} is missing"))
}
