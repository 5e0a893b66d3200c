//! What the service tells a child, and what a child tells it, a line each on standard output.

use std::ffi::OsString;
use std::io::{self, Write};
use std::path::PathBuf;

use fled_core::event::Event;

/// One line of the protocol, at once.
pub fn say(line: &str) {
    let mut out = io::stdout().lock();
    // Nobody listens any more: the server is gone, and so will be this process.
    let _ = writeln!(out, "{line}").and_then(|()| out.flush());
}

pub fn tell(event: &Event) {
    say(&serde_json::to_string(event).expect("events are plain data"));
}

/// What stands behind an argument.
pub fn argument(arguments: &[OsString], name: &str) -> Result<PathBuf, String> {
    let at = arguments.iter().position(|argument| argument == name);
    at.and_then(|at| arguments.get(at + 1))
        .map(PathBuf::from)
        .ok_or(format!("{name} is missing"))
}
