//! What a child tells the service, a line each on standard output.

use std::io::{self, Write};

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
